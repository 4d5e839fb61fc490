{
  const scene = makeScene("two-landmarks", (s) => {
    const between = wrap(towards(robot, a) - towards(robot, b));
    const circle = circleThrough(a, b, robot);
    if (Number.isFinite(circle.radius)) {
      s.circle(circle, circle.radius);
      const start = towards(circle, robot);
      for (let k = 1; k < 24; k++) {
        const angle = start + (k * Math.PI) / 12;
        const there = {x: circle.x + circle.radius * Math.cos(angle), y: circle.y + circle.radius * Math.sin(angle)};
        const seen = wrap(towards(there, a) - towards(there, b));
        if (Math.abs(wrap(seen - between)) < 1e-6) s.dot(there, "answer", 5);
      }
    }
    s.line(robot, a);
    s.line(robot, b);
    s.arc(robot, towards(robot, b), towards(robot, a));
    s.text(a, "A");
    s.text(b, "B");
    s.text(robot, "robot");
    s.show(
      `A and B are seen ${degrees(Math.abs(between))} apart. From each green point on the circle they are ` +
      "seen the same angle apart, and a robot without a compass can turn so that both bearings are the same.",
    );
  });
  const a = scene.handle("landmark A", -2, 1.5);
  const b = scene.handle("landmark B", 2, 2);
  const robot = scene.handle("robot", 0.5, -1.8, "robot");
  scene.start();
}
