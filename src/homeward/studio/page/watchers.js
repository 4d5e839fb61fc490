// Rays of sightings, and pose, ellipse, path and landmarks of each estimator.
import {make, wrap} from "./view.js";

const SIGMAS = 2, TRAIL = 600, JUMP_M = 0.5;
const COLOURS = {robust: "#0072b2", ekf: "#e69f00", "a-ekf": "#cc79a7", "pi-ekf": "#009e73", adaptive: "#d55e00", invariant: "#56b4e9",
  particle: "#a8a000", schmidt: "#8a5fbf", ukf: "#7a8b00"};
const OTHERS = ["#b3446c", "#604e97", "#008856"];
export const colour = (name, k = 0) => COLOURS[name] ?? OTHERS[k % OTHERS.length];

export class Watchers {
  constructor(view) {
    this.view = view;
    this.bound = make("circle", {class: "bound", "data-bound": "", r: 0}, view.layers.marks);
    this.rays = new Map();
    this.rivals = new Map();
    this.path = make("path", {class: "driven"}, view.layers.trails);
    this.points = [];
  }

  /** Create the elements of each estimator. */
  show(scene) {
    this.scene = scene;
    for (const [name, r] of this.rivals) {
      if (scene.estimators.includes(name)) continue;
      for (const part of [r.g, r.trail, r.marks]) part.remove();
      this.rivals.delete(name);
    }
    scene.estimators.forEach((name, k) => {
      if (this.rivals.has(name)) return;
      const own = {style: `--own:${colour(name, k)}`, "data-rival": name}, {layers} = this.view;
      const g = make("g", {...own, display: "none"}, layers.estimates);
      const ellipse = make("ellipse", {class: "estimate"}, g);
      make("path", {d: "M11 0L-7 6L-3 0L-7-6Z", class: "pose"}, g);
      const trail = make("path", {...own, class: "trail"}, layers.trails);
      this.rivals.set(name, {g, ellipse, trail, marks: make("g", own, layers.marks), points: []});
    });
  }

  /** Clear all paths. */
  clear() {
    this.points = [];
    for (const r of this.rivals.values()) r.points = [];
  }

  /** Draw the parts of a new frame that are not interpolated. */
  take(frame) {
    const {view} = this;
    this.points = [...this.points.slice(-TRAIL), frame.robot];
    this.path.setAttribute("d", view.line(this.points, JUMP_M));
    for (const [name, r] of this.rivals) {
      const state = frame.rivals[name];
      r.g.setAttribute("display", state?.pose ? "inline" : "none");
      r.points = state?.pose ? [...r.points.slice(-TRAIL), state.pose] : [];
      r.trail.setAttribute("d", view.line(r.points, JUMP_M));
      const e = state?.ellipse;
      if (e) {
        r.ellipse.setAttribute("rx", Math.min(SIGMAS * e[0] * view.scale, 5000));
        r.ellipse.setAttribute("ry", Math.min(SIGMAS * e[1] * view.scale, 5000));
        r.turn = e[2];
      }
      const key = JSON.stringify(state?.marks ?? {}) + view.scale;
      if (key !== r.key) {
        r.key = key;
        r.marks.setAttribute("class", "mark");
        const d = Object.values(state?.marks ?? {}).map((at) => { const [x, y] = view.px(...at); return `M${x - 4} ${y - 4}l8 8m0-8l-8 8`; });
        r.marks.replaceChildren();
        make("path", {d: d.join("")}, r.marks);
      }
    }
    this.see(frame);
    this.bound.setAttribute("r", frame.bound === null ? 0 : (SIGMAS * frame.bound * view.scale).toFixed(2));
  }

  see(frame) {
    const {view, scene} = this;
    for (const [id, ray] of this.rays) if (!(id in frame.seen)) { ray.remove(); this.rays.delete(id); }
    const [cx, cy, heading] = frame.camera, [u, v] = view.px(cx, cy);
    for (const [id, bearing] of Object.entries(frame.seen)) {
      const at = scene.landmarks[id];
      if (!at) continue;
      const ray = this.rays.get(id) ?? make("line", {class: "ray", "data-ray": id}, view.layers.rays);
      this.rays.set(id, ray);
      const far = Math.hypot(at[0] - cx, at[1] - cy), way = heading + bearing;
      const [x, y] = view.px(cx + far * Math.cos(way), cy + far * Math.sin(way));
      for (const [key, value] of Object.entries({x1: u, y1: v, x2: x, y2: y})) ray.setAttribute(key, value.toFixed(1));
    }
  }

  /** Interpolate between two frames by `share`. */
  draw(before, after, share) {
    const mix = (a, b) => [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * wrap(b[2] - a[2])];
    const jumped = (a, b) => !a || Math.hypot(a[0] - b[0], a[1] - b[1]) > JUMP_M;
    const robot = jumped(before.robot, after.robot) ? after.robot : mix(before.robot, after.robot);
    const [x, y] = this.view.px(robot[0], robot[1]);
    this.bound.setAttribute("transform", `translate(${x.toFixed(2)} ${y.toFixed(2)})`);
    for (const [name, r] of this.rivals) {
      const now = after.rivals[name]?.pose, old = before.rivals[name]?.pose;
      if (!now) continue;
      const pose = jumped(old, now) ? now : mix(old, now);
      this.view.place(r.g, ...pose);
      r.ellipse.setAttribute("transform", `rotate(${(((pose[2] - (r.turn ?? 0)) * 180) / Math.PI).toFixed(2)})`);
    }
    return robot;
  }
}
