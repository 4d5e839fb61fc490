// The page of a run: draws Bokeh's plots, and moves the robot along the track with the slider.
"use strict";
(async () => {
  const { doc: json, roots, moments } = JSON.parse(document.getElementById("data").textContent);

  // Draw each plot into the figure with its name.
  Bokeh.set_log_level("warn");
  const targets = {};
  for (const [id, name] of Object.entries(roots)) targets[id] = document.getElementById(`plot-${name}`);
  await Bokeh.embed.embed_items(
    { run: json },
    [{ docid: "run", roots: targets, root_ids: Object.keys(roots) }],
  );
  const models = [...Bokeh.documents[0].all_models];
  const tagged = (tag) => models.filter((m) => m.tags.includes(tag));
  const source = (name) => models.find((m) => m.name === name);
  const plots = models.filter((m) => m.type === "Figure");

  // Adapt colours to dark or light mode.
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const paint = () => {
    const style = getComputedStyle(document.documentElement);
    const [ink, muted, rule] = ["--ink", "--muted", "--rule"].map((v) => style.getPropertyValue(v).trim());
    for (const plot of plots) {
      for (const axis of [...plot.below, ...plot.left].filter((m) => "axis_label" in m)) {
        axis.major_label_text_color = axis.axis_label_text_color = muted;
      }
      for (const grid of plot.center.filter((m) => "grid_line_color" in m)) grid.grid_line_color = rule;
    }
    for (const m of tagged("ink")) {
      const look = m.glyph ?? m;
      for (const key of ["line_color", "fill_color", "text_color"]) {
        if (key in look && (look[key]?.value ?? null) === null && typeof look[key] === "object") continue;
        if (key in look) look[key] = ink;
      }
    }
  };
  paint();
  dark.addEventListener("change", paint);

  // On touch screens, dragging over a plot scrolls the page.
  if (matchMedia("(pointer: coarse)").matches) {
    for (const plot of plots) plot.toolbar.tools.forEach((tool) => { if ("overlay" in tool || tool.type === "PanTool") tool.active = false; });
  }

  const slider = document.getElementById("moment");
  const state = document.getElementById("state"), clock = document.getElementById("clock");
  const play = document.getElementById("play");
  const cursors = tagged("cursor"), landmarks = source("landmarks");
  const map = plots.find((p) => p.match_aspect);
  const extent = Math.max(map.x_range.end - map.x_range.start, map.y_range.end - map.y_range.start);
  const KITE = [[1.6, 0], [-1, 0.9], [-0.5, 0], [-1, -0.9]];
  const FATES = [["#0072b2", "used"], ["#d55e00", "rejected"], ["#8a9097", "not mapped yet, or without an id"]];

  const placed = ([x, y, heading], points) => {
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    return { x: points.map(([u, v]) => x + c * u - s * v), y: points.map(([u, v]) => y + s * u + c * v) };
  };
  // The same size on every screen: the unit is eight pixels.
  const unit = () => (8 * (map.y_range.end - map.y_range.start)) / map.inner_height;
  const outline = (pose) => (pose ? placed(pose, KITE.map((p) => p.map((v) => unit() * v))) : { x: [], y: [] });
  const axes = ([xx, xy, yy]) => {
    const mean = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy);
    return [Math.sqrt(mean + half), Math.sqrt(Math.max(mean - half, 0)), 0.5 * Math.atan2(2 * xy, xx - yy)];
  };
  const rim = (pose, cov) => {
    if (!pose) return { x: [], y: [] };
    const [a, b, angle] = axes(cov);
    const circle = Array.from({ length: 49 }, (_, i) => (2 * Math.PI * i) / 48);
    return placed([pose[0], pose[1], angle], circle.map((w) => [2 * a * Math.cos(w), 2 * b * Math.sin(w)]));
  };
  const rays = (pose, seen, known) => {
    const data = { x0: [], y0: [], x1: [], y1: [], color: [] };
    if (!pose) return data;
    const cameras = placed(pose, moments.cameras);
    for (const [landmark, bearing, fate, camera] of seen) {
      const [x, y] = [cameras.x[camera], cameras.y[camera]], at = known?.[landmark];
      const reach = at ? Math.hypot(at[0] - x, at[1] - y) : extent / 4;
      data.x0.push(x); data.y0.push(y);
      data.x1.push(x + reach * Math.cos(pose[2] + bearing));
      data.y1.push(y + reach * Math.sin(pose[2] + bearing));
      data.color.push(FATES[fate][0]);
    }
    return data;
  };
  // Landmarks are drawn as estimated at that time; hollow if not mapped yet.
  const number = new Map(moments.ids.map((id, i) => [id, i]));
  const final = landmarks.data;
  const colour = (at) => (at && at[2] >= 0 ? moments.colours.moved[at[2]] : moments.colours.untested);
  const landmarksAt = (known) => {
    if (!known) return final;
    const at = final.id.map((id) => known[number.get(id)]);
    return {
      ...final,
      x: at.map((p, i) => p?.[0] ?? final.x[i]),
      y: at.map((p, i) => p?.[1] ?? final.y[i]),
      line: at.map(colour),
      fill: at.map((p) => (p ? colour(p) : "#00000000")),
    };
  };
  const names = (seen, fate) => {
    const all = seen.filter((s) => s[2] === fate).map((s) => moments.names[s[0]]);
    return all.length > 8 ? [...all.slice(0, 7), `${all.length - 7} more`] : all;
  };
  const sentence = (i) => {
    const [pose, seen] = [moments.pose[i], moments.seen[i]];
    const parts = [`${moments.statuses[moments.status[i]]}: ${moments.reasons[moments.reason[i]]}`];
    if (pose) {
      const [a] = axes(moments.cov[i]), turn = (180 / Math.PI) * pose[2];
      parts.push(`at (${pose[0].toFixed(2)}, ${pose[1].toFixed(2)}) m, heading ${turn.toFixed(0)}°, ± ${a.toPrecision(2)} m`);
    }
    const uses = FATES.map(([, use], fate) => [names(seen, fate), use]).filter(([ids]) => ids.length);
    parts.push(uses.length ? uses.map(([ids, use]) => `bearings ${use}: ${ids.join(", ")}`).join("; ") : "no bearings");
    return parts.join(" · ");
  };

  const show = (i) => {
    const pose = moments.pose[i], known = moments.history[moments.known[i]];
    source("robot").data = outline(pose);
    source("ellipse").data = rim(pose, moments.cov[i]);
    source("rays").data = rays(pose, moments.seen[i], known);
    if (source("true-robot")) source("true-robot").data = outline(moments.truth[i]);
    landmarks.data = landmarksAt(known);
    for (const cursor of cursors) cursor.location = moments.t[i];
    clock.textContent = `${moments.t[i].toFixed(1)} s`;
    state.textContent = sentence(i);
    slider.value = i;
  };
  slider.addEventListener("input", () => show(Number(slider.value)));

  // A click on a plot over time sets the slider.
  const nearest = (t) => {
    const after = moments.t.findIndex((u) => u >= t);
    return after < 0 ? moments.t.length - 1 : after;
  };
  for (const plot of plots) {
    if (plot !== map) plot.on_event("tap", (event) => show(nearest(event.x)));
  }

  // Play the drive in about half a minute.
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; play.textContent = "▶"; play.ariaLabel = "Play"; };
  play.addEventListener("click", () => {
    if (timer) return stop();
    if (Number(slider.value) >= moments.t.length - 1) slider.value = 0;
    const step = Math.max(1, Math.round(moments.t.length / 600));
    play.textContent = "⏸";
    play.ariaLabel = "Pause";
    timer = setInterval(() => {
      const next = Number(slider.value) + step;
      show(Math.min(next, moments.t.length - 1));
      if (next >= moments.t.length - 1) stop();
    }, 50);
  });
  // report.html#t=84.2 opens at that moment.
  const start = Number(new URLSearchParams(location.hash.slice(1)).get("t") ?? NaN);
  show(Number.isNaN(start) ? Number(slider.value) : nearest(start));
  // Drawing has shifted the section of the address.
  document.getElementById(decodeURIComponent(location.hash.slice(1)))?.scrollIntoView();
  document.documentElement.dataset.drawn = "";
})();
