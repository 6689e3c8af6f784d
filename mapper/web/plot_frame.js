// Axes of a plot as SVG, in pixels of the element that holds it.

import { draw } from "./svg.js";
import { roundBelow } from "./format.js";

export class PlotFrame {
  /** `limit`: the largest value of both axes; `isTall`: y is an axis of values too, and both have one scale of numbers, not of pixels. */
  constructor({ width, height, margin, limit, isTall }) {
    Object.assign(this, { width, height, margin, limit, isTall });
    this.right = width - margin.right;
    this.bottom = height - margin.bottom;
  }

  x(value) {
    return this.margin.left + (value / this.limit) * (this.right - this.margin.left);
  }

  y(value) {
    return this.bottom - (value / this.limit) * (this.bottom - this.margin.top);
  }

  axes(xTitle, yTitle) {
    const { margin: { left, top }, right, bottom, limit, isTall } = this;
    const group = draw("g", {});
    const tick = roundBelow(limit / 3);
    for (let value = 0; value <= limit; value += tick) {
      const label = `${Number(value.toPrecision(4))}`;
      group.append(draw("line", { x1: this.x(value), y1: top, x2: this.x(value), y2: bottom, class: "grid" }));
      group.append(words(label, { x: this.x(value), y: bottom + 15, "text-anchor": "middle" }));
      if (!isTall) continue;
      group.append(draw("line", { x1: left, y1: this.y(value), x2: right, y2: this.y(value), class: "grid" }));
      group.append(words(label, { x: left - 6, y: this.y(value) + 4, "text-anchor": "end" }));
    }
    group.append(draw("path", { d: `M${left} ${top}V${bottom}H${right}`, class: "axis" }));
    group.append(words(xTitle, { x: (left + right) / 2, y: bottom + 31, "text-anchor": "middle" }));
    if (yTitle) group.append(words(yTitle, { "text-anchor": "middle", transform: `translate(12 ${(top + bottom) / 2}) rotate(-90)` }));
    return group;
  }
}

export function words(content, attributes) {
  return draw("text", attributes, content);
}
