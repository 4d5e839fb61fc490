{
  const NOISE = 1 / DEG, SPEED = 0.2, WIDE = 0.3;
  const scene = makeScene("polar-filter", (s) => {
    const far = Math.max(apart(robot, home), 1e-3), theta = towards(home, robot);
    // Region of a Gaussian in (R, theta): as wide across at the robot's own distance as it is long.
    const sigma = WIDE / far, edge = (r, t) => ({x: home.x + r * Math.cos(t), y: home.y + r * Math.sin(t)});
    const points = [...Array(121).keys()].map((k) => {
      const turn = (k * Math.PI) / 60;
      return edge(Math.max(far + WIDE * Math.cos(turn), 0), theta + sigma * Math.sin(turn));
    });
    s.path(points, "area");
    s.circle(robot, WIDE, "arc");
    s.line(home, robot, "arc");
    s.line(home, mark);
    s.line(robot, mark, "moved");
    s.dot(home, "answer", 6);
    s.text(home, "home");
    s.text(mark, "landmark");
    s.text(robot, "robot");
    // The triangle of home, robot and landmark, from two directions and R.
    const sight = towards(robot, mark), stored = towards(home, mark), angle = Math.abs(Math.sin(stored - sight));
    const off = (NOISE * apart(robot, mark)) / Math.max(angle, 1e-9);
    const turning = (SPEED / far) * DEG;
    s.show(
      `R is ${far.toFixed(2)} m. Driving past home at ${SPEED} m/s turns θ by ${turning < 500 ? turning.toFixed(0) : "over 500"}° a second, and ` +
      `±${WIDE} m across are ±${Math.min(sigma * DEG, 999).toFixed(0)}° of θ (shaded: the filter's shape of the circle). ` +
      (angle < 0.05 ? "The robot is in line with home and the landmark: the landmark's distance is undetermined."
        : `The landmark's distance, from the triangle, has an error of ${off.toFixed(2)} m for a bearing error of 1°.`),
    );
  });
  const home = {x: -1.5, y: -0.6};
  const robot = scene.handle("robot", 0.8, -1.6, "robot");
  const mark = scene.handle("landmark", 2.4, 1.6);
  scene.start();
}
