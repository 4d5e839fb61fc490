{
  const driven = [[0, 0], [0.8, 0.3], [1.5, 0.9], [1.9, 1.7]], marks = [[-0.6, 1.6], [1.0, 2.2], [2.4, 0.4]];
  const origin = {x: -2.2, y: -2.4};
  const grown = (points, scale) => points.map(([x, y]) => ({x: origin.x + scale * x, y: origin.y + scale * y}));
  const scene = makeScene("free-scale", (s) => {
    const scale = Math.max(0.2, (size.x - origin.x) / 2.4);
    for (const [k, kind] of [[1, "moved"], [scale, "sight"]]) {
      const path = grown(driven, k), places = grown(marks, k);
      s.path(path, "arc");
      for (const from of path) for (const to of places) s.line(from, to, kind);
      for (const place of places) s.dot(place, kind === "moved" ? "landmark odd" : "landmark", 6);
    }
    const at = grown(driven, scale)[3], seen = grown(marks, scale).map((place) => degrees(towards(at, place)));
    s.text(origin, "start");
    s.show(
      `A world ${scale.toFixed(2)} times as large as the other, and a robot ${scale.toFixed(2)} times as fast. At the end of ` +
      `the path the landmarks are in the directions ${seen.join(", ")}: the same in both worlds.`,
    );
  });
  const size = scene.handle("size of the world", 2.2, -2.4, "knob");
  scene.start();
}
