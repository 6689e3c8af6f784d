// What lies over the ground of the map and is drawn anew with every frame: holes, landmarks, routes, pins, names, scale bar.

import { apply } from "./affine.js";
import { length, roundBelow, shortPercent } from "./format.js";
import { middleOf } from "./map_scene.js";

const FONT = 'system-ui, "Segoe UI", "DejaVu Sans", sans-serif';
/** A hole at least so likely is drawn with an unbroken line. */
const SURE = 0.9;
const ROUTE_DASHES = [[], [9, 5], [3, 4]];
export const ROUTE_NAMES = "ABCDEFGHIJKLMNOP";

/** Draw all marks. `marks`: {shown, chosen, pins, routes, spot}; `chosen`: {hole} or {possible}, an index. */
export function drawMarks(context, scene, viewport, colours, marks, { width, height }) {
  const labels = new Labels(context, colours.card);
  const screen = (place) => viewport.toScreen(place);
  if (scene.parts.length > 1) scene.parts.forEach((part) => drawPart(context, labels, part, screen, colours, scene));
  if (marks.shown.holes) {
    const { holes, possible, isEnough } = scene;
    possible.forEach((one) => drawHole(context, labels, one, screen, colours, { isFirm: false, isChosen: marks.chosen?.possible === one.index }));
    holes.forEach((one) => drawHole(context, labels, one, screen, colours, { isFirm: isEnough, name: `${one.index + 1}`, isChosen: marks.chosen?.hole === one.index }));
  }
  marks.routes.forEach((route, index) => drawRoute(context, labels, route, index, screen, scene, colours));
  if (marks.shown.landmarks) scene.landmarks.forEach((one) => drawLandmark(context, labels, one, screen, colours));
  marks.pins.forEach((pin) => drawPin(context, labels, pin, screen(pin.place), colours));
  if (marks.spot) drawSpot(context, screen(marks.spot), colours);
  labels.draw({ width, height });
  drawScale(context, scene, viewport, colours, width, height);
}

/** Names: the weightier first, and those that would cover another are left out. */
class Labels {
  constructor(context, halo) {
    Object.assign(this, { context, halo, wanted: [], taken: [] });
  }

  add(text, [x, y], { colour, size = 11, weight = 600, rank = 0, isAlways = false, staysInside = false }) {
    this.wanted.push({ text, x, y, colour, size, weight, rank, isAlways, staysInside });
  }

  /** Keep names off a box [left, top, right, bottom]. */
  reserve(box) {
    this.taken.push(box);
  }

  draw({ width, height }) {
    const { context } = this;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineJoin = "round";
    for (const one of this.wanted.sort((a, b) => b.rank - a.rank)) {
      if (one.x < -40 || one.y < -20 || one.x > width + 40 || one.y > height + 20) continue;
      context.font = `${one.weight} ${one.size}px ${FONT}`;
      const half = context.measureText(one.text).width / 2 + 2, up = one.size / 2 + 1;
      if (one.staysInside) one.x = Math.max(half, Math.min(one.x, width - half));
      const box = [one.x - half, one.y - up, one.x + half, one.y + up];
      if (!one.isAlways && this.taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3])) continue;
      this.taken.push(box);
      context.lineWidth = 4;
      context.strokeStyle = this.halo;
      context.strokeText(one.text, one.x, one.y);
      context.fillStyle = one.colour;
      context.fillText(one.text, one.x, one.y);
    }
  }
}

function trace(context, ring, { isClosed = true } = {}) {
  context.beginPath();
  ring.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  if (isClosed) context.closePath();
}

function drawPart(context, labels, { part, component, bounds }, screen, colours) {
  const [left, high] = screen([bounds.left, bounds.high]), [right, low] = screen([bounds.right, bounds.low]);
  context.setLineDash([2, 6]);
  context.strokeStyle = colours.soft;
  context.lineWidth = 1;
  context.strokeRect(left - 8, high - 8, right - left + 16, low - high + 16);
  context.setLineDash([]);
  labels.add(`component ${component + 1}: ${part.n_encounters.toLocaleString("en")} encounters`, [(left + right) / 2, high - 22], { colour: colours.soft, size: 12, rank: 4, staysInside: true });
}

/** A likely hole has a full line, a doubtful one a broken one, one that only may be there a faint dotted one. */
function drawHole(context, labels, { hole, ring, loop, centre }, screen, colours, { isFirm, isChosen, name }) {
  const outline = ring.map(screen);
  if (outline.length < 3) return;
  const isNamed = name !== undefined;
  const isSure = isFirm && (hole.probability ?? 1) >= SURE;
  context.lineJoin = "round";
  if (isChosen) {
    trace(context, loop.map(screen));
    context.setLineDash([2, 4]);
    context.strokeStyle = colours.hole;
    context.lineWidth = 2;
    context.stroke();
    context.setLineDash([]);
  }
  trace(context, outline);
  context.fillStyle = colours.hole;
  context.globalAlpha = isChosen ? 0.3 : isNamed ? 0.13 : 0.04;
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = colours.card;
  context.lineWidth = isChosen ? 9 : 6;
  if (isNamed || isChosen) context.stroke();
  context.globalAlpha = isNamed || isChosen ? 1 : 0.75;
  context.strokeStyle = colours.hole;
  context.setLineDash(isSure ? [] : isNamed ? [10, 5] : [3, 5]);
  context.lineWidth = isChosen ? 5 : isNamed ? 3 : 1.8;
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = 1;
  const at = screen(centre ?? middleOf(ring));
  const sure = hole.probability == null ? "" : shortPercent(hole.probability);
  const isTold = isNamed && isFirm;
  if (isTold) labels.add(name, [at[0], at[1] - (sure ? 8 : 0)], { colour: colours.hole, size: 17, weight: 700, rank: 9, isAlways: true });
  if (isTold && sure) labels.add(sure, [at[0], at[1] + 10], { colour: colours.hole, size: 12, rank: 8, isAlways: true });
  if (!isTold) labels.add(`${name ?? ""}? ${sure}`.trim(), at, { colour: colours.hole, size: 12, rank: 7, isAlways: isChosen });
}

