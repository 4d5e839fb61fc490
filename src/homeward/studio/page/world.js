// The room: walls, shelves, landmarks, home and robot, which can be dragged.
import {handle} from "./handles.js";
import {make} from "./view.js";

const HOUSE = "M-9 9H9V-2L0-11L-9-2Z", KITE = "M13 0L-9 8L-4 0L-9-8Z";
const APART = 0.02; // landmarks farther from their previous position are shown as moved [m]
const NOSE_M = 0.55;

export class World {
  constructor(view, send) {
    this.view = view;
    this.send = send;
    this.marks = new Map();
    const move = (what, more = {}) => (x, y, stroke, done) => done && send({do: "move", what, x, y, stroke, ...more});
    this.home = handle(view, "home", move("home"), (g) => make("path", {d: HOUSE, class: "home"}, g), false);
    this.robot = handle(view, "robot", move("robot"), (g) => make("path", {d: KITE, class: "robot"}, g));
    this.nose = this.knob("heading of the robot", "robot", () => this.robot);
    this.door = this.knob("heading of home", "home", () => this.home);
    for (const thing of [this.robot, this.nose]) thing.g.setAttribute("display", "none"); // until its first pose
    view.fitted = () => this.refit();
  }

  knob(label, what, owner) {
    return handle(this.view, label, (x, y, stroke, done) => {
      const at = owner();
      if (done) this.send({do: "move", what, x: at.x, y: at.y, heading: Math.atan2(y - at.y, x - at.x), stroke});
    }, (g) => {
      g.classList.add("knob");
      make("circle", {r: 3.5, class: "robot"}, g);
    });
  }

  /** Draw the static part. */
  show(scene) {
    this.scene = scene;
    this.view.fit(scene.extent);
  }

  refit() {
    const {scene, view} = this;
    if (!scene) return;
    const ground = view.layers.ground;
    ground.replaceChildren();
    const box = ([x0, y0, x1, y1], kind) => {
      const [x, y] = view.px(x0, y1);
      make("rect", {x, y, width: (x1 - x0) * view.scale, height: (y1 - y0) * view.scale, class: kind}, ground);
    };
    box(scene.room?.bounds ?? scene.extent, "wall");
    const grid = make("g", {class: "grid"}, ground), [x0, y0, x1, y1] = scene.extent;
    const line = (a, b) => { const [x, y] = view.px(...a), [u, v] = view.px(...b); make("line", {x1: x, y1: y, x2: u, y2: v}, grid); };
    for (let x = Math.ceil(x0); x <= x1; x++) line([x, y0], [x, y1]);
    for (let y = Math.ceil(y0); y <= y1; y++) line([x0, y], [x1, y]);
    for (const shelf of scene.room?.shelves ?? []) box(shelf, "shelf");
    if (scene.path.length) make("path", {d: view.line(scene.path), class: "way"}, ground);
    for (const [id, at] of Object.entries(scene.previous)) {
      const now = scene.landmarks[id];
      if (Math.hypot(at[0] - now[0], at[1] - now[1]) < APART) continue;
      const [x, y] = view.px(...at), [u, v] = view.px(...now);
      make("line", {x1: x, y1: y, x2: u, y2: v, class: "previous"}, ground);
      make("circle", {cx: x, cy: y, r: 6, class: "previous", "data-previous": id}, ground);
    }
    this.landmarks();
    for (const thing of [this.home, this.robot, this.nose, this.door]) thing.replace();
    if (!this.home.held) this.home.place(...scene.home);
    this.ahead(this.door, this.home);
  }

  landmarks() {
    const {scene, view} = this;
    for (const [id, mark] of this.marks) {
      if (!(id in scene.landmarks)) { mark.g.remove(); this.marks.delete(id); }
    }
    for (const [id, [x, y]] of Object.entries(scene.landmarks)) {
      let mark = this.marks.get(id);
      if (!mark) {
        let last = 0;
        mark = handle(view, `landmark ${id}`, (px, py, stroke, done) => {
          if (!done && performance.now() - last < 50) return;
          last = performance.now();
          this.send({do: "move", what: "landmark", name: id, x: px, y: py, stroke});
        }, (g) => {
          make("circle", {r: 6, class: "landmark"}, g);
          make("text", {x: 9, y: -7}, g).textContent = id;
        });
        mark.g.dataset.id = id;
        mark.dot = mark.g.firstChild;
        mark.g.addEventListener("keydown", (e) => {
          if (e.key === "Delete" || e.key === "Backspace") this.send({do: "remove", name: id});
        });
        this.marks.set(id, mark);
      }
      mark.replace();
      if (!mark.held) mark.place(x, y);
      const [a, b] = scene.previous[id];
      mark.dot.classList.toggle("odd", Math.hypot(a - x, b - y) >= APART);
      mark.dot.classList.toggle("unseen", !scene.stored.includes(id));
    }
  }

  /** Place a heading knob ahead of its owner. */
  ahead(knob, owner, heading = owner.heading) {
    if (knob.held) return;
    const far = Math.max(NOSE_M, 26 / this.view.scale);
    knob.place(owner.x + far * Math.cos(heading), owner.y + far * Math.sin(heading));
  }

  /** Draw the robot at its pose. */
  drive([x, y, heading]) {
    for (const thing of [this.robot, this.nose]) thing.g.removeAttribute("display");
    if (!this.robot.held && !this.nose.held) {
      this.robot.place(x, y, heading);
      this.ahead(this.nose, this.robot, heading);
    }
  }
}
