// The ground of the map: uncertain regions, complex, points. It is painted in short steps onto a layer of its own, for one view; while the
// view moves, the layer is moved as it is, so that a frame costs the same however much is on it.

import { stretch } from "./affine.js";

const BATCH = 50;
const STEP_MS = 7;
// What is asked of a canvas is only noted until somebody looks at it: it is looked at after so many shapes, which takes a few milliseconds, as
// each look costs something, too.
const LOOK_AFTER = 1000;
const SHADES = 12;
const POINT_PX = 3.1;
const LEAST_REGION_PX = 9;

export class Ground {
  constructor({ onDone }) {
    this.onDone = onDone;
    this.front = makeLayer();
    this.back = makeLayer();
    this.scratch = makeLayer();
    this.looks = new Looks();
    this.running = null;
  }

  /** Begin to paint anew; `facts`: {scene, complex, shown, colours, view, width, height, ratio}. What was under way is dropped. */
  paint(facts) {
    const steps = this.steps(facts);
    this.running = steps;
    const go = () => {
      if (this.running !== steps) return;
      const until = performance.now() + STEP_MS;
      let isDone = false;
      while (!isDone && performance.now() < until) isDone = steps.next().done;
      if (!isDone) {
        requestAnimationFrame(go);
        return;
      }
      this.running = null;
      [this.front, this.back] = [this.back, this.front];
      this.front.view = facts.view;
      this.onDone();
    };
    // Who has just laid out a map has done enough for this frame.
    requestAnimationFrame(go);
  }

  /** Put the layer down as it lies under another view. */
  put(context, view) {
    const { canvas, view: own, ratio } = this.front;
    if (!own) return;
    const by = view.scale / own.scale;
    context.drawImage(canvas, view.x - own.x * by, view.y - own.y * by, (canvas.width / ratio) * by, (canvas.height / ratio) * by);
  }

  *steps({ scene, complex, shown, colours, view, width, height, ratio }) {
    for (const layer of [this.back, this.scratch]) layer.clear(width, height, ratio);
    const context = this.back.context, scratch = this.scratch.context;
    const places = scene.places.map(([x, y]) => [view.x + view.scale * x, view.y - view.scale * y]);
    if (shown.uncertain) {
      yield* regions(scratch, scene, places, view.scale);
      hatch(scratch, colours.warn, width, height, ratio);
      this.lay(context, 0.5, width, height);
      this.scratch.clear(width, height, ratio);
      yield;
    }
    if (shown.complex) {
      yield* triangles(scratch, yield* complex.covering(), places, colours.complex, this.looks);
      // Solid first and put down once: what lies under many triangles is as light as under one.
      this.lay(context, 0.3, width, height);
      yield* edges(context, complex.edges, places, colours.edge, this.looks);
    }
    if (shown.points) yield* points(context, scene, places, colours);
    this.looks.look(context);
    yield;
  }

  lay(context, alpha, width, height) {
    context.globalAlpha = alpha;
    context.drawImage(this.scratch.canvas, 0, 0, width, height);
    context.globalAlpha = 1;
  }
}

function makeLayer() {
  const canvas = document.createElement("canvas");
  return {
    canvas,
    context: canvas.getContext("2d"),
    ratio: 1,
    view: null,
    clear(width, height, ratio) {
      const size = [Math.round(width * ratio), Math.round(height * ratio)];
      if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
      this.ratio = ratio;
      this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
      this.context.globalCompositeOperation = "source-over";
      this.context.clearRect(0, 0, width, height);
    },
  };
}

/** Around points whose distances are doubtful, as far as no other point is told of. */
function* regions(context, scene, places, scale) {
  context.fillStyle = "#000";
  for (let i = 0; i < places.length; i += 1) {
    const point = scene.map.points[i];
    if (point.is_well_seen !== false) continue;
    const radius = Math.max(LEAST_REGION_PX, (scene.map.components[point.component]?.cover_radius ?? 0) * scale * stretch(scene.moves[point.component]));
    context.beginPath();
    context.arc(...places[i], radius, 0, 2 * Math.PI);
    context.fill();
    if (i % BATCH === 0) yield;
  }
}

