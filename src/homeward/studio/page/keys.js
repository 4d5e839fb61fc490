// Driving with keys and with the pad on the page; repeated while they are held.

const WAYS = {ArrowUp: [1, 0], KeyW: [1, 0], ArrowDown: [-1, 0], KeyS: [-1, 0], ArrowLeft: [0, 1], KeyA: [0, 1], ArrowRight: [0, -1], KeyD: [0, -1]};
const AGAIN_MS = 100;

/** Calls `drive(v, omega)`, each in [-1, 1], while keys or pad are held; `shortcuts` by key. */
export function listen(drive, shortcuts) {
  const held = new Map();
  let timer = null;
  const update = () => {
    const sum = [...held.values()].reduce(([a, b], [v, w]) => [a + v, b + w], [0, 0]);
    drive(...sum.map((x) => Math.max(-1, Math.min(1, x))));
    if (!held.size) { clearInterval(timer); timer = null; }
  };
  const hold = (key, way) => {
    if (held.has(key)) return;
    held.set(key, way);
    update();
    timer ??= setInterval(update, AGAIN_MS);
  };
  const release = (key) => { if (held.delete(key)) update(); };
  addEventListener("keydown", (e) => {
    if (e.target.closest?.("input, select, textarea, button, summary")) return;
    if (e.code in WAYS && !e.ctrlKey && !e.metaKey) { e.preventDefault(); hold(e.code, WAYS[e.code]); return; }
    const name = (e.ctrlKey || e.metaKey ? "Ctrl+" : "") + e.key.toLowerCase();
    if (name in shortcuts) { e.preventDefault(); shortcuts[name](); }
  });
  addEventListener("keyup", (e) => release(e.code));
  addEventListener("blur", () => { for (const key of [...held.keys()]) release(key); });
  for (const button of document.querySelectorAll("#pad button")) {
    const way = [Number(button.dataset.v), Number(button.dataset.w)];
    button.addEventListener("pointerdown", (e) => { button.setPointerCapture(e.pointerId); hold(button, way); });
    for (const end of ["pointerup", "pointercancel", "blur"]) button.addEventListener(end, () => release(button));
    button.addEventListener("keydown", (e) => { if (e.key === "Enter" || e.key === " ") hold(button, way); });
    button.addEventListener("keyup", () => release(button));
  }
}
