// Moves of the plane: x' = a x + b y + e, y' = c x + d y + f. Pure geometry.

export const AS_IS = Object.freeze({ a: 1, b: 0, c: 0, d: 1, e: 0, f: 0 });

export function apply({ a, b, c, d, e, f }, [x, y]) {
  return [a * x + b * y + e, c * x + d * y + f];
}

/** The inverse; the matrix must have one. */
export function invert({ a, b, c, d, e, f }) {
  const size = a * d - b * c;
  const [ia, ib, ic, id] = [d / size, -b / size, -c / size, a / size];
  return { a: ia, b: ib, c: ic, d: id, e: -(ia * e + ib * f), f: -(ic * e + id * f) };
}

/** The same, then shifted. */
export function shifted(move, dx, dy) {
  return { ...move, e: move.e + dx, f: move.f + dy };
}

/** By how much it makes lengths longer, where it does so alike in all directions. */
export function stretch({ a, b, c, d }) {
  return Math.sqrt(Math.abs(a * d - b * c));
}