function hatch(context, colour, width, height, ratio) {
  const tile = document.createElement("canvas");
  const side = (tile.width = tile.height = Math.round(7 * ratio));
  const drawn = tile.getContext("2d");
  drawn.strokeStyle = colour;
  drawn.lineWidth = 1.1 * ratio;
  drawn.beginPath();
  for (const shift of [-side, 0, side]) {
    drawn.moveTo(shift - 1, side + 1);
    drawn.lineTo(shift + side + 1, -1);
  }
  drawn.stroke();
  const pattern = context.createPattern(tile, "repeat");
  pattern.setTransform(new DOMMatrix().scale(1 / ratio));
  context.globalCompositeOperation = "source-in";
  context.fillStyle = pattern;
  context.fillRect(0, 0, width, height);
  context.globalCompositeOperation = "source-over";
}

/** Has a canvas carry out what was asked of it, a part at a time. */
class Looks {
  constructor() {
    this.probe = document.createElement("canvas").getContext("2d");
    this.open = 0;
  }

  /** So many more shapes were asked for. */
  note(context, number) {
    this.open += number;
    if (this.open >= LOOK_AFTER) this.look(context);
  }

  look(context) {
    this.probe.drawImage(context.canvas, 0, 0, 1, 1, 0, 0, 1, 1);
    this.open = 0;
  }
}

/** Small paths: the time to fill one grows faster than its number of triangles. */
function* triangles(context, flat, places, colour, looks) {
  context.fillStyle = colour;
  for (let begin = 0; begin < flat.length; begin += 3 * BATCH) {
    context.beginPath();
    for (let i = begin; i < Math.min(begin + 3 * BATCH, flat.length); i += 3) {
      context.moveTo(...places[flat[i]]);
      context.lineTo(...places[flat[i + 1]]);
      context.lineTo(...places[flat[i + 2]]);
      context.closePath();
    }
    context.fill("nonzero");
    looks.note(context, BATCH);
    yield;
  }
}

function* edges(context, pairs, places, colour, looks) {
  context.globalAlpha = Math.min(0.5, Math.max(0.035, 130 / (pairs.length || 1)));
  context.strokeStyle = colour;
  context.lineWidth = 0.7;
  for (let begin = 0; begin < pairs.length; begin += 4 * BATCH) {
    context.beginPath();
    for (let i = begin; i < Math.min(begin + 4 * BATCH, pairs.length); i += 1) {
      context.moveTo(...places[pairs[i][0]]);
      context.lineTo(...places[pairs[i][1]]);
    }
    context.stroke();
    looks.note(context, 4 * BATCH);
    yield;
  }
  context.globalAlpha = 1;
}

/** In as many shades as can be told apart: one path for each. Doubtful ones are hollow. */
function* points(context, scene, places, colours) {
  context.lineWidth = 1;
  for (let shade = 0; shade < SHADES; shade += 1) {
    const colour = `color-mix(in oklab, ${colours.late} ${Math.round((100 * shade) / (SHADES - 1))}%, ${colours.early})`;
    for (const isFull of [false, true]) {
      context.beginPath();
      places.forEach(([x, y], i) => {
        if (Math.round(scene.shares[i] * (SHADES - 1)) !== shade || (scene.map.points[i].is_well_seen !== false) !== isFull) return;
        const radius = isFull ? POINT_PX : POINT_PX - 0.6;
        context.moveTo(x + radius, y);
        context.arc(x, y, radius, 0, 2 * Math.PI);
      });
      context.fillStyle = isFull ? colour : colours.card;
      context.strokeStyle = isFull ? colours.card : colour;
      context.fill();
      context.stroke();
    }
    yield;
  }
}
