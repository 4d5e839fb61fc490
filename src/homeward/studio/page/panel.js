// Panel: status and errors of each estimator, and controls.
import {colour} from "./watchers.js";

const $ = (id) => document.getElementById(id);
const DEG = 180 / Math.PI;
const SLIDERS = [
  ["noise.bearing_sigma", "noise of bearings", 0, 5, 0.1, "°", 1 / DEG],
  ["noise.wrong_ids", "wrong ids", 0, 0.3, 0.01, "", 1],
  ["visibility.probability", "detection rate", 0, 1, 0.05, "", 1],
  ["visibility.field_of_view", "field of view", 30, 360, 10, "°", 1 / DEG],
  ["visibility.range", "maximum range", 1, 20, 0.5, " m", 1],
  ["sensor.x", "camera ahead", -0.5, 0.5, 0.02, " m", 1],
  ["sensor.y", "camera to the left", -0.5, 0.5, 0.02, " m", 1],
  ["sensor.yaw", "camera yaw", -180, 180, 1, "°", 1 / DEG],
];

function element(name, more, ...children) {
  const made = Object.assign(document.createElement(name), more);
  made.append(...children);
  return made;
}

/** The sliders; `set(key, value, stroke)` is called with every change. Returns objects that show values. */
function sliders(host, set) {
  let stroke = 0;
  return SLIDERS.map(([key, label, min, max, step, unit, factor]) => {
    const input = element("input", {type: "range", min, max, step, id: `set-${key}`});
    const output = element("output", {}), state = () => { output.textContent = Number(input.value).toFixed(step < 1 ? (step < 0.1 ? 2 : 1) : 0) + unit; };
    input.setAttribute("aria-label", label);
    input.addEventListener("pointerdown", () => { stroke += 1; });
    input.addEventListener("input", () => { state(); set(key, Number(input.value) * factor, stroke); });
    host.append(element("div", {className: "slider"}, element("label", {htmlFor: input.id, textContent: label}), input, output));
    return {key, show(value) { if (document.activeElement !== input) input.value = value / factor; state(); }};
  });
}

export class Panel {
  constructor(send) {
    this.send = send;
    this.cards = new Map();
    this.sliders = sliders($("sliders"), (key, value, stroke) => {
      const least = this.scene?.settings.visibility.range[0] ?? 0;
      send({do: "set", key, value: key === "visibility.range" ? [Math.min(least, value), value] : value, stroke});
    });
    const steer = () => send({do: "steer", by: $("by").value, law: $("law").value, pose_source: $("pose-source").value});
    for (const id of ["by", "law", "pose-source"]) $(id).addEventListener("change", (e) => { steer(); e.target.blur(); });
  }

  show(scene) {
    this.scene = scene;
    const at = (key) => key.split(".").reduce((tree, part) => tree[part], scene.settings);
    for (const slider of this.sliders) {
      const value = at(slider.key);
      slider.show(Array.isArray(value) ? value[1] : value);
    }
    $("by").value = scene.steer.by;
    $("law").value = scene.steer.law;
    $("law-box").hidden = scene.steer.by !== "law";
    $("pose-source-box").hidden = !["law", "path"].includes(scene.steer.by);
    const sources = ["truth", ...scene.estimators];
    $("pose-source").replaceChildren(...sources.map((name) => element("option", {value: name, textContent: name === "truth" ? "ground truth" : name})));
    $("pose-source").value = sources.includes(scene.steer.pose_source) ? scene.steer.pose_source : "truth";
    this.choices(scene);
  }

  /** Choice of estimators, and a card for each. */
  choices(scene) {
    $("undo").disabled = !scene.undo;
    const key = JSON.stringify([scene.known, scene.estimators]);
    if (key === this.key) return;
    this.key = key;
    $("known").replaceChildren(...scene.known.map((name) => {
      const box = element("input", {type: "checkbox", checked: scene.estimators.includes(name), value: name});
      box.addEventListener("change", () => {
        const names = [...document.querySelectorAll("#known input:checked")].map((i) => i.value);
        this.send({do: "estimators", names});
      });
      return element("label", {}, box, ` ${name}`);
    }));
    this.cards.clear();
    $("rivals").replaceChildren(...scene.estimators.map((name, k) => {
      const card = {status: element("span", {}), reason: element("p", {className: "reason"}), moved: element("p", {className: "moved"}),
        figures: element("p", {className: "figures"})};
      const host = element("section", {className: "rival"}, element("h2", {textContent: name}, card.status), card.reason, card.moved, card.figures);
      host.style.setProperty("--own", colour(name, k));
      host.dataset.rival = name;
      this.cards.set(name, card);
      return host;
    }));
  }

  /** Show the state of each estimator. */
  update(frame) {
    $("clock").textContent = `${frame.t.toFixed(0)} s`;
    put($("best"), frame.bound === null ? "" : `Minimum position error of any estimator (Cramér-Rao bound): ${(100 * frame.bound).toFixed(1)} cm (one sigma).`);
    for (const [name, card] of this.cards) {
      const state = frame.rivals[name];
      if (!state) continue;
      const moved = Object.entries(state.moved ?? {}).map(([id, p]) => `${id} (${(100 * p).toFixed(0)} %)`);
      const known = state.error ?? null;
      const figures = known === null ? (state.pose ? "" : "no pose") : `error ${known.toFixed(2)} m; NEES ${large(state.nees)}` + (state.nees_mean === undefined ? "" : `, mean ${large(state.nees_mean)}`);
      const wrong = known !== null && state.overconfident;
      put(card.status, wrong ? `${state.status}, but overconfident` : state.status);
      put(card.reason, wrong ? "Ground truth is outside the 95 % region of this estimate." : state.reason);
      put(card.moved, moved.length ? `Moved since home: ${moved.join(", ")}` : "");
      put(card.figures, figures + ((state.update_ms ?? null) === null ? "" : `; ${state.update_ms.toFixed(1)} ms per update`));
    }
  }
}

const large = (nees) => (nees < 1000 ? nees.toFixed(1) : "over 1000");

function put(host, words) {
  if (host.textContent !== words) host.textContent = words;
}
