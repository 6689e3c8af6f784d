"""Place encounters in the plane: a start from their distances to the landmarks, then all tracks of biobots settled together.

Distances to landmarks are of walks, which are crooked. What a single biobot walked between two encounters is hardly so: the way is short,
and its legs are straight. Each encounter belongs to two tracks, and landmarks to many, so that the tracks hold each other in place.
"""

from dataclasses import dataclass

import numpy as np

from mapper.embedding import embed_in_plane, one_thread
from mapper.encounter_graph import EncounterGraph, select_links
from mapper.kernels import Links, Tension, VertexArray
from mapper.types import BoolArray, FloatArray, IntArray

# Own choices, on training runs (docs/accuracy.md); the result hardly depends on them. Of a link's time, of the speed, and of the weight of
# an encounter that a link of no error has.
_DRIFT = 0.1
_SWERVE = 0.3
_PULL = 0.3
# More of either changes nothing: 30 rounds of 40 steps place no better (measured).
_ROUNDS = 12
_STEPS = 8
# A contact lasts sqrt(3) radii of a biobot that passes, in the median over all distances at which it may pass; its place is known to less.
_BLUR_PER_CONTACT = 0.3
# Where encounters have no length, their places are known to this share of a link.
_LEAST_BLUR = 0.02
_DAMPING = 0.1  # of the spread of references along their line
_STRESS_ROUNDS = 200
_STRESS_NUMBERS = 2**22  # of all rounds together, beyond which there are fewer
# Encounters that are placed together, in so many spells of time.
_MAX_PLACED = 40_000
_BLOCKS = 8
_DIRECTIONS = 16
_BEND_PER_DISTANCE = 1.0  # how much a difference in bends counts beside one in place (own choice, on training runs)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """Where vertices are in the plane.

    ``xy`` [ticks], shape (v, 2), nan where ``is_placed``, shape (v,), is False; ``doubt`` [ticks], shape (v,): how badly each is known.
    """

    xy: FloatArray
    is_placed: BoolArray
    doubt: FloatArray


def place_in_plane(graph: EncounterGraph, references: IntArray, *, middle: FloatArray, doubt: FloatArray, contact: float) -> Placement:
    """Place the vertices of a connected graph.

    Parameters
    ----------
    references
        Landmarks, at least three, shape (l,).
    middle, doubt
        Bracketed distances to them [ticks], shapes (v, l) and (v,); see `mapper.profiles`.
    contact
        How long encounters last, their median [ticks].

    Notes
    -----
    Least squares, weighted anew a dozen times by how well each residual fits: a link is as long as its time, or shorter; a biobot's
    velocity is the same from one link to the next, but where it turned; every encounter is drawn to where it starts, the more the
    better its distances are known. References start from classical scaling and weighted stress, the others from their
    distances to those. Of more than 40,000 vertices, those of eight spells of time are placed, and references.
    """
    chosen = _choose_vertices(graph, references)
    number = np.full(graph.n_vertices, -1, dtype=np.int32)
    number[chosen] = np.arange(len(chosen), dtype=np.int32)
    is_inside = (number[graph.links.sources] >= 0) & (number[graph.links.targets] >= 0)
    links = _in_order_of_places(select_links(graph.links, is_inside, number))
    blur = max(_BLUR_PER_CONTACT * contact, _LEAST_BLUR * float(np.median(graph.links.times)))
    with one_thread():
        start = _start(middle[chosen], number[references], blur=blur)
    pull = _PULL / (doubt[chosen] + blur) ** 2
    tension = Tension(blur=blur, drift=_DRIFT, swerve=_SWERVE)
    xy = np.full((graph.n_vertices, 2), np.nan)
    xy[chosen] = graph.kernels.settle_tracks(links, start, pull, tension=tension, rounds=_ROUNDS, steps=_STEPS)
    return Placement(xy=xy, is_placed=number >= 0, doubt=doubt)


def placed_profiles(
    graph: EncounterGraph, placement: Placement, candidates: BoolArray, references: IntArray, *, middle: FloatArray, n_neighbours: int
) -> FloatArray:
    """Describe candidates by their distances to landmarks and to lines far away [ticks], shape (v, l + 16); nan for the others.

    Notes
    -----
    A distance to a landmark is that in the plane and, averaged over the candidates around, what the walk was longer: the bend of the
    geodesic around a hole is the same for neighbours, the crookedness of their walks is not. A distance to a line far away is a coordinate.
    The largest difference of two rows is thus no less than the distance in the plane, within half a percent, and no less
    than what any landmark tells.
    """
    rows = np.flatnonzero(candidates)
    xy = placement.xy[rows]
    straight = np.hypot(*(xy[:, None] - placement.xy[references][None]).transpose(2, 0, 1))
    bend = middle[rows] - straight
    # Neighbours in the plane, but not across a wall, where the ways to many landmarks differ.
    near = np.column_stack([bend / _BEND_PER_DISTANCE, xy])
    mean = graph.kernels.average_nearest(near, n_nearest=min(len(rows), n_neighbours))
    angles = np.arange(_DIRECTIONS) * (np.pi / _DIRECTIONS)
    lines = xy[:, :1] * np.cos(angles) + xy[:, 1:] * np.sin(angles)
    profiles = np.full((graph.n_vertices, len(references) + _DIRECTIONS), np.nan)
    profiles[rows] = np.column_stack([straight + _BEND_PER_DISTANCE * mean[:, : len(references)], lines])
    return profiles


def _choose_vertices(graph: EncounterGraph, references: IntArray) -> IntArray:
    """Take all vertices, or those of some spells of time and the references; ascending."""
    n = graph.n_vertices
    if n <= _MAX_PLACED:
        return np.arange(n)
    length = _MAX_PLACED // _BLOCKS
    begins = np.arange(_BLOCKS) * (n - length) // (_BLOCKS - 1)
    return np.union1d((begins[:, None] + np.arange(length)).ravel(), references)


def _in_order_of_places(links: Links) -> Links:
    """Sort links by their vertices: the order of the biobots of one encounter is that of their names, which must not matter."""
    order = np.lexsort((links.times, links.sources, links.targets))
    number = np.empty(len(order), dtype=np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    before = links.before[order]
    return Links(
        sources=links.sources[order],
        targets=links.targets[order],
        times=links.times[order],
        before=np.where(before < 0, np.int32(-1), number[before]) if len(order) else before,
    )


def _start(middle: FloatArray, references: VertexArray, *, blur: float) -> FloatArray:
    """Place references by the distances between them, and all others by theirs to those: shape (m, 2)."""
    between = (middle[references] + middle[references].T) / 2
    placed = _lower_stress(between, embed_in_plane(between).coordinates, blur=blur)
    centred = placed - placed.mean(axis=0)
    squared = ((placed[:, None] - placed[None]) ** 2).sum(axis=2)
    # Linear in the squared distances: [dST04].
    left, spread, right = np.linalg.svd(centred, full_matrices=False)
    # References near a line say next to nothing of places beside it: damped, or the error of a distance would be multiplied.
    damped = spread / (spread**2 + (_DAMPING * spread[0]) ** 2)
    start = -0.5 * (middle**2 - squared.mean(axis=0)) @ (left * damped) @ right + placed.mean(axis=0)
    start[references] = placed
    return np.asarray(start)


def _lower_stress(distances: FloatArray, xy: FloatArray, *, blur: float) -> FloatArray:
    """Move points, shape (l, 2), until their distances fit; short ones weigh more, as geodesics bend. SMACOF, Guttman transforms."""
    m = len(distances)
    weights = 1.0 / (distances + 2.0 * blur) ** 2
    np.fill_diagonal(weights, 0.0)
    weights /= weights.mean()
    inverse = np.linalg.pinv(np.diag(weights.sum(axis=1)) - weights)
    for _ in range(min(_STRESS_ROUNDS, 1 + _STRESS_NUMBERS // m**2)):
        apart = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
        ratio = np.divide(weights * distances, apart, out=np.zeros_like(apart), where=apart > 0)
        xy = inverse @ (np.diag(ratio.sum(axis=1)) - ratio) @ xy
    return xy
