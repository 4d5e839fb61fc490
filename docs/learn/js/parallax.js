{
  const NOISE = 1 / DEG;
  const scene = makeScene("parallax", (s) => {
    for (const from of [before, now]) {
      const direction = towards(from, mark), far = 14;
      const edge = (turn) => ({x: from.x + far * Math.cos(direction + turn), y: from.y + far * Math.sin(direction + turn)});
      s.path([from, edge(-2 * NOISE), edge(2 * NOISE), from], "area");
      s.line(from, mark);
    }
    s.line(before, now, "arc");
    s.text(before, "before");
    s.text(now, "now");
    s.text(mark, "landmark");
    const parallax = Math.abs(wrap(towards(now, mark) - towards(before, mark)));
    const distance = apart(now, mark), sigma = (NOISE * Math.hypot(apart(before, mark), distance)) / Math.sin(parallax);
    s.show(
      `Odometry measures a motion of ${apart(before, now).toFixed(1)} m. The direction of the landmark changed by ` +
      `${degrees(parallax, 1)}, the parallax. Its distance is ${distance.toFixed(1)} m ` +
      (parallax > 0.02 ? `± ${sigma.toFixed(1)} m for a bearing noise of 1°.` : "but it is undetermined: drive sideways."),
    );
  });
  const before = scene.handle("the robot before", -3.5, -2, "robot");
  const now = scene.handle("the robot now", -1.5, -2.2, "robot");
  const mark = scene.handle("landmark", 2.5, 1.2);
  scene.start();
}
