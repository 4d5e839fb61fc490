// Shared by the lessons: a scene in metres, items to drag by pointer or arrow keys, and a sentence.
"use strict";

const DEG = 180 / Math.PI;
const wrap = (a) => Math.atan2(Math.sin(a), Math.cos(a));
const towards = (from, to) => Math.atan2(to.y - from.y, to.x - from.x);
const apart = (a, b) => Math.hypot(a.x - b.x, a.y - b.y);
const degrees = (a, digits = 0) => `${(a * DEG).toFixed(digits)}°`;

/** A drawing in the element `id`; `draw(scene)` is called after each change. */
function makeScene(id, draw) {
  const PX = 60, WIDE = 640, HIGH = 460;
  const host = document.getElementById(id);
  const make = (name, attributes, parent) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    parent.append(made);
    return made;
  };
  const svg = make("svg", {viewBox: `${-WIDE / 2} ${-HIGH / 2} ${WIDE} ${HIGH}`, role: "group"}, host);
  svg.setAttribute("aria-label", host.dataset.label ?? "Figure to drag");
  const grid = make("g", {class: "grid"}, svg);
  for (let k = -5; k <= 5; k++) {
    make("line", {x1: k * PX, x2: k * PX, y1: -HIGH / 2, y2: HIGH / 2}, grid);
    make("line", {y1: k * PX, y2: k * PX, x1: -WIDE / 2, x2: WIDE / 2}, grid);
  }
  const under = make("g", {}, svg), over = make("g", {}, svg);
  const output = document.createElement("output");
  output.setAttribute("aria-live", "polite");
  host.append(output);

  const scene = {
    line(a, b, kind = "sight") {
      return make("line", {x1: a.x * PX, y1: -a.y * PX, x2: b.x * PX, y2: -b.y * PX, class: kind}, under);
    },
    /** From `a` in a direction [rad], `far` metres. */
    ray(a, direction, kind = "sight", far = 20) {
      return scene.line(a, {x: a.x + far * Math.cos(direction), y: a.y + far * Math.sin(direction)}, kind);
    },
    circle(c, radius, kind = "open") {
      if (radius < 60) make("circle", {cx: c.x * PX, cy: -c.y * PX, r: radius * PX, class: kind}, under);
    },
    dot(a, kind = "answer", r = 8) {
      make("circle", {cx: a.x * PX, cy: -a.y * PX, r, class: kind}, under);
    },
    path(points, kind) {
      const d = points.map((p, k) => `${k ? "L" : "M"}${(p.x * PX).toFixed(1)} ${(-p.y * PX).toFixed(1)}`);
      make("path", {d: d.join(""), class: kind}, under);
    },
    /** The angle from one direction to another at `a`. */
    arc(a, from, to, radius = 0.8) {
      const turn = wrap(to - from), n = 24;
      const at = (k) => from + (turn * k) / n;
      scene.path([...Array(n + 1).keys()].map((k) => (
        {x: a.x + radius * Math.cos(at(k)), y: a.y + radius * Math.sin(at(k))})), "arc");
    },
    text(a, words) {
      make("text", {x: a.x * PX + 10, y: -a.y * PX - 10}, under).textContent = words;
    },
    robot(a, heading, kind = "robot") {
      const nose = (angle, r) => ({x: a.x + r * Math.cos(heading + angle), y: a.y + r * Math.sin(heading + angle)});
      scene.path([nose(0, 0.3), nose(2.5, 0.25), nose(Math.PI, 0.12), nose(-2.5, 0.25)], kind);
    },
    show(words) { output.textContent = words; },
    /** An item to drag; `shape`: landmark, landmark odd, robot or knob. */
    handle(name, x, y, shape = "landmark") {
      const item = {name, x, y};
      const g = make("g", {class: "handle", tabindex: 0, role: "button", "aria-label": `${name}, to drag`}, over);
      if (shape !== "knob") make("circle", {r: shape === "robot" ? 5 : 8, class: shape}, g);
      else make("circle", {r: 5, class: "arc"}, g);
      make("circle", {r: 18, class: "touch"}, g);
      item.place = () => g.setAttribute("transform", `translate(${item.x * PX} ${-item.y * PX})`);
      const move = (px, py) => {
        item.x = Math.max(-5.1, Math.min(5.1, px));
        item.y = Math.max(-3.6, Math.min(3.6, py));
        redraw();
      };
      g.addEventListener("pointerdown", (e) => g.setPointerCapture(e.pointerId));
      g.addEventListener("pointermove", (e) => {
        if (!g.hasPointerCapture(e.pointerId)) return;
        const p = new DOMPoint(e.clientX, e.clientY).matrixTransform(svg.getScreenCTM().inverse());
        move(p.x / PX, -p.y / PX);
      });
      g.addEventListener("keydown", (e) => {
        const step = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[e.key];
        if (!step) return;
        e.preventDefault();
        move(item.x + 0.1 * step[0], item.y + 0.1 * step[1]);
      });
      item.show = (there) => g.setAttribute("display", there ? "inline" : "none");
      items.push(item);
      return item;
    },
    /** Radio buttons below the figure; calls back with the value that is chosen. */
    choose(label, values, chosen) {
      const box = document.createElement("p"), choice = {value: chosen};
      box.append(`${label} `);
      for (const value of values) {
        const tag = document.createElement("label"), radio = document.createElement("input");
        Object.assign(radio, {type: "radio", name: `${id}-${label}`, checked: value === chosen});
        radio.addEventListener("change", () => { choice.value = value; redraw(); });
        tag.append(radio, ` ${value} `);
        box.append(tag);
      }
      output.before(box);
      return choice;
    },
  };
  const items = [];
  function redraw() {
    under.replaceChildren();
    draw(scene);
    for (const item of items) item.place();
  }
  scene.start = redraw;
  return scene;
}

