{
  const NOISE = 0.5 / DEG;
  // Bearing errors at the two poses, the same each time, in units of their noise.
  const DRAWN = [[0.7, -0.6], [-0.8, 0.5], [0.4, 0.9], [-0.5, -0.8]];
  const home = {x: -3.4, y: 1.2, heading: 0};
  const meet = (a, p, b, q) => {
    const across = Math.sin(q - p), t = ((b.x - a.x) * Math.sin(q) - (b.y - a.y) * Math.cos(q)) / across;
    return {x: a.x + t * Math.cos(p), y: a.y + t * Math.sin(p)};
  };
  const scene = makeScene("map-first", (s) => {
    const bearings = marks.map((mark) => towards(home, mark) - home.heading);
    if (wrong.value === "C wrong") bearings[2] += 25 / DEG;
    const map = marks.map((mark, k) => {
      const [p, q] = [before, now].map((from, j) => towards(from, mark) + NOISE * DRAWN[k][j]);
      const there = meet(before, p, now, q);
      s.line(before, there);
      s.line(now, there);
      return there;
    });
    // Expected residuals at home from the errors of the map; larger ones are due to the home bearings.
    const spread = marks.map((mark) => {
      const parallax = Math.sin(towards(now, mark) - towards(before, mark));
      return (NOISE * Math.hypot(apart(before, mark), apart(now, mark))) / Math.abs(parallax) / apart(home, mark);
    });
    const expected = Math.sqrt(spread.reduce((sum, x) => sum + x * x, 0) / spread.length);
    const off = map.map((there, k) => apart(there, marks[k])), worst = Math.max(...off);
    map.forEach((there, k) => { s.dot(there, "answer", 6); s.text(marks[k], "ABCD"[k]); });
    const found = resect(map, bearings, home);
    s.robot(home, 0);
    s.text(home, "home");
    if (Number.isFinite(found.x) && Math.abs(found.x) < 20) s.dot(found, "landmark odd", 6);
    s.line(before, now, "arc");
    s.text(before, "before");
    s.text(now, "now");
    s.show(
      `First the map, in the odometry frame: largest error ${worst < 20 ? worst.toFixed(2) : "over 20"} m (green), ` +
      `independent of home. Then home, by resection in that map: error ${apart(found, home) < 20 ? apart(found, home).toFixed(2) : "over 20"} m (orange)` +
      (found.rms > 2 * expected ? `, residuals ${degrees(found.rms, 1)}: a home bearing is wrong, the map is not.` : "."),
    );
  });
  const marks = [[-2, 2.8], [0.6, 3], [2.8, 0.8], [-1.6, -0.6]].map(([x, y], k) => scene.handle(`landmark ${"ABCD"[k]}`, x, y));
  const before = scene.handle("the robot before", -2.4, -2.6, "robot");
  const now = scene.handle("the robot now", 2.2, -2.2, "robot");
  const wrong = scene.choose("Home bearings:", ["all correct", "C wrong"], "all correct");
  scene.start();
}
