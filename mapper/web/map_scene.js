// What is drawn of a map, in the coordinates of the picture: metres of the operator's frame where pins fix one, otherwise the map's own. No
// drawing.

import { AS_IS, apply, invert, shifted, stretch } from "./affine.js";

const GAP = 0.12;
/** Less likely loops than this are not drawn. */
export const LEAST_DRAWN = 0.1;

/**
 * Place what a map shows.
 *
 * Returns {map, places: [[x, y]], unit, isFramed, error, bounds, parts, holes, possible, landmarks, shares, toMap, toPicture}; `error` is the
 * relative error of lengths, null where nobody knows; `shares` when each point was met, from 0 (first) to 1 (last).
 */
export function makeScene(map) {
  const frame = map.frame ?? null;
  const moves = frame?.components.length ? framedMoves(map, frame) : map.components.map(() => AS_IS);
  const toPicture = (place, component) => apply(moves[component] ?? AS_IS, place);
  const places = map.points.map((point) => toPicture([point.x, point.y], point.component));
  const drawHole = (hole, index) => {
    const ring = (hole.outline_xy ?? []).map((place) => toPicture(place, hole.component));
    const loop = hole.points.map((point) => places[point]);
    const shape = ring.length > 3 ? ring.slice(0, -1) : loop;
    return { index, hole, ring: shape, loop, centre: hole.centre ? toPicture(hole.centre, hole.component) : middleOf(shape) };
  };
  const times = map.points.map((point) => point.t);
  const first = Math.min(...times), span = Math.max(...times) - first || 1;
  const landmarks = map.landmarks.map((one) => ({ ...one, place: toPicture([one.x, one.y], one.component) }));
  const errors = map.components.map((part) => part.scale?.error).filter((error) => error != null);
  return {
    map,
    places,
    moves,
    landmarks,
    unit: frame ? "m" : map.parameters.length_unit,
    isFramed: frame !== null,
    error: frame || !errors.length ? null : Math.max(...errors),
    bounds: boundsOf([...places, ...landmarks.map((one) => one.place)]),
    parts: map.components.map((part, component) => ({ part, component, bounds: boundsOf(places.filter((_, i) => map.points[i].component === component)) })),
    holes: map.holes.map(drawHole),
    possible: (map.possible_holes ?? []).map(drawHole).filter((one) => one.hole.probability >= LEAST_DRAWN),
    isEnough: map.data?.is_enough !== false,
    shares: times.map((t) => (t - first) / span),
    toPicture,
    /** {x, y, component} in the map's own coordinates of a place in the picture: of the component that has the nearest point. */
    toMap(place) {
      let nearest = 0, least = Infinity;
      places.forEach((one, index) => {
        const distance = Math.hypot(one[0] - place[0], one[1] - place[1]);
        if (distance < least) [nearest, least] = [index, distance];
      });
      const component = map.points[nearest]?.component ?? 0;
      const [x, y] = apply(invert(moves[component] ?? AS_IS), place);
      return { x, y, component };
    },
  };
}

/** Components without pins have no place in the frame: to its scale, to the right of those that have, with a gap, their middles level. */
function framedMoves(map, frame) {
  const moves = [];
  for (const { component, matrix: [[a, b], [c, d]], shift: [e, f] } of frame.components) moves[component] = { a, b, c, d, e, f };
  const boxes = frame.components.map(({ component }) => boundsIn(map, moves[component], component));
  let right = Math.max(...boxes.map((box) => box.right));
  const level = (boxes[0].low + boxes[0].high) / 2, gap = GAP * (right - Math.min(...boxes.map((box) => box.left)));
  const scale = stretch(moves[frame.components[0].component]);
  map.components.forEach((_, component) => {
    if (moves[component]) return;
    const bare = { a: scale, b: 0, c: 0, d: scale, e: 0, f: 0 };
    const box = boundsIn(map, bare, component);
    moves[component] = shifted(bare, right + gap - box.left, level - (box.low + box.high) / 2);
    right += gap + box.right - box.left;
  });
  return moves;
}

function boundsIn(map, move, component) {
  const [points, landmarks] = [map.points, map.landmarks].map((list) => list.filter((one) => one.component === component));
  return boundsOf([...points, ...landmarks].map((one) => apply(move, [one.x, one.y])));
}

export function boundsOf(places) {
  const box = { left: Infinity, right: -Infinity, low: Infinity, high: -Infinity };
  for (const [x, y] of places) {
    box.left = Math.min(box.left, x);
    box.right = Math.max(box.right, x);
    box.low = Math.min(box.low, y);
    box.high = Math.max(box.high, y);
  }
  return places.length ? box : { left: 0, right: 0, low: 0, high: 0 };
}

/** How many units of the picture one of the map is, in a component: metres where pins fix the frame. Returns {factor, unit}. */
export function unitOf(map, component) {
  const fit = map.frame?.components.find((one) => one.component === component);
  return fit ? { factor: fit.scale, unit: "m" } : { factor: 1, unit: map.parameters.length_unit };
}

/** Whether a place lies in a ring (not closed), by the even-odd rule. */
export function isInside([x, y], ring) {
  let isIn = false;
  for (let i = 0, j = ring.length - 1; i < ring.length; j = i, i += 1) {
    const [[xi, yi], [xj, yj]] = [ring[i], ring[j]];
    if (yi > y !== yj > y && x < ((xj - xi) * (y - yi)) / (yj - yi) + xi) isIn = !isIn;
  }
  return isIn;
}

export function middleOf(ring) {
  const box = boundsOf(ring);
  return [(box.left + box.right) / 2, (box.low + box.high) / 2];
}
