{
  const NOISE = 1 / DEG;
  const scene = makeScene("three-landmarks", (s) => {
    const marks = [a, b, c];
    for (const [p, q] of [[a, b], [b, c], [c, a]]) {
      const circle = circleThrough(p, q, robot);
      if (Number.isFinite(circle.radius)) s.circle(circle, circle.radius);
    }
    const danger = circleThrough(a, b, c);
    s.circle(danger, danger.radius, "moved");
    const {points, longest} = ellipse({x: robot.x, y: robot.y, heading: 0}, marks, NOISE);
    if (longest < 10) s.path(points, "area");
    for (const mark of marks) {
      s.line(robot, mark);
      s.text(mark, mark.name.slice(-1));
    }
    s.text(robot, "robot");
    const off = Math.abs(apart(robot, danger) - danger.radius);
    s.show(
      (off < 0.12 ? "The robot is on the circle through A, B and C: the three circles coincide, and the position along them is undetermined. "
        : "Three circles meet in one point: the robot. ") +
      `With a noise of 1° in each bearing, the largest standard deviation of the position is ` +
      `${longest < 10 ? longest.toFixed(2) + " m" : "more than 10 m"} (shaded: two sigma).`,
    );
  });
  const a = scene.handle("landmark A", -3, 1);
  const b = scene.handle("landmark B", 0, 2.6);
  const c = scene.handle("landmark C", 3, 0.6);
  const robot = scene.handle("robot", 0.3, 0.2, "robot");
  scene.start();
}
