// A recorded drive: move along it, run it with other extrinsics, lag or noise, mark moved landmarks.
import {sliders} from "./panel.js";

const $ = (id) => document.getElementById(id);
const DEG = 180 / Math.PI;
const SLIDERS = [
  ["x", "camera ahead", -1, 1, 0.02, " m", 1],
  ["y", "camera to the left", -1, 1, 0.02, " m", 1],
  ["yaw", "camera yaw", -180, 180, 1, "°", 1 / DEG],
  ["bearings_late", "bearings late by", -1, 1, 0.02, " s", 1],
  ["bearing_sigma", "noise of bearings", 0.05, 10, 0.05, "°", 1 / DEG],
];
const SETTLED_MS = 250;

function compose([x, y, heading], [u, v, turn]) {
  const c = Math.cos(heading), s = Math.sin(heading);
  return [x + c * u - s * v, y + s * u + c * v, heading + turn];
}

export class Replay {
  constructor(view, send) {
    this.view = view;
    this.send = send;
    this.chosen = this.busy = () => {};
    this.run = null;
    this.playing = false;
    $("moment").addEventListener("input", () => { this.chosen(); });
  }

  /** Create the controls once, and show their values. */
  show(scene) {
    if (!this.sliders) {
      for (const id of ["driving", "alike"]) $(id).hidden = true;
      for (const id of ["scrub", "marking"]) $(id).hidden = false;
      for (const id of ["again", "pace", "link"]) $(id).disabled = true;
      $("save").textContent = scene.file;
      $("sliders").replaceChildren();
      this.sliders = sliders($("sliders"), SLIDERS, (key, value, stroke) => this.adjust({[key]: value, stroke}));
      setInterval(() => this.tick(), 100);
    }
    this.asked = {...scene.adjusted};
    for (const slider of this.sliders) slider.show(scene.adjusted[slider.key] ?? 1 / DEG);
    const names = Object.keys(scene.landmarks);
    $("marks").replaceChildren(...scene.stored.map((id) => {
      const label = document.createElement("label"), box = Object.assign(document.createElement("input"), {type: "checkbox", checked: scene.adjusted.moved.includes(id)});
      box.addEventListener("change", () => {
        const moved = this.asked.moved.filter((other) => other !== id);
        this.adjust({moved: box.checked ? [...moved, id] : moved, stroke: Math.random() * 1e9 | 0});
      });
      label.append(box, ` ${id}`);
      return label;
    }), names.length ? "" : "No landmark has a position yet.");
  }

  adjust(change) {
    Object.assign(this.asked, change);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.send({do: "adjust", ...this.asked});
      this.busy("Running the estimators …");
    }, SETTLED_MS);
  }

  take(run) {
    this.run = run;
    $("moment").max = run.t.length - 1;
  }

  play(playing) { this.playing = playing; }

  tick() {
    if (!this.run || !this.playing || Number($("moment").value) >= this.run.t.length - 1) return;
    $("moment").value = Number($("moment").value) + 1;
    this.chosen();
  }

  /** The selected time, as a frame of a scene. */
  frame() {
    const {run} = this;
    if (!run) return null;
    const k = Math.min(Number($("moment").value), run.t.length - 1);
    const rivals = Object.fromEntries(Object.entries(run.rivals).map(([name, r]) => [name, r.failure ? {status: "failed", reason: r.failure, moved: {}, marks: {}} : {
      status: r.status[k], reason: r.reason[k], moved: r.moved[k], marks: r.marks, pose: r.pose[k] ?? undefined, ellipse: r.ellipse[k], error: r.error[k] ?? undefined, nees: r.nees[k], overconfident: r.overconfident[k]}]));
    const trails = Object.fromEntries(Object.entries(run.rivals).map(([name, r]) => [name, (r.pose ?? []).slice(0, k + 1).filter(Boolean)]));
    if (run.truth) trails.truth = run.truth.slice(0, k + 1);
    const robot = run.truth?.[k] ?? rivals[Object.keys(rivals)[0]]?.pose ?? [0, 0, 0];
    return {t: run.t[k], robot, camera: compose(robot, run.camera), seen: run.seen[k], bound: null, rivals, trails, text: run.text};
  }
}
