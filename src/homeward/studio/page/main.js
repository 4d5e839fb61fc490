// The page: a socket to the session, a picture that is drawn with every frame of the screen, and the panel.
import * as keys from "./keys.js";
import {Panel} from "./panel.js";
import {download, film, fromFragment, png, svgText, toFragment} from "./sharing.js";
import {View} from "./view.js";
import {Watchers} from "./watchers.js";
import {World} from "./world.js";

const $ = (id) => document.getElementById(id);
const svg = $("picture"), text = $("text");
const socket = new WebSocket(`ws://${location.host}/`);
const send = (message) => { if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };
const view = new View(svg), world = new World(view, send), watchers = new Watchers(view), panel = new Panel(send);
let scene = null, before = null, after = null, arrived = 0, interval = 50, playing = true, wrong = 0, drawn = 0;

function display(words, error = false) {
  if (!error && performance.now() < wrong) return;
  if (error) wrong = performance.now() + 4000;
  text.classList.toggle("error", error);
  if (text.textContent !== words) text.textContent = words;
}

const handlers = {
  scene(state) {
    if (scene && state.begun !== scene.begun) { watchers.clear(); before = after = null; }
    scene = state;
    world.show(state);
    watchers.show(state);
    panel.show(state);
  },
  frame(state) {
    const now = performance.now();
    before = after ?? state;
    after = state;
    interval = Math.min(Math.max(0.8 * interval + 0.2 * (now - arrived), 10), 200);
    arrived = now;
    watchers.take(state);
    panel.update(state);
    display(state.text || "Drag a landmark during the drive: robust reports it as moved after some sightings.");
  },
  file(state) { download(state.name, new Blob([state.text], {type: "text/plain"})); },
  error(state) { display(state.text, true); },
};

socket.addEventListener("open", () => {
  send({do: "hello", token: new URLSearchParams(location.search).get("token") ?? ""});
  let shared = null;
  try { shared = fromFragment(location.hash); } catch { display("This link contains no scene.", true); }
  if (shared) send({do: "open", scene: shared});
});
socket.addEventListener("message", (e) => { const state = JSON.parse(e.data); handlers[state.type]?.(state); });
socket.addEventListener("close", () => { wrong = 0; display("The studio has ended, or this address is old. Start homeward studio again.", true); });

function draw() {
  drawn += 1;
  if (before && after) {
    const share = Math.min((performance.now() - arrived) / interval, 1);
    world.drive(watchers.draw(before, after, share));
  }
  requestAnimationFrame(draw);
}
requestAnimationFrame(draw);

const pace = () => send({do: "pace", pace: playing ? Number($("pace").value) : 0});
function toggle() {
  playing = !playing;
  $("play").textContent = playing ? "Pause" : "Play";
  pace();
}
$("play").addEventListener("click", toggle);
$("pace").addEventListener("change", (e) => { pace(); e.target.blur(); });
$("again").addEventListener("click", () => send({do: "again"}));
$("undo").addEventListener("click", () => send({do: "undo"}));
$("save").addEventListener("click", () => send({do: "save"}));
$("svg").addEventListener("click", () => download("studio.svg", new Blob([svgText(svg)], {type: "image/svg+xml"})));
$("png").addEventListener("click", async () => download("studio.png", await png(svg)));
$("film").addEventListener("click", async () => download("frames.tar", await film(svg, display)));
$("link").addEventListener("click", async () => {
  location.hash = toFragment(scene.scenario);
  const there = location.origin + "/#" + toFragment(scene.scenario);
  await navigator.clipboard?.writeText(there).catch(() => {});
  display("The link is in the address of this page and, without your token, in the clipboard.");
});
svg.addEventListener("dblclick", (e) => {
  if (e.target.closest(".handle") || !scene) return;
  const [x, y] = view.metres(e);
  send({do: "add", x, y});
});
keys.listen((v, omega) => {
  if (scene && scene.steer.by !== "keys") {
    $("by").value = "keys";
    $("by").dispatchEvent(new Event("change"));
  }
  send({do: "keys", v, omega});
}, {" ": toggle, "Ctrl+z": () => send({do: "undo"})});

// For tests and measurements.
Object.defineProperty(window, "studio", {value: {get drawn() { return drawn; }, get frame() { return after; }, get scene() { return scene; }}});
