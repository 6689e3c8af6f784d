// The persistence diagram, or the barcode: what counts as a hole can be pointed at, and is then marked on the map; and the other way round.

import { make } from "./dom.js";
import { draw } from "./svg.js";
import { length, percent } from "./format.js";
import { isSame } from "./hole_list.js";
import { PlotFrame, words } from "./plot_frame.js";

const MARGIN = { left: 46, right: 16, top: 20, bottom: 40 };
const MOST_PARTS = 6;
const LEAST_STEP_PX = 7;

export class DiagramView {
  /** `onHover(chosen | null)`, `onKeep(chosen)`; chosen: {hole} or {possible}. */
  constructor(root, { onHover, onKeep }) {
    Object.assign(this, { root, onHover, onKeep });
    this.diagram = null;
    this.map = null;
    this.scale = null;
    this.isBarcode = false;
    this.marks = [];
    new ResizeObserver(() => this.draw()).observe(root);
  }

  /** `map` of the same version: an interval that counts belongs to one of its holes. `scale`: at which the complex is drawn, null for none. */
  show(diagram, map, scale) {
    Object.assign(this, { diagram, map, scale });
    this.draw();
  }

  setScale(scale) {
    if (this.scale === scale) return;
    this.scale = scale;
    this.draw();
  }

  setBarcode(isBarcode) {
    this.isBarcode = isBarcode;
    this.draw();
  }

  mark(chosen, kept) {
    Object.assign(this, { chosen, kept });
    for (const { element, chosen: own } of this.marks) {
      element.classList.toggle("chosen", isSame(own, chosen));
      element.setAttribute("aria-pressed", String(isSame(own, kept)));
    }
  }

