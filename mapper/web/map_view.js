// The map on its canvas: which part is in sight, what is marked, and what lies under the pointer.

import { clock, count, length, palette, percent } from "./format.js";
import { listen } from "./gestures.js";
import { Ground } from "./map_ground.js";
import { drawMarks } from "./map_marks.js";
import { isInside, makeScene } from "./map_scene.js";
import { complexAt, Complex } from "./simplices.js";
import { Viewport } from "./viewport.js";

const PADDING = { left: 30, right: 30, top: 34, bottom: 46 };
const COLOURS = ["complex", "edge", "hole", "landmark", "early", "late", "card", "ink", "soft", "warn", "pin", "route"];
/** Of a complex far larger than this not all triangles are looked for. */
const MOST_TRIANGLES = 200_000;
const NEAR_PX = 12;
/** A view that has not moved for so long is painted anew; until then the old painting is moved. */
const SETTLE_MS = 120;

export class MapView {
  /**
   * `onHover({hole} | {possible} | null)`: what the pointer is on; `onKeep(chosen)`: a hole was tapped; `onSpot(place, pixel)`: another
   * place was, in the picture.
   */
  constructor(canvas, tip, { onHover, onKeep, onSpot }) {
    Object.assign(this, { canvas, tip, onHover, onKeep, onSpot });
    this.scene = null;
    this.chosen = null;
    this.shown = { complex: true, points: true, holes: true, landmarks: true, uncertain: true };
    this.marks = { pins: [], routes: [], spot: null };
    this.complex = new Complex({ edges: [], triangles: [] }, []);
    this.viewport = new Viewport();
    this.ground = new Ground({ onDone: () => this.refresh() });
    this.isWaiting = false;
    this.settling = null;
    new ResizeObserver(() => this.repaint()).observe(canvas);
    document.addEventListener("themechange", () => this.repaint());
    listen(canvas, {
      move: (dx, dy) => this.look(() => this.viewport.move(dx, dy)),
      zoom: (factor, at) => this.look(() => this.viewport.zoom(factor, at)),
      fit: () => this.fit(),
      hover: (at) => this.hover(at),
      tap: (at) => this.tap(at),
    });
  }

  /** Show a map, with its complex at its own scale until another is set. */
  show(map) {
    this.scene = makeScene(map);
    this.setComplex(null, null);
    this.describe();
  }

  /** `lengths` and `share`: the complex at a scale other than the map's own; a share of null is the map's own. */
  setComplex(lengths, share) {
    const { places, map } = this.scene;
    const own = () => ({ edges: map.complex.edges, triangles: map.complex.triangles.flat() });
    this.complex = new Complex(share === null ? own() : complexAt(lengths, share, { most: MOST_TRIANGLES }), places);
    this.repaint();
  }

  setLayer(name, isShown) {
    this.shown[name] = isShown;
    if (name === "holes" || name === "landmarks") this.refresh();
    else this.repaint();
  }

  choose(chosen) {
    this.chosen = chosen;
    this.refresh();
  }

  /** `marks`: any of pins [{name, place}], routes [{xy, component}] in coordinates of the map, spot. */
  mark(marks) {
    Object.assign(this.marks, marks);
    this.refresh();
  }

  zoom(factor) {
    this.look(() => this.viewport.zoom(factor, [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]));
  }

  fit() {
    this.look(() => (this.viewport.isFitted = true));
  }

  centre(place) {
    this.look(() => this.viewport.centre(place, this.canvas.clientWidth, this.canvas.clientHeight));
  }

  /** Bring a hole into sight, if it is not. */
  reveal(chosen) {
    const one = this.find(chosen);
    if (!one) return;
    const [x, y] = this.viewport.toScreen(one.centre);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (x < 0 || y < 0 || x > width || y > height) this.centre(one.centre);
  }

  find({ hole, possible }) {
    return hole === undefined ? this.scene.possible.find((one) => one.index === possible) : this.scene.holes[hole];
  }

  look(change) {
    if (!this.scene) return;
    change();
    clearTimeout(this.settling);
    this.settling = setTimeout(() => this.repaint(), SETTLE_MS);
    this.refresh();
  }

