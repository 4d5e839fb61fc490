{
  const DRAWS = 100, NOISE = 5 / DEG;
  // The same draws each time: a small generator with a fixed seed, and Box and Muller's transform.
  let seed = 7;
  const uniform = () => { seed = (seed * 48271) % 2147483647; return seed / 2147483647; };
  const normal = () => Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform());
  const drawn = [...Array(DRAWS)].map(() => [normal(), normal(), normal(), normal()]);
  const scene = makeScene("how-sure", (s) => {
    const pose = {x: robot.x, y: robot.y, heading: 0}, sigma = NOISE * {half: 0.5, right: 1, double: 2}[assumed.value];
    const right = marks.map((mark) => towards(pose, mark));
    const {inverse: P} = solve3(normalEquations(linearised(pose, marks, right)).A, [0, 0, 0]);
    const [a, c, d] = [P[0][0], P[0][1], P[1][1]].map((v) => v * sigma * sigma), det = a * d - c * c;
    let inside = 0, nees = 0;
    for (const draw of drawn) {
      const found = resect(marks, right.map((b, k) => b + NOISE * draw[k]), pose);
      const x = found.x - pose.x, y = found.y - pose.y, own = (d * x * x - 2 * c * x * y + a * y * y) / det;
      inside += own < 4;
      nees += own / DRAWS;
      s.dot(found, own < 4 ? "landmark" : "landmark odd", 3);
    }
    const {points, longest} = ellipse(pose, marks, sigma);
    if (longest < 10) s.path(points, "area");
    for (const mark of marks) { s.line(robot, mark); s.text(mark, mark.name.slice(-1)); }
    s.show(
      `${inside} of ${DRAWS} estimates are in the estimated 2-sigma ellipse (expected: 86). NEES is ${nees.toFixed(1)} on average ` +
      `(expected for a position: 2). ` + (nees > 3 ? "Overconfident." : nees < 1.3 ? "Conservative: the ellipse is larger than necessary." : "Consistent."),
    );
  });
  const marks = [[-3, 1], [0, 2.6], [3, 0.6], [-1.4, -2.4]].map(([x, y], k) => scene.handle(`landmark ${"ABCD"[k]}`, x, y));
  const robot = scene.handle("robot", 0.3, -0.2, "robot");
  const assumed = scene.choose("Assumed noise:", ["half", "right", "double"], "right");
  scene.start();
}
