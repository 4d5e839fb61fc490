{
  const DRAWS = 100, NOISE = 5 / DEG;
  // The same draws each time: a small generator with a fixed seed, and Box and Muller's transform.
  let seed = 7;
  const uniform = () => { seed = (seed * 48271) % 2147483647; return seed / 2147483647; };
  const normal = () => Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform());
  const drawn = [...Array(DRAWS)].map(() => [normal(), normal(), normal(), normal()]);
  const scene = makeScene("said-and-true", (s) => {
    const truth = {x: robot.x, y: robot.y, heading: 0}, said = NOISE * {half: 0.5, right: 1, double: 2}[told.value];
    const right = marks.map((mark) => towards(truth, mark));
    const {inverse: P} = solve3(normalEquations(linearised(truth, marks, right)).A, [0, 0, 0]);
    const [a, c, d] = [P[0][0], P[0][1], P[1][1]].map((v) => v * said * said), det = a * d - c * c;
    let inside = 0, nees = 0;
    for (const draw of drawn) {
      const found = resect(marks, right.map((b, k) => b + NOISE * draw[k]), truth);
      const x = found.x - truth.x, y = found.y - truth.y, own = (d * x * x - 2 * c * x * y + a * y * y) / det;
      inside += own < 4;
      nees += own / DRAWS;
      s.dot(found, own < 4 ? "landmark" : "landmark odd", 3);
    }
    const {points, longest} = ellipse(truth, marks, said);
    if (longest < 10) s.path(points, "area");
    for (const mark of marks) { s.line(robot, mark); s.text(mark, mark.name.slice(-1)); }
    s.say(
      `Of ${DRAWS} answers ${inside} are in the ellipse of two sigma that was said; 86 should be. NEES is ${nees.toFixed(1)} on average; ` +
      `of a position it should be 2. ` + (nees > 3 ? "Too sure: it will be relied on where it is wrong." : nees < 1.3 ? "Too careful: honest, but it could know more." : "Honest."),
    );
  });
  const marks = [[-3, 1], [0, 2.6], [3, 0.6], [-1.4, -2.4]].map(([x, y], k) => scene.handle(`landmark ${"ABCD"[k]}`, x, y));
  const robot = scene.handle("robot", 0.3, -0.2, "robot");
  const told = scene.choose("The noise that it believes in is", ["half", "right", "double"], "right");
  scene.start();
}