/** Centre and radius of the circle through three points. */
function circleThrough(a, b, c) {
  const d = 2 * (a.x * (b.y - c.y) + b.x * (c.y - a.y) + c.x * (a.y - b.y));
  const q = (p) => p.x * p.x + p.y * p.y;
  const x = (q(a) * (b.y - c.y) + q(b) * (c.y - a.y) + q(c) * (a.y - b.y)) / d;
  const y = (q(a) * (c.x - b.x) + q(b) * (a.x - c.x) + q(c) * (b.x - a.x)) / d;
  return {x, y, radius: apart({x, y}, a)};
}

/** Solve the symmetric 3 x 3 system A x = b. */
function solve3(A, b) {
  const [[a, d, e], [, f, g], [, , h]] = A;
  const det = a * (f * h - g * g) - d * (d * h - g * e) + e * (d * g - f * e);
  const inverse = [
    [f * h - g * g, e * g - d * h, d * g - e * f],
    [e * g - d * h, a * h - e * e, d * e - a * g],
    [d * g - e * f, d * e - a * g, a * f - d * d],
  ].map((row) => row.map((v) => v / det));
  return {x: inverse.map((row) => row.reduce((s, v, k) => s + v * b[k], 0)), inverse};
}

/** Rows of the Jacobian of the bearings by (x, y, heading), and the residuals, at a pose. */
function linearised(pose, landmarks, bearings) {
  return landmarks.map((mark, k) => {
    const dx = mark.x - pose.x, dy = mark.y - pose.y, r2 = dx * dx + dy * dy + 1e-9;
    return {row: [dy / r2, -dx / r2, -1], miss: wrap(bearings[k] - (towards(pose, mark) - pose.heading))};
  });
}

function normalEquations(parts) {
  const A = [[0, 0, 0], [0, 0, 0], [0, 0, 0]], b = [0, 0, 0];
  for (const {row, miss} of parts) {
    for (let i = 0; i < 3; i++) {
      b[i] += row[i] * miss;
      for (let j = 0; j < 3; j++) A[i][j] += row[i] * row[j];
    }
  }
  return {A, b};
}

/** Resection: the pose that fits bearings to landmarks, by Gauss-Newton from a guess. */
function resect(landmarks, bearings, guess) {
  const cost = (pose) => linearised(pose, landmarks, bearings).reduce((s, p) => s + p.miss ** 2, 0);
  let pose = {...guess}, damp = 1e-3, now = cost(pose);
  for (let k = 0; k < 60; k++) {
    const {A, b} = normalEquations(linearised(pose, landmarks, bearings));
    for (let i = 0; i < 3; i++) A[i][i] *= 1 + damp;
    const step = solve3(A, b).x;
    const next = {x: pose.x + step[0], y: pose.y + step[1], heading: pose.heading + step[2]};
    const then = cost(next);
    if (then < now) { pose = next; now = then; damp /= 5; } else damp *= 8;
  }
  return {...pose, rms: Math.sqrt(now / landmarks.length)};
}

/** Points of the k-sigma ellipse of the position, for bearing noise `sigma` [rad]. */
function ellipse(pose, landmarks, sigma, k = 2) {
  const bearings = landmarks.map(() => 0);
  const {A, b} = normalEquations(linearised(pose, landmarks, bearings));
  const {inverse: P} = solve3(A, b);
  const [a, c, d] = [P[0][0], P[0][1], P[1][1]].map((v) => v * sigma * sigma);
  const mean = (a + d) / 2, half = Math.hypot((a - d) / 2, c), turn = 0.5 * Math.atan2(2 * c, a - d);
  const [p, q] = [Math.sqrt(Math.max(mean + half, 0)), Math.sqrt(Math.max(mean - half, 0))];
  const points = [...Array(73).keys()].map((n) => {
    const t = (n * Math.PI) / 36, u = k * p * Math.cos(t), v = k * q * Math.sin(t);
    return {x: pose.x + u * Math.cos(turn) - v * Math.sin(turn), y: pose.y + u * Math.sin(turn) + v * Math.cos(turn)};
  });
  return {points, longest: p};
}
