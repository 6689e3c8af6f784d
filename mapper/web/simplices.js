// Edges and triangles of the Rips complex at a scale that the operator chooses, from the lengths between all points. Pure.

/**
 * Read what `/api/v1/map/lengths` sends: for each component the upper triangle of its lengths, row by row, as shares of the map's diameter.
 *
 * `components`: of each point its component. Returns for each component {points, shares}: indices of points, and 65535ths of the diameter.
 */
export function readLengths(buffer, components) {
  const all = new Uint16Array(buffer);
  const parts = [];
  components.forEach((component, index) => (parts[component] ??= []).push(index));
  let begin = 0;
  const read = parts.map((points) => {
    const end = begin + (points.length * (points.length - 1)) / 2;
    const shares = all.subarray(begin, end);
    begin = end;
    return { points, shares };
  });
  if (begin !== all.length) throw new Error(`${all.length} lengths for a map that has ${begin}`);
  return read;
}

/**
 * The edges that are no longer than a share of the diameter, and the triangles that they bound, as a flat list of triples. Of a complex with
 * far more than `most` triangles only every so many-th edge is looked at for them: they hide each other.
 */
export function complexAt(lengths, share, { most }) {
  const limit = share * 65535;
  const edges = [], triangles = [];
  let nEdges = 0;
  for (const { points, shares } of lengths) {
    const n = points.length;
    const row = (i) => (i * (2 * n - i - 1)) / 2 - i - 1;
    const above = [];
    for (let i = 0; i < n; i += 1) {
      const base = row(i);
      above.push([]);
      for (let j = i + 1; j < n; j += 1) if (shares[base + j] <= limit) above[i].push(j);
      for (const j of above[i]) edges.push([points[i], points[j]]);
    }
    const nAtMost = above.reduce((sum, near) => sum + near.length ** 2 / 2, 0);
    const stride = Math.max(1, Math.ceil(nAtMost / (4 * most)));
    for (let i = 0; i < n; i += 1) {
      const near = above[i];
      for (let p = 0; p < near.length; p += 1) {
        nEdges += 1;
        if (nEdges % stride) continue;
        const base = row(near[p]);
        for (let q = p + 1; q < near.length; q += 1) if (shares[base + near[q]] <= limit) triangles.push(points[i], points[near[p]], points[near[q]]);
      }
    }
  }
  return { edges, triangles };
}

const CLASSES = 24;

/**
 * Of triangles (a flat list of triples) so many that they cover what all of them cover, but for slivers: the larger first, one is taken
 * where an edge of its has none on that side yet. A Rips complex has many times more, which only hide each other.
 */
export function cover(flat, places) {
  const steps = coverSteps(flat, places);
  for (;;) {
    const { done, value } = steps.next();
    if (done) return value;
  }
}

/** Edges, and the triangles that cover all there are: found in short steps, and once, whoever asks for them and however often. */
export class Complex {
  constructor({ edges, triangles }, places) {
    this.edges = edges;
    this.steps = coverSteps(triangles, places);
    this.covered = null;
  }

  /** A generator that yields now and then and returns them, as a flat list of triples. */
  *covering() {
    while (this.covered === null) {
      const { done, value } = this.steps.next();
      if (done) this.covered = value;
      else yield;
    }
    return this.covered;
  }
}

const STRIDE = 4000;

function* coverSteps(flat, places) {
  const n = places.length, number = flat.length / 3;
  const areas = new Float64Array(number);
  let largest = 0;
  for (let i = 0; i < number; i += 1) {
    areas[i] = twiceArea(places[flat[3 * i]], places[flat[3 * i + 1]], places[flat[3 * i + 2]]);
    largest = Math.max(largest, Math.abs(areas[i]));
    if (i % STRIDE === STRIDE - 1) yield;
  }
  // Sorted into classes, each half as large as the one before: exact order would cost more than it is worth.
  const classes = Array.from({ length: CLASSES }, () => []);
  for (let i = 0; i < number; i += 1) {
    classes[Math.min(CLASSES - 1, Math.floor(Math.log2(largest / Math.abs(areas[i]))) || 0)].push(i);
    if (i % STRIDE === STRIDE - 1) yield;
  }
  const sides = new Uint8Array(n * n);
  const kept = [];
  let nSeen = 0;
  for (const i of classes.flat()) {
    nSeen += 1;
    if (nSeen % STRIDE === 0) yield;
    const corners = [flat[3 * i], flat[3 * i + 1], flat[3 * i + 2]];
    let isNeeded = false;
    for (let k = 0; k < 3; k += 1) {
      const [from, to] = [corners[k], corners[(k + 1) % 3]];
      const isForward = from < to;
      const cell = isForward ? from * n + to : to * n + from;
      const side = areas[i] > 0 === isForward ? 1 : 2;
      if (sides[cell] & side) continue;
      sides[cell] |= side;
      isNeeded = true;
    }
    if (isNeeded) kept.push(...corners);
  }
  return kept;
}

function twiceArea([ax, ay], [bx, by], [cx, cy]) {
  return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
}
