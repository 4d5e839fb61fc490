// Handles to drag by pointer or finger, or to select with Tab and move with arrow keys.
import {make} from "./view.js";

const STEP_M = 0.05, FAR_M = 0.5;
const ARROWS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
let strokes = Date.now() % 1e6; // moves of one stroke are undone together

/**
 * A handle named `label` in `view`; `moved(x, y, stroke, done)` is called with every move.
 * Unless it `turns` it is drawn upright; `held` is true while it is dragged.
 */
export function handle(view, label, moved, shape, turns = true) {
  const g = make("g", {class: "handle", role: "button", tabindex: 0, "aria-label": `${label}, to drag or to move with arrow keys`}, view.layers.handles);
  shape(g);
  make("circle", {r: 16, class: "touch"}, g);
  const thing = {g, x: 0, y: 0, heading: 0, held: false, label};
  thing.place = (x, y, heading = 0) => {
    if (x === thing.x && y === thing.y && heading === thing.heading && thing.scale === view.scale) return;
    Object.assign(thing, {x, y, heading, scale: view.scale});
    view.place(g, x, y, turns ? heading : 0);
  };
  thing.replace = () => { thing.scale = 0; thing.place(thing.x, thing.y, thing.heading); };
  const go = (x, y, done) => {
    if (!done || x !== thing.x || y !== thing.y) thing.place(x, y, thing.heading);
    moved(x, y, strokes, done);
  };
  g.addEventListener("pointerdown", (e) => {
    e.preventDefault();
    g.focus({preventScroll: true});
    g.setPointerCapture(e.pointerId);
    thing.held = true;
    thing.dragged = false;
    strokes += 1;
  });
  g.addEventListener("pointermove", (e) => {
    if (!thing.held) return;
    thing.dragged = true;
    go(...view.metres(e), false);
  });
  const end = (e) => {
    if (!thing.held) return;
    thing.held = false;
    if (thing.dragged) go(...view.metres(e), true);
  };
  g.addEventListener("pointerup", end);
  g.addEventListener("pointercancel", end);
  g.addEventListener("keydown", (e) => {
    const step = ARROWS[e.key];
    if (!step) return;
    e.preventDefault();
    e.stopPropagation();
    if (!e.repeat) strokes += 1;
    const by = e.shiftKey ? FAR_M : STEP_M;
    go(thing.x + by * step[0], thing.y + by * step[1], true);
  });
  return thing;
}
