// A place: its visits, homes and routes.

const $ = (id) => document.getElementById(id);
const EVERY_MS = 700;

export class Visits {
  constructor(world) {
    this.world = world;
    this.chosen = () => {};
    this.playing = false;
  }

  /** Store all visits, and show the last. */
  take(scene) {
    this.scene = scene;
    const last = scene.visits.length - 1;
    document.querySelector("label[for=moment]").textContent = "Visit";
    Object.assign($("moment"), {max: last, value: last});
    $("scrub").hidden = false;
    for (const id of ["driving", "sensing", "choosing", "alike"]) $(id).hidden = true;
    for (const id of ["again", "undo", "pace", "link", "save"]) $(id).closest("label, button").hidden = true;
    const lines = scene.lines.map((words) => Object.assign(document.createElement("p"), {textContent: words}));
    $("rivals").replaceChildren(...lines);
    setInterval(() => this.tick(), EVERY_MS);
  }

  /** Draw the selected visit; return its description. */
  draw() {
    const {visits} = this.scene, now = visits[Math.min(Number($("moment").value), visits.length - 1)];
    this.world.show({...this.scene, ...now});
    $("moment").setAttribute("aria-valuetext", `visit ${now.number}`);
    $("clock").textContent = `visit ${now.number} of ${visits.at(-1).number}`;
    return now.text;
  }

  /** Play the visits, from the first one if the last is shown. */
  play(playing) {
    const there = $("moment");
    if (playing && Number(there.value) >= Number(there.max)) there.value = 0;
    this.playing = playing;
  }

  tick() {
    if (!this.playing || Number($("moment").value) >= Number($("moment").max)) return;
    $("moment").value = Number($("moment").value) + 1;
    this.chosen();
  }
}
