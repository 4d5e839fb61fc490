// Beside the picture: how each estimator fares, in words and figures, and what can be set.
import {colour} from "./watchers.js";

const $ = (id) => document.getElementById(id);
const DEG = 180 / Math.PI;
const NEES_95 = 7.8; // 95 % of chi-square with three degrees of freedom
const SLIDERS = [
  ["noise.bearing_sigma", "noise of bearings", 0, 5, 0.1, "°", 1 / DEG],
  ["noise.wrong_ids", "wrong names", 0, 0.3, 0.01, "", 1],
  ["visibility.probability", "seen with chance", 0, 1, 0.05, "", 1],
  ["visibility.field_of_view", "field of view", 30, 360, 10, "°", 1 / DEG],
  ["visibility.range", "sees as far as", 1, 20, 0.5, " m", 1],
  ["sensor.x", "camera ahead", -0.5, 0.5, 0.02, " m", 1],
  ["sensor.y", "camera to the left", -0.5, 0.5, 0.02, " m", 1],
  ["sensor.yaw", "camera turned", -180, 180, 1, "°", 1 / DEG],
];

function element(name, more, ...children) {
  const made = Object.assign(document.createElement(name), more);
  made.append(...children);
  return made;
}

/** Sliders for `list`; `set(key, value, stroke)` is told of every change. Returns what shows values. */
export function sliders(host, list, set) {
  let stroke = 0;
  const shown = list.map(([key, label, min, max, step, unit, factor]) => {
    const input = element("input", {type: "range", min, max, step, id: `set-${key}`});
    const output = element("output", {}), told = () => { output.textContent = Number(input.value).toFixed(step < 1 ? (step < 0.1 ? 2 : 1) : 0) + unit; };
    input.setAttribute("aria-label", label);
    input.addEventListener("pointerdown", () => { stroke += 1; });
    input.addEventListener("input", () => { told(); set(key, Number(input.value) * factor, stroke); });
    host.append(element("div", {className: "slider"}, element("label", {htmlFor: input.id, textContent: label}), input, output));
    return {key, show(value) { if (document.activeElement !== input) input.value = value / factor; told(); }};
  });
  return shown;
}

export class Panel {
  constructor(send) {
    this.send = send;
    this.cards = new Map();
    this.sliders = sliders($("sliders"), SLIDERS, (key, value, stroke) => {
      const least = this.scene?.settings.visibility.range[0] ?? 0;
      send({do: "set", key, value: key === "visibility.range" ? [Math.min(least, value), value] : value, stroke});
    });
    const steer = () => send({do: "steer", by: $("by").value, law: $("law").value, believing: $("believing").value});
    for (const id of ["by", "law", "believing"]) $(id).addEventListener("change", (e) => { steer(); e.target.blur(); });
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
    $("believing-box").hidden = !["law", "path"].includes(scene.steer.by);
    const believed = ["truth", ...scene.estimators];
    $("believing").replaceChildren(...believed.map((name) => element("option", {textContent: name})));
    $("believing").value = believed.includes(scene.steer.believing) ? scene.steer.believing : "truth";
    this.choices(scene);
  }

  /** Which estimators run, to choose; and a card of each. */
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

  /** Say how each fares now. */
  tell(frame) {
    $("clock").textContent = `${frame.t.toFixed(0)} s`;
    put($("best"), frame.bound === null ? "" : `Nobody could know it better than to ${(100 * frame.bound).toFixed(1)} cm (one sigma; the bound).`);
    for (const [name, card] of this.cards) {
      const told = frame.rivals[name];
      if (!told) continue;
      const moved = Object.entries(told.moved ?? {}).map(([id, p]) => `${id} (${(100 * p).toFixed(0)} %)`);
      const known = told.error ?? null;
      const figures = known === null ? (told.pose ? "" : "no pose") : `${known.toFixed(2)} m off; NEES ${large(told.nees)}` +
        (told.nees > NEES_95 ? ", outside 95 %" : "") + (told.nees_mean === undefined ? "" : `, mean ${large(told.nees_mean)}`);
      put(card.status, told.status);
      put(card.reason, told.reason);
      put(card.moved, moved.length ? `Moved since home: ${moved.join(", ")}` : "");
      put(card.figures, figures + (told.update_ms === undefined ? "" : `; ${told.update_ms.toFixed(1)} ms an update`));
    }
  }
}

const large = (nees) => (nees < 1000 ? nees.toFixed(1) : "over 1000");

function put(host, words) {
  if (host.textContent !== words) host.textContent = words;
}
