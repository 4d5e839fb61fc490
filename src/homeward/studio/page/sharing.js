// Export: the scene as a link, files, and the picture as SVG and PNG.

const FRAMES = 60, EVERY_MS = 100;

export function download(name, blob) {
  const link = Object.assign(document.createElement("a"), {href: URL.createObjectURL(blob), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Convert a scenario to text for an address. */
export function toFragment(scenario) {
  const bytes = new TextEncoder().encode(JSON.stringify(scenario));
  return "scene=" + btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

export function fromFragment(text) {
  const found = text.match(/scene=([\w-]+)/);
  if (!found) return null;
  const bytes = atob(found[1].replaceAll("-", "+").replaceAll("_", "/"));
  return JSON.parse(new TextDecoder().decode(Uint8Array.from(bytes, (c) => c.charCodeAt(0))));
}

const KEPT = ["display", "fill", "fill-opacity", "stroke", "stroke-width", "stroke-opacity", "stroke-dasharray", "stroke-linejoin", "font"];

/** The picture as an SVG file, with styles in its elements and without interactive handles. */
export function svgText(svg) {
  const copy = svg.cloneNode(true), box = svg.getBoundingClientRect();
  const from = svg.querySelectorAll("*"), to = copy.querySelectorAll("*");
  from.forEach((source, k) => {
    const style = getComputedStyle(source);
    for (const key of KEPT) to[k].style.setProperty(key, style.getPropertyValue(key));
    for (const name of ["tabindex", "role"]) to[k].removeAttribute(name);
  });
  for (const touch of copy.querySelectorAll(".touch")) touch.remove();
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.setAttribute("width", box.width);
  copy.setAttribute("height", box.height);
  copy.style.background = getComputedStyle(svg).backgroundColor;
  return new XMLSerializer().serializeToString(copy);
}

export async function png(svg) {
  const image = new Image(), box = svg.getBoundingClientRect();
  image.src = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(svgText(svg));
  await image.decode();
  const canvas = Object.assign(document.createElement("canvas"), {width: 2 * box.width, height: 2 * box.height});
  const paint = canvas.getContext("2d");
  paint.scale(2, 2);
  paint.drawImage(image, 0, 0, box.width, box.height);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

/** The next pictures as one tar file. */
export async function film(svg, onProgress, frames = FRAMES) {
  const parts = [];
  for (let k = 1; k <= frames; k++) {
    const began = performance.now(), image = await png(svg);
    parts.push(tarHead(`frame-${String(k).padStart(3, "0")}.png`, image.size), image, new Uint8Array(-image.size & 511));
    onProgress(`Frame ${k} of ${frames}.`);
    await new Promise((resolve) => setTimeout(resolve, Math.max(0, EVERY_MS - (performance.now() - began))));
  }
  return new Blob([...parts, new Uint8Array(1024)], {type: "application/x-tar"});
}

/** Header of a file in a tar (ustar): 512 bytes of text, numbers in octal. */
function tarHead(name, size) {
  const head = new Uint8Array(512);
  const write = (at, text) => head.set(new TextEncoder().encode(text), at);
  const octal = (value, digits) => value.toString(8).padStart(digits, "0");
  write(0, name);
  write(100, "0000644\0" + "0000000\0" + "0000000\0" + octal(size, 11) + " " + octal(Math.floor(Date.now() / 1000), 11) + " ");
  write(148, " ".repeat(8) + "0");
  write(257, "ustar\0" + "00");
  write(148, octal(head.reduce((sum, byte) => sum + byte, 0), 6) + "\0 ");
  return head;
}
