// The map on a canvas: complex, points, outlines of holes, landmarks. The complex is drawn once for a map and a view.

import { clock, length, palette, percent, roundBelow } from "./format.js";

const MAX_TRIANGLES = 20000;
const BATCH = 50;
const PADDING = 34;
const LEAST_DRAWN = 0.1;

const middle = (ring) => [0, 1].map((axis) => ring.reduce((sum, p) => sum + p[axis], 0) / ring.length);

export class MapView {
  constructor(canvas, tip) {
    this.canvas = canvas;
    this.tip = tip;
    this.map = null;
    this.shown = { complex: true, points: true, holes: true, landmarks: true };
    this.view = null;
    this.isFitted = true;
    this.chosenHole = null;
    this.layer = document.createElement("canvas");
    this.isLayerOld = true;
    this.isWaiting = false;
    new ResizeObserver(() => this.refresh({ layer: true })).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.refresh({ layer: true }));
    this.listen();
  }

  show(map) {
    this.map = map;
    const b = map.betti_numbers;
    const holes = map.holes.length === 1 ? "1 hole outlined" : `${map.holes.length} holes outlined`;
    this.canvas.setAttribute("aria-label", `Map of ${map.points.length} encounters: components ${b[0]}, holes ${b[1]}; ${holes}, ${map.landmarks.length} landmarks. Arrow keys move it, plus and minus zoom, 0 fits.`);
    this.refresh({ layer: true });
  }

  setLayer(name, isShown) {
    this.shown[name] = isShown;
    this.refresh({ layer: name === "complex" });
  }

  choose(hole) {
    this.chosenHole = hole;
    this.refresh({});
  }

  zoom(factor, at = { x: this.canvas.clientWidth / 2, y: this.canvas.clientHeight / 2 }) {
    if (!this.view) return;
    const { scale, x, y } = this.view;
    const next = Math.min(Math.max(scale * factor, this.fitScale / 4), this.fitScale * 200);
    const ratio = next / scale;
    this.view = { scale: next, x: at.x - (at.x - x) * ratio, y: at.y - (at.y - y) * ratio };
    this.isFitted = false;
    this.refresh({ layer: true });
  }

  move(dx, dy) {
    if (!this.view) return;
    this.view = { ...this.view, x: this.view.x + dx, y: this.view.y + dy };
    this.isFitted = false;
    this.refresh({ layer: true });
  }

  fit() {
    this.isFitted = true;
    this.refresh({ layer: true });
  }

  refresh({ layer = false }) {
    this.isLayerOld ||= layer;
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => {
      this.isWaiting = false;
      this.draw();
    });
  }

  computeFit() {
    const { points } = this.map;
    const xs = points.map((p) => p.x), ys = points.map((p) => p.y);
    const [left, right, bottom, top] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    const fitted = Math.min((width - 2 * PADDING) / (right - left || 1), (height - 2 * PADDING) / (top - bottom || 1));
    this.fitScale = Math.max(fitted, Number.MIN_VALUE);
    if (this.isFitted || !this.view) {
      this.view = { scale: this.fitScale, x: width / 2 - (this.fitScale * (left + right)) / 2, y: height / 2 + (this.fitScale * (bottom + top)) / 2 };
    }
  }

  // y grows upwards on the map and downwards on the screen.
  place(p) {
    return [this.view.x + this.view.scale * p.x, this.view.y - this.view.scale * p.y];
  }

  draw() {
    const ratio = devicePixelRatio || 1;
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    for (const canvas of [this.canvas, this.layer]) {
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
        this.isLayerOld = true;
      }
    }
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!this.map || !this.map.points.length || !width) return;
    this.computeFit();
    this.places = this.map.points.map((p) => this.place(p));
    this.colours = palette("complex", "edge", "hole", "landmark", "early", "late", "card", "ink", "soft");
    if (this.shown.complex) this.drawComplex(context, ratio, width, height);
    if (this.shown.points) this.drawPoints(context);
    if (this.shown.holes) {
      (this.map.possible_holes ?? []).filter((hole) => hole.probability >= LEAST_DRAWN).forEach((hole) => this.drawPossibleHole(context, hole));
      this.map.holes.forEach((hole, index) => this.drawHole(context, hole, index));
    }
    if (this.shown.landmarks) this.drawLandmarks(context);
    this.drawScale(context, width, height);
  }

  drawComplex(context, ratio, width, height) {
    if (this.isLayerOld) {
      const layer = this.layer.getContext("2d");
      layer.setTransform(ratio, 0, 0, ratio, 0, 0);
      layer.clearRect(0, 0, width, height);
      const { triangles, edges } = this.map.complex;
      const step = Math.max(1, Math.ceil(triangles.length / MAX_TRIANGLES));
      layer.fillStyle = this.colours.complex;
      // Small paths: the time to fill one grows faster than its number of triangles.
      for (let begin = 0; begin < triangles.length; begin += step * BATCH) {
        layer.beginPath();
        for (let i = begin; i < Math.min(begin + step * BATCH, triangles.length); i += step) {
          const [a, b, c] = triangles[i];
          layer.moveTo(...this.places[a]);
          layer.lineTo(...this.places[b]);
          layer.lineTo(...this.places[c]);
          layer.closePath();
        }
        layer.fill("nonzero");
      }
      this.edgeAlpha = Math.min(0.55, Math.max(0.06, 150 / (edges.length || 1)));
      this.isLayerOld = false;
    }
    // Drawn solid and put down once: what lies under many triangles is as light as under one.
    context.globalAlpha = 0.32;
    context.drawImage(this.layer, 0, 0, width, height);
    context.globalAlpha = this.edgeAlpha;
    context.strokeStyle = this.colours.edge;
    context.lineWidth = 0.7;
    context.beginPath();
    for (const [a, b] of this.map.complex.edges) {
      context.moveTo(...this.places[a]);
      context.lineTo(...this.places[b]);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  drawPoints(context) {
    const times = this.map.points.map((p) => p.t);
    const first = Math.min(...times), span = Math.max(...times) - first || 1;
    const { early, late, card } = this.colours;
    context.lineWidth = 1;
    context.strokeStyle = card;
    this.places.forEach(([x, y], index) => {
      const share = (times[index] - first) / span;
      context.fillStyle = `color-mix(in oklab, ${late} ${Math.round(100 * share)}%, ${early})`;
      context.beginPath();
      context.arc(x, y, 3.6, 0, 2 * Math.PI);
      context.globalAlpha = this.map.points[index].is_well_seen === false ? 0.4 : 1;
      context.fill();
      context.stroke();
    });
    context.globalAlpha = 1;
  }

  /** A loop that is not called a hole and may be one: dashed. */
  drawPossibleHole(context, hole) {
    const ring = hole.points.map((point) => this.places[point]);
    context.beginPath();
    ring.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.setLineDash([6, 5]);
    context.strokeStyle = this.colours.hole;
    context.lineWidth = 1.6;
    context.stroke();
    context.setLineDash([]);
    context.font = "600 12px system-ui, sans-serif";
    this.drawLabel(context, `? ${percent(hole.probability)}`, middle(ring), this.colours.hole);
  }

  drawHole(context, hole, index) {
    const ring = hole.points.map((point) => this.places[point]);
    if (ring.length < 3) return;
    const isChosen = this.chosenHole === index;
    context.beginPath();
    ring.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.lineJoin = "round";
    context.strokeStyle = this.colours.card;
    context.lineWidth = isChosen ? 9 : 6;
    context.stroke();
    context.strokeStyle = this.colours.hole;
    context.lineWidth = isChosen ? 5 : 3;
    context.stroke();
    const centre = middle(ring);
    context.font = "700 15px system-ui, sans-serif";
    this.drawLabel(context, `${index + 1}`, centre, this.colours.hole);
    if (hole.probability == null) return;
    context.font = "600 12px system-ui, sans-serif";
    this.drawLabel(context, percent(hole.probability), [centre[0], centre[1] + 16], this.colours.hole);
  }

  drawLandmarks(context) {
    const isRoomy = this.map.landmarks.length <= 40;
    for (const landmark of this.map.landmarks) {
      const [x, y] = this.place(landmark);
      context.lineWidth = 2.4;
      context.strokeStyle = this.colours.landmark;
      context.strokeRect(x - 5.5, y - 5.5, 11, 11);
      context.font = "600 11px system-ui, sans-serif";
      if (isRoomy) this.drawLabel(context, `${landmark.id}`, [x, y - 14], this.colours.landmark);
    }
  }

  drawLabel(context, text, [x, y], colour) {
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineWidth = 4;
    context.lineJoin = "round";
    context.strokeStyle = this.colours.card;
    context.strokeText(text, x, y);
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }

  drawScale(context, width, height) {
    const value = roundBelow((width * 0.22) / this.view.scale);
    const size = value * this.view.scale;
    context.strokeStyle = context.fillStyle = this.colours.soft;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(14, height - 18);
    context.lineTo(14, height - 13);
    context.lineTo(14 + size, height - 13);
    context.lineTo(14 + size, height - 18);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    context.textBaseline = "alphabetic";
    context.fillText(length(value, this.map.parameters.length_unit), 19, height - 18);
  }

  listen() {
    const canvas = this.canvas;
    const fingers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      const now = { x: event.offsetX, y: event.offsetY };
      if (!before) return this.showTip(now);
      fingers.set(event.pointerId, now);
      if (fingers.size === 1) return this.move(now.x - before.x, now.y - before.y);
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const spread = (p) => Math.hypot(p.x - other.x, p.y - other.y) || 1;
      this.zoom(spread(now) / spread(before), { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
    canvas.addEventListener("pointerleave", () => (this.tip.hidden = true));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), { x: event.offsetX, y: event.offsetY });
    }, { passive: false });
    const keys = {
      ArrowLeft: () => this.move(40, 0), ArrowRight: () => this.move(-40, 0), ArrowUp: () => this.move(0, 40), ArrowDown: () => this.move(0, -40),
      "+": () => this.zoom(1.3), "=": () => this.zoom(1.3), "-": () => this.zoom(1 / 1.3), 0: () => this.fit(),
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || !keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  showTip({ x, y }) {
    const near = (this.places ?? []).map((p, index) => [Math.hypot(p[0] - x, p[1] - y), index]).sort((a, b) => a[0] - b[0])[0];
    if (!this.map || !near || near[0] > 12) {
      this.tip.hidden = true;
      return;
    }
    const point = this.map.points[near[1]];
    this.tip.textContent = `${point.id1} met ${point.id2} at ${clock(point.t)}`;
    this.tip.hidden = false;
    this.tip.style.left = `${Math.min(x + 12, this.canvas.clientWidth - this.tip.offsetWidth - 4)}px`;
    this.tip.style.top = `${Math.max(2, y - 30)}px`;
  }
}
