{
  const scene = makeScene("one-bearing", (s) => {
    const heading = towards(robot, nose), direction = towards(robot, mark);
    s.ray(robot, direction);
    s.ray(robot, heading, "arc", apart(robot, nose));
    s.arc(robot, heading, direction);
    s.robot(robot, heading);
    for (const far of [1.2, 2.4, 3.6, 6]) {
      s.dot({x: robot.x + far * Math.cos(direction), y: robot.y + far * Math.sin(direction)}, "answer", 5);
    }
    s.text(mark, "landmark");
    s.text(robot, "robot");
    s.say(
      `The camera sees the landmark under a bearing of ${degrees(wrap(direction - heading))}. It stands ` +
      `${apart(robot, mark).toFixed(1)} m away, but any place on the line, as the green ones, looks the same.`,
    );
  });
  const robot = scene.handle("robot", -3, -1.5, "robot");
  const nose = scene.handle("heading of the robot", -1.8, -1.5, "knob");
  const mark = scene.handle("landmark", 1, 1);
  scene.start();
}
