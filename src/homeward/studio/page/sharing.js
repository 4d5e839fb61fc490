// What leaves the page: the scene in a link, files to save, and the picture as SVG and PNG.

const FRAMES = 60, EVERY_MS = 100;

export function download(name, blob) {
  const link = Object.assign(document.createElement("a"), {href: URL.createObjectURL(blob), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** A scenario as text for an address, and back; null where there is none. */
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

/** The picture as a file of its own: styles written into the elements, handles no more than drawn. */
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

export async function film(svg, tell) {
  for (let k = 1; k <= FRAMES; k++) {
    const began = performance.now();
    download(`frame-${String(k).padStart(3, "0")}.png`, await png(svg));
    tell(`Frame ${k} of ${FRAMES}.`);
    await new Promise((resolve) => setTimeout(resolve, Math.max(0, EVERY_MS - (performance.now() - began))));
  }
}