  draw() {
    const width = this.root.clientWidth, height = this.root.clientHeight;
    if (!this.diagram || width < 40 || height < 40) return;
    const focused = this.root.contains(document.activeElement) ? document.activeElement.getAttribute("data-key") : null;
    const [b0, b1] = this.diagram.betti_numbers;
    const name = this.isBarcode ? "Barcode" : "Persistence diagram";
    const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "group", "aria-label": `${name}: ${b0} components and ${b1} holes stand out` });
    this.marks = [];
    const intervals = Object.values(this.diagram.intervals).flat();
    const limit = 1.06 * Math.max(...intervals.map((interval) => interval.death ?? 0), this.scale ?? 0, 1e-9);
    const frame = new PlotFrame({ width, height, margin: MARGIN, limit, isTall: !this.isBarcode });
    if (this.isBarcode) this.drawBarcode(svg, frame);
    else this.drawDiagram(svg, frame);
    this.root.replaceChildren(svg);
    this.mark(this.chosen, this.kept);
    if (focused) this.root.querySelector(`[data-key="${focused}"]`)?.focus({ preventScroll: true });
  }

  drawDiagram(svg, frame) {
    const { length_unit: unit, intervals } = this.diagram;
    const { left, top } = frame.margin;
    for (const { band } of this.lines().filter((line) => line.band > 0)) {
      const rise = Math.min(band, frame.limit);
      svg.append(draw("path", { d: `M${left} ${frame.bottom}V${frame.y(rise)}L${frame.x(frame.limit - rise)} ${top}H${frame.right}Z`, class: "doubt" }));
    }
    svg.append(frame.axes(`opens at [${unit}]`, `closes at [${unit}]`));
    svg.append(draw("line", { x1: frame.x(0), y1: frame.y(0), x2: frame.x(frame.limit), y2: frame.y(frame.limit), class: "axis" }));
    for (const line of this.lines().filter((one) => one.isRule)) {
      // Where both limits ask for the same, and where the curve leaves the picture at the top.
      const births = [0, line.ratio > 1 ? line.length / (line.ratio - 1) : 0, frame.limit].filter((birth, i, all) => i === 0 || birth > all[i - 1]);
      const places = births.map((birth) => [birth, limitOf(line, birth)]);
      const inside = clipTop(places, frame.limit).map(([birth, death]) => `${frame.x(birth)} ${frame.y(death)}`);
      if (inside.length > 1) svg.append(draw("path", { d: `M${inside.join("L")}`, class: "threshold" }, draw("title", {}, line.text)));
    }
    if (this.scale !== null) {
      const at = this.scale;
      svg.append(draw("path", { d: `M${left} ${frame.y(at)}H${frame.x(at)}V${top}`, class: "scale" }, draw("title", {}, `drawn at ${length(at, unit)}: what lies up and left of it is open`)));
    }
    svg.append(draw("line", { x1: left, y1: top, x2: frame.right, y2: top, class: "axis", "stroke-dasharray": "3 4" }));
    svg.append(words("never closes", { x: frame.right, y: top - 6, "text-anchor": "end" }));
    for (const interval of intervals["0"]) {
      const side = interval.is_real ? 9 : 4;
      const middle = interval.death === null ? top : frame.y(interval.death);
      const mark = draw("rect", { x: frame.x(interval.birth) - side / 2, y: middle - side / 2, width: side, height: side, class: interval.is_real ? "real0" : "dim0 faint" });
      mark.append(draw("title", {}, `component, ${lifetime(interval, unit)}`));
      svg.append(mark);
    }
    for (const interval of this.loops((one, other) => rank(one) - rank(other))) {
      const kind = rank(interval);
      const mark = draw("circle", { cx: frame.x(interval.birth), cy: frame.y(interval.death), r: [3, 5, 9][kind], class: ["dim1 faint", "maybe1", "real1"][kind] });
      this.finish(mark, interval);
      svg.append(mark);
      if (kind === 2) svg.append(words(`${interval.chosen.hole + 1}`, { x: frame.x(interval.birth), y: frame.y(interval.death) + 4, "text-anchor": "middle", class: "number-mark", "aria-hidden": "true" }));
    }
    this.drawKey(svg, frame);
  }

  drawKey(svg, frame) {
    const rows = [["rect", { x: 0, y: 1, width: 8, height: 8, class: "real0" }, "component"], ["circle", { cx: 4, cy: 5, r: 5.5, class: "real1 still" }, "hole"], ["circle", { cx: 4, cy: 5, r: 4, class: "maybe1 still" }, "maybe one"], ["circle", { cx: 4, cy: 5, r: 3, class: "dim1 faint" }, "noise"]];
    if (this.lines().some((line) => line.isRule)) rows.push(["line", { x1: -4, y1: 5, x2: 10, y2: 5, class: "threshold" }, "limit of noise"]);
    if (this.lines().some((line) => line.band > 0)) rows.push(["rect", { x: -3, y: 0, width: 13, height: 10, class: "doubt" }, "error band"]);
    const x = frame.right - 92, y = frame.bottom - 8 - 16 * rows.length;
    const key = draw("g", { transform: `translate(${x} ${y})`, "pointer-events": "none", "aria-hidden": "true" });
    key.append(draw("rect", { x: -12, y: -6, width: 106, height: 16 * rows.length + 8, rx: 5, class: "key" }));
    rows.forEach(([shape, attributes, label], row) => key.append(draw("g", { transform: `translate(0 ${16 * row})` }, draw(shape, attributes), words(label, { x: 16, y: 9.5 }))));
    svg.append(key);
  }

  drawBarcode(svg, frame) {
    const { length_unit: unit, intervals } = this.diagram;
    const { left, top } = frame.margin;
    const lasting = (interval) => (interval.death ?? Infinity) - interval.birth;
    const longest = (one, other) => lasting(other) - lasting(one) || 0;
    const parts = [...intervals["0"]].sort((one, other) => other.is_real - one.is_real || longest(one, other)).slice(0, MOST_PARTS);
    const shown = Math.max(6, Math.floor((frame.bottom - top) / LEAST_STEP_PX) - parts.length);
    const loops = this.loops((one, other) => rank(other) - rank(one) || longest(one, other)).slice(0, shown);
    const bars = [...parts.map((interval) => [0, interval]), ...loops.map((interval) => [1, interval])];
    const step = Math.min((frame.bottom - top) / Math.max(bars.length, 6), 22);
    svg.append(frame.axes(`scale [${unit}]`, null));
    svg.append(words("parts", { x: left - 6, y: top + 9, "text-anchor": "end" }), words("loops", { x: left - 6, y: top + 9 + step * parts.length, "text-anchor": "end" }));
    const beside = [];
    bars.forEach(([dimension, interval], row) => {
      const end = interval.death === null ? frame.right : frame.x(interval.death);
      const kind = dimension ? rank(interval) : interval.is_real ? 2 : 0;
      const mark = draw("rect", { x: frame.x(interval.birth), y: top + step * row + 1, width: Math.max(1, end - frame.x(interval.birth)), height: Math.max(2, step - 2.5), rx: 2, class: [`dim${dimension} faint`, "maybe1", `real${dimension}`][kind] });
      if (dimension) this.finish(mark, interval);
      if (dimension && kind === 2) beside.push(words(`${interval.chosen.hole + 1}`, { x: Math.min(end + 5, frame.right - 8), y: top + step * row + step / 2 + 4, class: "number-beside", "aria-hidden": "true" }));
      const line = dimension ? this.lines().find((one) => one.isRule && one.component === interval.component) : null;
      const least = line ? frame.x(limitOf(line, interval.birth)) : frame.right;
      if (least < frame.right) beside.push(draw("line", { x1: least, y1: top + step * row, x2: least, y2: top + step * (row + 1), class: "threshold tick" }, draw("title", {}, line.text)));
      if (!dimension) mark.append(draw("title", {}, `component, ${lifetime(interval, unit)}`));
      svg.append(mark);
    });
    svg.append(...beside);
    if (this.scale !== null) svg.append(draw("line", { x1: frame.x(this.scale), y1: top - 6, x2: frame.x(this.scale), y2: frame.bottom, class: "scale" }, draw("title", {}, `drawn at ${length(this.scale, unit)}: bars that cross it are open`)));
  }

  loops(order) {
    return [...this.diagram.intervals["1"]].map((interval) => ({ ...interval, chosen: this.holeOf(interval) })).sort(order);
  }

  /** Which hole, or possible hole, of the map an interval is. */
  holeOf(interval) {
    const isIt = (hole) => hole.component === interval.component && hole.birth === interval.birth && hole.death === interval.death;
    const hole = this.map.holes.findIndex(isIt);
    if (hole >= 0) return { hole };
    const possible = (this.map.possible_holes ?? []).findIndex(isIt);
    return possible < 0 ? null : { possible };
  }

  /**
   * Of each component: what the trained rule asks of a loop (`length`, and `ratio` of death over birth; `isRule`: anything at all), and
   * `band`: longer ones are there in 95 of 100 maps; null where nobody knows.
   */
  lines() {
    const { length_unit: unit, thresholds = [] } = this.diagram;
    return thresholds.filter((one) => one.dimension === 1).map((one) => {
      const least = one.least_length ?? 0, ratio = one.least_ratio ?? 0;
      const asks = [least > 0 ? `lasts longer than ${length(least, unit)}` : "", ratio > 0 ? `closes at ${Number(ratio.toPrecision(3))} times where it opens, or later` : ""].filter(Boolean);
      return { component: one.component, length: least, ratio, isRule: asks.length > 0, band: one.sure_length ?? null, text: `component ${one.component + 1}: the trained rule takes a loop for a hole that ${asks.join(" and ")}` };
    });
  }

  finish(mark, interval) {
    const { chosen } = interval;
    const unit = this.diagram.length_unit;
    const hole = chosen === null ? null : "hole" in chosen ? this.map.holes[chosen.hole] : this.map.possible_holes[chosen.possible];
    const name = chosen === null ? "loop" : "hole" in chosen ? `hole ${chosen.hole + 1}` : "possible hole";
    const text = `${name}${hole?.probability == null ? "" : `, ${percent(hole.probability)} sure`}, ${lifetime(interval, unit)}`;
    mark.append(draw("title", {}, text));
    if (chosen === null) return;
    const key = "hole" in chosen ? `h${chosen.hole}` : `p${chosen.possible}`;
    const attributes = { tabindex: "0", role: "button", "aria-label": text, "data-key": key, [`data-${Object.keys(chosen)[0]}`]: Object.values(chosen)[0] };
    Object.entries(attributes).forEach(([attribute, value]) => mark.setAttribute(attribute, value));
    for (const event of ["pointerenter", "focus"]) mark.addEventListener(event, () => this.onHover(chosen));
    for (const event of ["pointerleave", "blur"]) mark.addEventListener(event, () => this.onHover(null));
    mark.addEventListener("click", () => this.onKeep(chosen));
    mark.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      this.onKeep(chosen);
    });
    this.marks.push({ element: mark, chosen });
  }

  /** Before the first map. */
  clear(text) {
    this.root.replaceChildren(make("p", { className: "empty" }, text));
  }
}

/** Where a loop that opens at `birth` must close, at least, to be taken for a hole. */
function limitOf({ length: least, ratio }, birth) {
  return Math.max(birth + least, birth * ratio);
}

/** Cut a rising line where it passes `top`. */
function clipTop(places, top) {
  const end = places.findIndex(([, y]) => y > top);
  if (end < 0) return places;
  if (end === 0) return [];
  const [[x0, y0], [x1, y1]] = [places[end - 1], places[end]];
  return [...places.slice(0, end), [x0 + ((x1 - x0) * (top - y0)) / (y1 - y0), top]];
}

/** 2: a hole of the map, 1: may be one, 0: neither. */
function rank(interval) {
  return interval.chosen === null ? 0 : "hole" in interval.chosen ? 2 : 1;
}

function lifetime(interval, unit) {
  return interval.death === null ? "never closes" : `open from ${length(interval.birth, unit)} to ${length(interval.death, unit)}`;
}