  /** Draw the next frame. */
  refresh() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => {
      this.isWaiting = false;
      this.draw();
    });
  }

  /** Paint the ground anew, and draw. */
  repaint() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!this.scene?.places.length || !width) return;
    this.colours = palette(...COLOURS);
    this.viewport.setStage(width, height, this.scene.bounds, PADDING);
    const facts = { scene: this.scene, complex: this.complex, shown: { ...this.shown }, colours: this.colours, view: this.viewport.copy() };
    this.ground.paint({ ...facts, width, height, ratio: devicePixelRatio || 1 });
    this.refresh();
  }

  draw() {
    const ratio = devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const size = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== size[0] || this.canvas.height !== size[1]) [this.canvas.width, this.canvas.height] = size;
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!this.scene?.places.length || !width || !this.colours) return;
    this.viewport.setStage(width, height, this.scene.bounds, PADDING);
    this.ground.put(context, this.viewport);
    drawMarks(context, this.scene, this.viewport, this.colours, { ...this.marks, shown: this.shown, chosen: this.chosen }, { width, height });
  }

  /** The whole map in one sentence, for those who cannot see it; holes are listed beside it too. */
  describe() {
    const { map, holes, landmarks, unit, isEnough } = this.scene;
    const [b0, b1] = map.betti_numbers;
    const named = holes.map(({ index, hole }) => `hole ${index + 1}${hole.probability == null ? "" : ` ${percent(hole.probability)} sure`}`);
    const state = isEnough ? "" : "Not enough data yet. ";
    this.canvas.setAttribute("aria-label", `${state}Map of ${count(map.n_encounters)} encounters: components ${b0}, holes ${b1}${named.length ? ` (${named.join(", ")})` : ""}; `
      + `${landmarks.length} landmarks, ${length(map.diameter, unit === "m" ? map.parameters.length_unit : unit)} across. Arrow keys move it, plus and minus zoom, 0 fits, Enter takes the place in the middle.`);
  }

  hover(at) {
    const found = at ? this.under(at) : null;
    this.canvas.style.cursor = found ? "pointer" : "";
    const chosen = found?.chosen ?? null;
    if (chosen?.hole !== this.hovered?.hole || chosen?.possible !== this.hovered?.possible) {
      this.hovered = chosen;
      this.onHover(chosen);
    }
    this.tip.hidden = !found;
    if (!found) return;
    this.tip.textContent = found.text;
    this.tip.style.left = `${Math.max(2, Math.min(at[0] + 14, this.canvas.clientWidth - this.tip.offsetWidth - 4))}px`;
    this.tip.style.top = `${Math.max(2, at[1] - 34)}px`;
  }

  tap(at) {
    if (!this.scene?.places.length) return;
    const chosen = this.under(at)?.chosen;
    if (chosen) return this.onKeep(chosen);
    this.hover(null);
    this.onSpot(this.viewport.toMap(at), at);
  }

  /** What is at a pixel: {text, chosen}, or null. */
  under(at) {
    if (!this.scene) return null;
    const { scene, viewport } = this;
    const place = viewport.toMap(at);
    const landmark = this.shown.landmarks && nearest(scene.landmarks.map((one) => viewport.toScreen(one.place)), at);
    if (landmark && landmark.distance < NEAR_PX) {
      const one = scene.landmarks[landmark.index];
      return { text: `landmark ${one.id}, since ${clock(one.t_start)}${one.t_end === null ? "" : ` until ${clock(one.t_end)}`}` };
    }
    if (this.shown.points) {
      const point = nearest(scene.places.map((one) => viewport.toScreen(one)), at);
      if (point && point.distance < NEAR_PX / 1.5) {
        const one = scene.map.points[point.index];
        return { text: `${one.id1} met ${one.id2} at ${clock(one.t)}${one.is_well_seen === false ? "; the place is doubtful" : ""}` };
      }
    }
    if (!this.shown.holes) return null;
    for (const [kind, list] of [["hole", scene.holes], ["possible", scene.possible]]) {
      const one = list.find(({ ring }) => isInside(place, ring));
      if (!one) continue;
      const sure = one.hole.probability == null ? "" : `, ${percent(one.hole.probability)} sure`;
      return { text: kind === "hole" ? `hole ${one.index + 1}${sure}` : `possible hole${sure}`, chosen: { [kind]: one.index } };
    }
    return null;
  }
}

function nearest(places, [x, y]) {
  let found = null;
  places.forEach((place, index) => {
    const distance = Math.hypot(place[0] - x, place[1] - y);
    if (!found || distance < found.distance) found = { index, distance };
  });
  return found;
}
