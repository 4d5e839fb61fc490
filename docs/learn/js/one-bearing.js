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
    s.show(
      `The camera measures a bearing of ${degrees(wrap(direction - heading))}. The landmark is ` +
      `${apart(robot, mark).toFixed(1)} m away, but any point on the line, such as the green ones, has the same bearing.`,
    );
  });
  const robot = scene.handle("robot", -3, -1.5, "robot");
  const nose = scene.handle("heading of the robot", -1.8, -1.5, "knob");
  const mark = scene.handle("landmark", 1, 1);
  scene.start();
}
