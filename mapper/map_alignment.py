"""Lay a map over another one of the same site: turned, mirrored and moved, never stretched; component by component.

From one map to the next the picture would else jump: its axes are those along which it is longest, and their signs are chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapper.frames import Similarity
from mapper.map_marks import Marks, shared_marks, take_marks
from mapper.types import GAP_SHARE, FloatArray, Hole, Landmark, MapResult, Points, read_only

_LEAST_SHARED = 2
# The other handedness must fit better by this much of the spread: two marks, or many on one line, tell nothing of it.
_CLEARLY_LESS = 1e-6
_ROUNDS = 30
_NEAREST = 1e-9  # of the extent: marks that fit better have the weight of this distance


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentFit:
    """How a component of one map lies in one of another: both their numbers, the motion, and how well the shared marks fit.

    ``rms``: root mean square distance of all ``n_shared`` marks after it [unit of the map].
    """

    component: int
    other: int
    motion: Similarity
    n_shared: int
    rms: float


def fit_components(marks: Marks, other: Marks) -> tuple[ComponentFit, ...]:
    """Find how the components of one map lie in those of another.

    Returns
    -------
    tuple of ComponentFit
        For each pair of components that share at least two marks at different places, the most shared first; ties by their numbers. Of
        the other map and this one they are the same pairs, the motions inverse.
    """
    ours, theirs = shared_marks(marks, other)
    pairs = np.unique(np.column_stack([marks.component[ours], other.component[theirs]]), axis=0)
    fits = []
    for component, counterpart in pairs.tolist():
        chosen = (marks.component[ours] == component) & (other.component[theirs] == counterpart)
        here, there = marks.xy[ours[chosen]], other.xy[theirs[chosen]]
        if len(here) < _LEAST_SHARED or min(np.ptp(here, axis=0).max(), np.ptp(there, axis=0).max()) == 0.0:
            continue
        motion = fit_motion(here, there)
        rms = float(np.sqrt(np.mean(np.sum((motion(here) - there) ** 2, axis=1))))
        fits.append(ComponentFit(component=component, other=counterpart, motion=motion, n_shared=len(here), rms=rms))
    return tuple(sorted(fits, key=lambda fit: (-fit.n_shared, fit.component + fit.other, abs(fit.component - fit.other))))


def fit_motion(here: FloatArray, there: FloatArray) -> Similarity:
    """Fit the motion that brings places, shape (k, 2), to others, with the least sum of distances; scale 1.

    Notes
    -----
    Distances and not their squares: an encounter may lie elsewhere in another map, and must not turn all others. Swapping both gives the
    inverse motion. Where both handednesses fit alike, nothing is mirrored.

    References
    ----------
    Orthogonal Procrustes in the plane (Schoenemann 1966), in complex numbers: the best turn is the phase of the inner product; with
    weights that are one over the distances, again and again (Weiszfeld 1937).
    """
    plain, mirrored = (_motion(here, there, is_mirrored=is_mirrored) for is_mirrored in (False, True))
    costs = [float(np.hypot(*(motion(here) - there).T).sum()) for motion in (plain, mirrored)]
    spread = float(np.hypot(*(there - there.mean(axis=0)).T).sum())
    return mirrored if costs[1] < costs[0] - _CLEARLY_LESS * spread else plain


def align_map(result: MapResult, to: Marks) -> tuple[MapResult, ComponentFit | None]:
    """Lay a map over another one, of which the marks are given; return it, and how the largest component that found its place fits.

    Notes
    -----
    The first component is moved to where it was; each of the others is turned and mirrored alike and put to the right of the one before,
    as `mapper.assembly` does. What shares nothing with the other map stays as it is.
    """
    fits: dict[int, ComponentFit] = {}
    for fit in fit_components(take_marks(result), to):
        fits.setdefault(fit.component, fit)
    if not fits:
        return result, None
    motions = _side_by_side(result, [fits[index].motion if index in fits else None for index in range(len(result.components))])
    moved = replace(
        result,
        points=_move_points(result.points, motions),
        others=None if result.others is None else _move_points(result.others, motions),
        holes=tuple(_move_hole(hole, motions[hole.component]) for hole in result.holes),
        possible_holes=tuple(_move_hole(hole, motions[hole.component]) for hole in result.possible_holes),
        landmarks=tuple(_move_landmark(landmark, motions[landmark.component]) for landmark in result.landmarks),
    )
    return moved, fits[min(fits)]


def _motion(here: FloatArray, there: FloatArray, *, is_mirrored: bool) -> Similarity:
    z = here[:, 0] + 1j * (-here[:, 1] if is_mirrored else here[:, 1])
    w = there[:, 0] + 1j * there[:, 1]
    floor = _NEAREST * float(np.abs(z - z.mean()).max() + np.abs(w - w.mean()).max())
    weights = np.full(len(z), 1.0 / len(z))
    for _ in range(_ROUNDS):
        middle, there_middle = complex(weights @ z), complex(weights @ w)
        product = complex(np.vdot(z - middle, weights * (w - there_middle)))
        turn = product / abs(product) if product else 1.0 + 0.0j
        shift = there_middle - turn * middle
        weights = 1.0 / np.maximum(np.abs(turn * z + shift - w), floor)
        weights /= weights.sum()
    return Similarity(scale=1.0, turn_rad=float(np.angle(turn)), is_mirrored=is_mirrored, shift=(shift.real, shift.imag))


def _side_by_side(result: MapResult, motions: Sequence[Similarity | None]) -> list[Similarity]:
    gap = GAP_SHARE * max(part.diameter for part in result.components)
    xy = np.column_stack([result.points.x, result.points.y])
    found: list[Similarity] = []
    edge = 0.0
    for index, motion in enumerate(motions):
        own = xy[result.points.component == index]
        settled = motion or Similarity(scale=1.0, turn_rad=0.0, is_mirrored=False, shift=(0.0, 0.0))
        if index:
            turned = own @ settled.matrix.T
            shift = (edge + gap - float(turned[:, 0].min()), float(own[:, 1].mean() - turned[:, 1].mean()))
            settled = replace(settled, shift=shift)
        found.append(settled)
        edge = float(settled(own)[:, 0].max())
    return found


def _move_points(points: Points, motions: Sequence[Similarity]) -> Points:
    xy = np.column_stack([points.x, points.y])
    for index, motion in enumerate(motions):
        chosen = points.component == index
        xy[chosen] = motion(xy[chosen])
    return replace(points, x=read_only(xy[:, 0].copy()), y=read_only(xy[:, 1].copy()))


def _move_hole(hole: Hole, motion: Similarity) -> Hole:
    """Move outline and centre; a mirrored outline is walked the other way, so that it is counter-clockwise again."""
    outline = motion(hole.outline_xy)
    if motion.is_mirrored and len(outline):
        outline = np.concatenate([outline[:1], outline[:0:-1]])
    centre = None if hole.centre is None else read_only(motion(hole.centre[None, :])[0])
    return replace(hole, outline_xy=read_only(outline), centre=centre)


def _move_landmark(landmark: Landmark, motion: Similarity) -> Landmark:
    x, y = motion(np.array([[landmark.x, landmark.y]]))[0].tolist()
    return replace(landmark, x=x, y=y)
