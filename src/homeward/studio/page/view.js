// The picture's coordinates: metres in the room, x to the right and y up, and how they fit the page.

const NS = "http://www.w3.org/2000/svg";

export function make(name, attributes, parent) {
  const made = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

export const wrap = (a) => Math.atan2(Math.sin(a), Math.cos(a));

export class View {
  constructor(svg) {
    this.svg = svg;
    this.extent = [-3, -3, 3, 3];
    this.scale = 100;
    this.layers = Object.fromEntries(
      ["ground", "trails", "rays", "marks", "estimates", "handles"]
        .map((name) => [name, make("g", {"data-layer": name}, svg)]),
    );
    new ResizeObserver(() => this.fit(this.extent)).observe(svg);
    this.fitted = () => {};
  }

  /** Show a rectangle [x_min, y_min, x_max, y_max] in metres; units of the SVG are CSS pixels. */
  fit(extent) {
    const box = this.svg.getBoundingClientRect(), margin = 36;
    this.extent = extent;
    const [x0, y0, x1, y1] = extent;
    this.scale = Math.max(Math.min((box.width - 2 * margin) / (x1 - x0), (box.height - 2 * margin) / (y1 - y0)), 1);
    this.middle = [(x0 + x1) / 2, (y0 + y1) / 2];
    document.body.style.setProperty("--ratio", (y1 - y0) / (x1 - x0));
    this.svg.setAttribute("viewBox", `${-box.width / 2} ${-box.height / 2} ${box.width || 1} ${box.height || 1}`);
    this.fitted();
  }

  px(x, y) {
    return [(x - this.middle[0]) * this.scale, (this.middle[1] - y) * this.scale];
  }

  metres(event) {
    const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    return [p.x / this.scale + this.middle[0], this.middle[1] - p.y / this.scale];
  }

  place(element, x, y, heading = 0) {
    const [u, v] = this.px(x, y);
    element.setAttribute("transform", `translate(${u.toFixed(2)} ${v.toFixed(2)}) rotate(${((-heading * 180) / Math.PI).toFixed(2)})`);
  }

  /** A path through points, interrupted where the distance exceeds `far`. */
  line(points, far = Infinity) {
    return points.map(([x, y], k) => {
      const jumped = !k || Math.hypot(x - points[k - 1][0], y - points[k - 1][1]) > far;
      return (jumped ? "M" : "L") + this.px(x, y).map((v) => v.toFixed(1)).join(" ");
    }).join("");
  }
}
