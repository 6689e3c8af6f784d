// Which hole of a newer map is one that was looked at in the map before it. Pure.

/** The hole of `after` that `chosen` of `before` has become: {hole} or {possible}; null where there is none in its place. Each map is laid
 * over the one before, so that places can be compared; holes are one where their centres are no further apart than their radii together. */
export function findAgain(chosen, before, after) {
  const sought = spotOf(chosen && ("hole" in chosen ? before.holes[chosen.hole] : before.possible_holes?.[chosen.possible]));
  if (!sought) return null;
  const found = [
    ...after.holes.map((hole, index) => ({ chosen: { hole: index }, spot: spotOf(hole) })),
    ...(after.possible_holes ?? []).map((hole, index) => ({ chosen: { possible: index }, spot: spotOf(hole) })),
  ].filter(({ spot }) => spot);
  let nearest = null, least = Infinity;
  for (const { chosen: one, spot } of found) {
    const distance = Math.hypot(spot.x - sought.x, spot.y - sought.y);
    // Holes that are told come first: a possible one takes their place only where none is near enough.
    if (distance <= spot.radius + sought.radius && distance < least && !(nearest && "hole" in nearest && "possible" in one)) [nearest, least] = [one, distance];
  }
  return nearest;
}

function spotOf(hole) {
  if (!hole?.centre || hole.area == null) return null;
  return { x: hole.centre[0], y: hole.centre[1], radius: Math.sqrt(Math.max(hole.area, 0) / Math.PI) };
}
