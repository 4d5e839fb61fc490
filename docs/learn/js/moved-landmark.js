{
  const FITS = 0.5 / DEG;
  const stored = [[-3, 1.4], [-0.6, 2.6], [2.4, 2], [3.2, -1.2], [-2.2, -2.2]].map(([x, y]) => ({x, y}));
  const home = {x: 0.4, y: -0.4, heading: 0};
  const bearings = stored.map((place) => towards(home, place));
  const scene = makeScene("moved-landmark", (s) => {
    const seen = marks.slice(0, count.value);
    marks.forEach((mark, k) => mark.show(k < count.value));
    const find = (kept) => resect(kept.map((k) => seen[k]), kept.map((k) => bearings[k]), home);
    const all = seen.map((_, k) => k);
    const used = find(all);
    const without = all.map((left) => find(all.filter((k) => k !== left)));
    const fitting = all.filter((k) => count.value > 3 && without[k].rms < FITS);
    seen.forEach((mark, k) => {
      s.ray(home, bearings[k], apart(mark, stored[k]) > 0.1 ? "moved" : "sight", apart(home, stored[k]));
      s.text(mark, "ABCDE"[k]);
    });
    s.robot(home, 0);
    s.text({x: home.x, y: home.y - 0.75}, "home");
    s.dot(used, "landmark odd", 6);
    let words = `With all ${count.value} bearings, home has an error of ${apart(used, home).toFixed(2)} m (orange dot), ` +
      `and the residuals are ${degrees(used.rms, 1)}. `;
    if (count.value === 3) words += "Three bearings always fit some pose: nothing can contradict.";
    else if (used.rms < FITS) words += "No contradiction: each is where it was stored.";
    else if (fitting.length === 1) {
      s.dot(without[fitting[0]], "answer");
      words += `Only without ${"ABCDE"[fitting[0]]} do the others agree, to ${degrees(without[fitting[0]].rms, 1)}: it has moved (green: home without it).`;
    } else words += `One bearing is wrong. But without any one of ${fitting.length} the others agree: four cannot name it.`;
    s.show(words);
  });
  const marks = stored.map(({x, y}, k) => scene.handle(`landmark ${"ABCDE"[k]}`, x, y));
  const count = scene.choose("Landmarks in the home bearings:", [3, 4, 5], 5);
  marks[2].x += 1.1;
  marks[2].y -= 0.9;
  scene.start();
}