function drawLandmark(context, labels, landmark, screen, colours) {
  const [x, y] = screen(landmark.place);
  context.strokeStyle = colours.card;
  context.lineWidth = 5;
  context.strokeRect(x - 5.5, y - 5.5, 11, 11);
  context.lineWidth = 2.3;
  context.strokeStyle = colours.landmark;
  context.globalAlpha = landmark.t_end === null ? 1 : 0.5;
  context.strokeRect(x - 5.5, y - 5.5, 11, 11);
  context.globalAlpha = 1;
  labels.add(`${landmark.id}`, [x, y - 14], { colour: colours.landmark, size: 11, rank: 3 });
}

function drawRoute(context, labels, route, index, screen, scene, colours) {
  const line = route.xy.map((place) => screen(apply(scene.moves[route.component], place)));
  context.lineJoin = context.lineCap = "round";
  trace(context, line, { isClosed: false });
  context.strokeStyle = colours.card;
  context.lineWidth = 7;
  context.stroke();
  context.strokeStyle = colours.route;
  context.lineWidth = index ? 2.6 : 4;
  context.setLineDash(ROUTE_DASHES[Math.min(index, ROUTE_DASHES.length - 1)]);
  context.stroke();
  context.setLineDash([]);
  context.lineCap = "butt";
  labels.add(ROUTE_NAMES[index], halfWay(line), { colour: colours.route, size: 14, weight: 700, rank: 6, isAlways: true });
}

function halfWay(line) {
  const steps = line.slice(1).map((place, i) => Math.hypot(place[0] - line[i][0], place[1] - line[i][1]));
  let left = steps.reduce((sum, step) => sum + step, 0) / 2;
  for (let i = 0; i < steps.length; i += 1) {
    if (left <= steps[i]) {
      const share = steps[i] ? left / steps[i] : 0;
      return [0, 1].map((axis) => line[i][axis] + share * (line[i + 1][axis] - line[i][axis]));
    }
    left -= steps[i];
  }
  return line[0];
}

function drawPin(context, labels, pin, [x, y], colours) {
  context.beginPath();
  context.moveTo(x, y);
  context.bezierCurveTo(x - 3, y - 8, x - 9, y - 11, x - 9, y - 18);
  context.arc(x, y - 18, 9, Math.PI, 0);
  context.bezierCurveTo(x + 9, y - 11, x + 3, y - 8, x, y);
  context.closePath();
  context.fillStyle = colours.pin;
  context.strokeStyle = colours.card;
  context.lineWidth = 2;
  context.fill();
  context.stroke();
  context.beginPath();
  context.arc(x, y - 18, 3.4, 0, 2 * Math.PI);
  context.fillStyle = colours.card;
  context.fill();
  labels.reserve([x - 10, y - 28, x + 10, y]);
  labels.add(pin.name, [x, y - 37], { colour: colours.pin, size: 13, weight: 700, rank: 10, isAlways: true });
}

function drawSpot(context, [x, y], colours) {
  context.strokeStyle = colours.ink;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(x, y, 9, 0, 2 * Math.PI);
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    context.moveTo(x + 6 * dx, y + 6 * dy);
    context.lineTo(x + 14 * dx, y + 14 * dy);
  }
  context.stroke();
}

function drawScale(context, scene, viewport, colours, width, height) {
  const value = roundBelow((width * 0.24) / viewport.scale);
  const size = value * viewport.scale;
  const [left, y] = [14, height - 14];
  context.beginPath();
  for (const [x, rise] of [[left, 6], [left + size, 6]]) {
    context.moveTo(x, y - rise);
    context.lineTo(x, y + 0.5);
  }
  context.moveTo(left, y);
  context.lineTo(left + size, y);
  context.strokeStyle = colours.card;
  context.lineWidth = 5;
  context.stroke();
  context.strokeStyle = colours.ink;
  context.lineWidth = 2;
  context.stroke();
  const text = length(value, scene.unit) + (scene.error === null ? "" : ` ± ${Math.round(100 * scene.error)} %`);
  context.font = `600 12px ${FONT}`;
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.lineWidth = 4;
  context.strokeStyle = colours.card;
  context.strokeText(text, left + 6, y - 8);
  context.fillStyle = colours.ink;
  context.fillText(text, left + 6, y - 8);
}
