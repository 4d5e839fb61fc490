{
  const PRIOR = 0.1, NAMES = "ABCDE"; // prior probability of having moved
  const stored = [[-3, 1.4], [-0.6, 2.6], [2.4, 2], [3.2, -1.2], [-2.2, -2.2]].map(([x, y]) => ({x, y}));
  const home = {x: 0.4, y: -0.4, heading: 0};
  const bearings = stored.map((place) => towards(home, place));
  const scene = makeScene("which-are-wrong", (s) => {
    const sigma = noise.value / DEG, all = [0, 1, 2, 3, 4];
    // The residual of a correct bearing is noise; a wrong one may have any value in the circle.
    const inlier = (miss) => -0.5 * (miss / sigma) ** 2 - Math.log(sigma * Math.sqrt(2 * Math.PI)) + Math.log(1 - PRIOR);
    const outlier = -Math.log(2 * Math.PI) + Math.log(PRIOR);
    const sets = [...Array(32).keys()].map((bits) => all.filter((k) => (bits >> k) & 1)).filter((moved) => moved.length <= 2);
    const weights = sets.map((moved) => {
      const kept = all.filter((k) => !moved.includes(k));
      const found = resect(kept.map((k) => marks[k]), kept.map((k) => bearings[k]), home);
      const misses = kept.map((k) => wrap(bearings[k] - towards(found, marks[k]) + found.heading));
      // The volume of poses that fit nearly as well is omitted: similar for each set.
      return {moved, found, log: misses.reduce((sum, miss) => sum + inlier(miss), 0) + moved.length * outlier};
    });
    const peak = Math.max(...weights.map((w) => w.log)), total = weights.reduce((sum, w) => sum + Math.exp(w.log - peak), 0);
    for (const w of weights) w.share = Math.exp(w.log - peak) / total;
    const moved = all.map((k) => weights.reduce((sum, w) => sum + (w.moved.includes(k) ? w.share : 0), 0));
    marks.forEach((mark, k) => {
      s.ray(home, bearings[k], moved[k] > 0.5 ? "moved" : "sight", apart(home, stored[k]));
      s.text(mark, `${NAMES[k]} ${(100 * moved[k]).toFixed(0)} %`);
    });
    for (const w of weights) if (w.share > 0.05 && Math.abs(w.found.x) < 5 && Math.abs(w.found.y) < 4) s.dot(w.found, "answer", 3 + 9 * Math.sqrt(w.share));
    s.robot(home, 0);
    const best = [...weights].sort((a, b) => b.share - a.share).slice(0, 2);
    const text = (w) => `${w.moved.length ? w.moved.map((k) => NAMES[k]).join(" and ") + " moved" : "nothing moved"}: ${(100 * w.share).toFixed(0)} %`;
    s.show(`Most probable of 16 hypotheses: ${text(best[0])}; then ${text(best[1])}. ` +
      (best[0].share < 0.95 ? "Below 95 %: homes of all hypotheses count (green)." : "At least 95 %: accepted."));
  });
  const marks = stored.map(({x, y}, k) => scene.handle(`landmark ${NAMES[k]}`, x, y));
  const noise = scene.choose("Noise of bearings [°]:", [0.5, 2, 5], 0.5);
  marks[2].x += 0.9;
  marks[2].y -= 0.7;
  scene.start();
}
