// The persistence diagram, or the barcode, as SVG. What counts as a hole can be chosen, and is then marked on the map.

import { length, roundBelow } from "./format.js";

const NAMESPACE = "http://www.w3.org/2000/svg";
const WIDTH = 520, HEIGHT = 300;
const FRAME = { left: 48, right: 14, top: 16, bottom: 38 };
const SHOWN_BARS = 26;

export class DiagramView {
  constructor(root, { onChoose }) {
    this.root = root;
    this.onChoose = onChoose;
    this.diagram = null;
    this.isBarcode = false;
    this.holeOf = () => null;
  }

  /** `holes` are those of the map of the same version: an interval that is real belongs to one of them. */
  show(diagram, holes) {
    this.diagram = diagram;
    this.holeOf = (interval) => {
      const index = holes.findIndex((hole) => hole.component === interval.component && hole.birth === interval.birth && hole.death === interval.death);
      return index < 0 ? null : index;
    };
    this.draw();
  }

  setBarcode(isBarcode) {
    this.isBarcode = isBarcode;
    this.draw();
  }

  draw() {
    if (!this.diagram) return;
    const focused = document.activeElement?.getAttribute?.("data-hole");
    const b = this.diagram.betti_numbers;
    const svg = make("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "group", "aria-label": `${this.isBarcode ? "Barcode" : "Persistence diagram"}: ${b[0]} components and ${b[1]} holes stand out` });
    if (this.isBarcode) this.drawBarcode(svg);
    else this.drawDiagram(svg);
    this.root.replaceChildren(svg);
    if (focused) this.root.querySelector(`[data-hole="${focused}"]`)?.focus();
  }

  drawDiagram(svg) {
    const unit = this.diagram.length_unit;
    const finite = Object.values(this.diagram.intervals).flat().filter((interval) => interval.death !== null);
    const limit = 1.08 * Math.max(...finite.map((interval) => interval.death), 1e-9);
    const x = (value) => FRAME.left + (value / limit) * (WIDTH - FRAME.left - FRAME.right);
    const y = (value) => HEIGHT - FRAME.bottom - (value / limit) * (HEIGHT - FRAME.top - FRAME.bottom);
    this.drawAxes(svg, { limit, x, y, isTall: true });
    svg.append(make("line", { x1: x(0), y1: y(0), x2: x(limit), y2: y(limit), class: "axis" }));
    svg.append(make("line", { x1: x(0), y1: FRAME.top, x2: x(limit), y2: FRAME.top, class: "axis", "stroke-dasharray": "3 4" }));
    svg.append(text("never dies", { x: WIDTH - FRAME.right, y: FRAME.top - 4, "text-anchor": "end" }));
    svg.append(text(`birth [${unit}]`, { x: (FRAME.left + WIDTH - FRAME.right) / 2, y: HEIGHT - 4, "text-anchor": "middle" }));
    svg.append(text(`death [${unit}]`, { x: 12, y: (FRAME.top + HEIGHT - FRAME.bottom) / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${(FRAME.top + HEIGHT - FRAME.bottom) / 2})` }));
    for (const interval of this.diagram.intervals["0"]) {
      const side = interval.is_real ? 9 : 5;
      const top = interval.death === null ? FRAME.top : y(interval.death);
      const mark = make("rect", { x: x(interval.birth) - side / 2, y: top - side / 2, width: side, height: side, class: interval.is_real ? "real0" : "dim0 faint" });
      mark.append(title(`component, ${lifetime(interval, unit)}`));
      svg.append(mark);
    }
    const loops = [...this.diagram.intervals["1"]].sort((one, other) => one.is_real - other.is_real);
    for (const interval of loops) {
      const mark = make("circle", { cx: x(interval.birth), cy: y(interval.death), r: interval.is_real ? 7 : 3, class: interval.is_real ? "real1" : "dim1 faint" });
      this.finish(mark, interval);
      svg.append(mark);
    }
    this.drawKey(svg, x(limit) - 132, y(0) - 58);
  }

  drawKey(svg, left, top) {
    const rows = [["rect", { x: 0, y: 1, width: 8, height: 8, class: "real0" }, "component"], ["circle", { cx: 4, cy: 5, r: 5.5, class: "real1" }, "hole"], ["circle", { cx: 4, cy: 5, r: 3, class: "dim1 faint" }, "short-lived"]];
    rows.forEach(([shape, attributes, label], row) => {
      const group = make("g", { transform: `translate(${left + 40} ${top + 17 * row})`, "pointer-events": "none" });
      group.append(make(shape, attributes), text(label, { x: 16, y: 9.5 }));
      svg.append(group);
    });
  }

  drawBarcode(svg) {
    const unit = this.diagram.length_unit;
    const limit = 1.05 * Math.max(...Object.values(this.diagram.intervals).flat().map((interval) => interval.death ?? 0), 1e-9);
    const longest = (dimension, number) => this.diagram.intervals[dimension].slice().sort((one, other) => (other.death ?? Infinity) - other.birth - ((one.death ?? Infinity) - one.birth)).slice(0, number);
    const loops = longest("1", SHOWN_BARS - 6), parts = longest("0", 6);
    const bars = [...parts.map((interval) => [0, interval]), ...loops.map((interval) => [1, interval])];
    const x = (value) => FRAME.left + (value / limit) * (WIDTH - FRAME.left - FRAME.right);
    const step = (HEIGHT - FRAME.top - FRAME.bottom) / Math.max(bars.length, 8);
    this.drawAxes(svg, { limit, x, y: () => HEIGHT - FRAME.bottom, isTall: false });
    svg.append(text(`scale [${unit}]`, { x: (FRAME.left + WIDTH - FRAME.right) / 2, y: HEIGHT - 4, "text-anchor": "middle" }));
    svg.append(text("parts", { x: FRAME.left - 6, y: FRAME.top + 10, "text-anchor": "end" }));
    svg.append(text("loops", { x: FRAME.left - 6, y: FRAME.top + 10 + step * parts.length, "text-anchor": "end" }));
    bars.forEach(([dimension, interval], row) => {
      const end = interval.death === null ? WIDTH - FRAME.right : x(interval.death);
      const mark = make("rect", { x: x(interval.birth), y: FRAME.top + step * row + 1, width: Math.max(1, end - x(interval.birth)), height: Math.max(2, step - 2.5), rx: 2, class: interval.is_real ? `real${dimension}` : `dim${dimension} faint` });
      if (dimension === 1) this.finish(mark, interval);
      else mark.append(title(`component, ${lifetime(interval, unit)}`));
      svg.append(mark);
    });
  }

  drawAxes(svg, { limit, x, y, isTall }) {
    const tick = roundBelow(limit / 3);
    for (let value = 0; value <= limit; value += tick) {
      const label = `${Number(value.toPrecision(4))}`;
      svg.append(make("line", { x1: x(value), y1: FRAME.top, x2: x(value), y2: HEIGHT - FRAME.bottom, class: "grid" }));
      svg.append(text(label, { x: x(value), y: HEIGHT - FRAME.bottom + 15, "text-anchor": "middle" }));
      if (isTall) {
        svg.append(make("line", { x1: x(0), y1: y(value), x2: x(limit), y2: y(value), class: "grid" }));
        svg.append(text(label, { x: FRAME.left - 6, y: y(value) + 4, "text-anchor": "end" }));
      }
    }
    svg.append(make("path", { d: `M${x(0)} ${FRAME.top}V${HEIGHT - FRAME.bottom}H${x(limit)}`, class: "axis" }));
  }

  finish(mark, interval) {
    const hole = interval.is_real ? this.holeOf(interval) : null;
    const name = hole === null ? "loop" : `hole ${hole + 1}`;
    mark.append(title(`${name}, ${lifetime(interval, this.diagram.length_unit)}`));
    if (hole === null) return;
    mark.setAttribute("tabindex", "0");
    mark.setAttribute("role", "img");
    mark.setAttribute("aria-label", `${name}, ${lifetime(interval, this.diagram.length_unit)}`);
    mark.setAttribute("data-hole", hole);
    for (const name of ["pointerenter", "focus"]) mark.addEventListener(name, () => this.onChoose(hole));
    for (const name of ["pointerleave", "blur"]) mark.addEventListener(name, () => this.onChoose(null));
  }
}

function lifetime(interval, unit) {
  return interval.death === null ? "never dies" : `from ${length(interval.birth, unit)} to ${length(interval.death, unit)}`;
}

function make(name, attributes) {
  const element = document.createElementNS(NAMESPACE, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function text(content, attributes) {
  const element = make("text", attributes);
  element.textContent = content;
  return element;
}

function title(content) {
  const element = make("title", {});
  element.textContent = content;
  return element;
}
