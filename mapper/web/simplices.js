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
 * The edges that are no longer than a share of the diameter, and the triangles that they bound, as a flat list of triples: no more than
 * `most` of them, evenly taken. Of a complex that is far larger only every so many-th edge is looked at for triangles: they hide each other.
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
    const stride = Math.max(1, Math.ceil(nAtMost / (8 * most)));
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
  return { edges, triangles: thin(triangles, most) };
}

/** Of a flat list of triples no more than `most`, evenly taken. */
export function thin(triples, most) {
  const number = triples.length / 3;
  const step = Math.max(1, Math.ceil(number / most));
  if (step === 1) return triples;
  const kept = [];
  for (let i = 0; i < number; i += step) kept.push(triples[3 * i], triples[3 * i + 1], triples[3 * i + 2]);
  return kept;
}
