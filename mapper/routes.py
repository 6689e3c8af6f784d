"""Routes around obstacles: between two places the shortest way of each kind, where ways of one kind can be drawn into each other.

A route goes along the edges of the drawn complex, where biobots walked; edges that pass through an obstacle as it is drawn are left out.
Lengths are those in the picture: the map's distances between single points overstate short ways (`python -m studies.routes`).
Kinds are told apart by signatures (`mapper.crossings`), and the shortest routes of the best kinds are found by a search over places *and*
signatures [BLK12]: A* with the exact distance to the goal, whatever the kind, as its bound.
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, inf, sqrt

import numpy as np

from mapper.crossings import Signature, cross_rays, invert, join
from mapper.errors import RouteError
from mapper.map_sketch import MapSketch, Obstacle
from mapper.places import FoundPlace
from mapper.polygons import boundary_length, contains, crossing_sides
from mapper.types import BoolArray, FloatArray, IntArray

MAX_CLASSES = 16
MAX_STATES = 100_000
"""Pairs of a point and a signature that a search looks at before it gives up: about two seconds."""

_FULL_TURN = 1.0 - 1e-9
_N_GATES = 6  # points of the map that a place which is none of them is joined to


@dataclass(frozen=True, slots=True, kw_only=True)
class RouteErrors:
    """The variance of a length's error is ``(share * length)^2 + (per_cover * cover_radius)^2``.

    Trained by ``python -m studies.routes --train --runs 6`` on seeds from 0: lengths of shortest routes beside exact geodesics.
    """

    share: float = 0.137
    per_cover: float = 0.654


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Route:
    """The shortest route of its kind.

    ``xy``, shape (n, 2), are its corners from begin to end; ``length`` is that in the picture, and ``length_error``
    its standard error, both in the unit of the map; ``signature`` says on which sides it passes; ``passes`` has for each
    obstacle of the component its number and how far the route turns about its centre, in full turns, counter-clockwise.
    """

    xy: FloatArray
    length: float
    length_error: float
    signature: Signature
    passes: tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Routes:
    """Routes between two places, the shortest first; ``is_complete``: there is no other that is not far longer and does not wind."""

    begin: FoundPlace
    end: FoundPlace
    routes: tuple[Route, ...]
    is_complete: bool
    length_unit: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WayGraph:
    """Where a route may go: n places, shape (n, 2), the last two of which are begin and end; e edges, shape (e, 2), with their lengths."""

    xy: FloatArray
    edges: IntArray
    lengths: FloatArray

    @property
    def begin(self) -> int:
        """Where routes begin."""
        return len(self.xy) - 2

    @property
    def end(self) -> int:
        """Where they end."""
        return len(self.xy) - 1


def find_routes(sketch: MapSketch, begin: FoundPlace, end: FoundPlace, *, classes: int, errors: RouteErrors | None = None) -> Routes:
    """Find the shortest route of each of the best kinds.

    Parameters
    ----------
    classes
        How many kinds at most, from 1 to ``MAX_CLASSES``.
    errors
        How wrong lengths are; None takes what was trained.

    Raises
    ------
    RouteError
        The places are in different components, or one is in an obstacle, or no edges of the complex join them.

    Notes
    -----
    Routes that wind are left out: those that turn about the centre of an obstacle by a full turn or more, which follows from their kind
    and the places alone. So a single obstacle is passed on one side or on the other. No route is looked for that is longer than the
    shortest by more than twice the way around all obstacles. From a place to itself there is one route, of no length.
    """
    component = _check_places(sketch, begin, end)
    obstacles = [obstacle for obstacle in sketch.obstacles if obstacle.component == component]
    graph = _make_graph(sketch, begin, end, obstacles)
    around = sum(boundary_length(obstacle.polygon) for obstacle in obstacles)
    centres = np.array([obstacle.centre for obstacle in obstacles]).reshape(-1, 2)
    search = ClassSearch(graph, centres, longest_detour=2.0 * around)
    if search.shortest == inf:
        raise RouteError(
            begin=begin.name,
            end=end.name,
            problem="no edges of the complex join them without passing through an obstacle",
            next_step="record for longer, so that passages are seen, or name another place",
        )
    wrong = errors or RouteErrors()
    cover_radius = sketch.cover_radii[component]
    found = []
    for path, length, signature in search.run():
        xy = graph.xy[path]
        xy = xy[np.append(True, (np.diff(xy, axis=0) != 0).any(axis=1))]
        passes = tuple((obstacle.number, turns_about(xy, obstacle.centre)) for obstacle in obstacles)
        if all(abs(turns) < _FULL_TURN for _, turns in passes):
            error = sqrt((wrong.share * length) ** 2 + (wrong.per_cover * cover_radius) ** 2) if length > 0 else 0.0
            found.append(Route(xy=xy, length=length, length_error=error, signature=signature, passes=passes))
        if len(found) == min(classes, MAX_CLASSES):
            break
    is_complete = search.is_exhausted or (not obstacles)
    return Routes(begin=begin, end=end, routes=tuple(found), is_complete=is_complete, length_unit=sketch.length_unit)


class ClassSearch:
    """The shortest way of one kind after the other, in order of their lengths.

    Parameters
    ----------
    longest_detour
        No way is looked for that is longer than the shortest by more than this.
    """

    def __init__(self, graph: WayGraph, centres: FloatArray, *, longest_detour: float) -> None:
        from scipy.sparse import csr_array  # noqa: PLC0415  # a third of a second that no service has to wait for when it starts
        from scipy.sparse.csgraph import dijkstra  # noqa: PLC0415  # same

        self._graph = graph
        self._neighbours = _neighbours(graph, centres)
        forth = np.concatenate([graph.edges, graph.edges[:, ::-1]])
        matrix = csr_array((np.tile(graph.lengths, 2), tuple(forth.T)), shape=(len(graph.xy), len(graph.xy)))
        to_end = dijkstra(matrix, indices=np.array([graph.end]))[0]
        self._to_end: list[float] = to_end.tolist()
        self.shortest: float = self._to_end[graph.begin]
        self._limit = self.shortest + longest_detour
        self.is_exhausted = False

    def run(self) -> Iterator[tuple[IntArray, float, Signature]]:
        """Yield path, length and signature; ``is_exhausted`` is set when there are no more within the limit.

        Of equal lengths the one found by the lower points comes first, so equal input gives equal output.
        """
        begin, end = self._graph.begin, self._graph.end
        before: dict[tuple[int, Signature], tuple[int, Signature] | None] = {}
        best: dict[tuple[int, Signature], float] = {(begin, ()): 0.0}
        heap: list[tuple[float, float, int, Signature, tuple[int, Signature] | None]] = [(self.shortest, 0.0, begin, (), None)]
        while heap:
            bound, length, point, signature, previous = heapq.heappop(heap)
            state = (point, signature)
            if state in before:
                continue
            if len(before) >= MAX_STATES:
                return
            before[state] = previous
            if point == end:
                yield self._path(before, state), length, signature
            for neighbour, step, letters in self._neighbours[point]:
                reached = length + step
                bound = reached + self._to_end[neighbour]
                if bound > self._limit * (1.0 + 1e-12):
                    continue
                then = (neighbour, join(signature, letters))
                if then not in before and reached < best.get(then, inf):
                    best[then] = reached
                    heapq.heappush(heap, (bound, reached, neighbour, then[1], state))
        self.is_exhausted = True

    @staticmethod
    def _path(before: dict[tuple[int, Signature], tuple[int, Signature] | None], state: tuple[int, Signature]) -> IntArray:
        path = [state[0]]
        while (previous := before[state]) is not None:
            state = previous
            path.append(state[0])
        return np.array(path[::-1], dtype=np.int64)


def _neighbours(graph: WayGraph, centres: FloatArray) -> list[list[tuple[int, float, Signature]]]:
    """List the steps from each place: to where, how long, and which rays they cross; those to lower places first."""
    signatures = cross_rays(graph.xy[graph.edges[:, 0]], graph.xy[graph.edges[:, 1]], centres)
    steps: list[list[tuple[int, float, Signature]]] = [[] for _ in graph.xy]
    for (a, b), length, signature in zip(graph.edges.tolist(), graph.lengths.tolist(), signatures, strict=True):
        steps[a].append((b, length, signature))
        steps[b].append((a, length, invert(signature)))
    return [sorted(some) for some in steps]


def _check_places(sketch: MapSketch, begin: FoundPlace, end: FoundPlace) -> int:
    problem, next_step = None, ""
    if begin.component != end.component:
        problem = f"they are in components {begin.component} and {end.component}, which no biobot joins"
        next_step = "name places in one component, or record until biobots have walked between them"
    else:
        for place in (begin, end):
            for obstacle in sketch.obstacles:
                if obstacle.component == place.component and contains(obstacle.polygon, place.xy[None])[0]:
                    problem = f"{place.name} is inside the obstacle drawn in hole {obstacle.number}"
                    next_step = "name another place nearby"
    if problem is not None:
        raise RouteError(begin=begin.name, end=end.name, problem=problem, next_step=next_step)
    return begin.component


def _make_graph(sketch: MapSketch, begin: FoundPlace, end: FoundPlace, obstacles: list[Obstacle]) -> WayGraph:
    """Take the edges of the component that pass through no obstacle, and join begin and end to it."""
    own = sketch.component == begin.component
    edges = sketch.edges[own[sketch.edges[:, 0]]]
    lengths = np.hypot(*(sketch.xy[edges[:, 0]] - sketch.xy[edges[:, 1]]).T)
    is_free = ~_is_blocked(sketch.xy[edges[:, 0]], sketch.xy[edges[:, 1]], obstacles)
    xy = np.concatenate([sketch.xy, [begin.xy, end.xy]])
    gates = [_join_place(place, len(sketch.xy) + number, sketch, own, obstacles) for number, place in enumerate((begin, end))]
    joined = [*gates[0], *gates[1]]
    direct = float(hypot(*(end.xy - begin.xy)))
    if direct == 0.0 or (begin.point is not None and begin.point == end.point):
        joined.append((len(sketch.xy), len(sketch.xy) + 1, 0.0))
    elif direct <= max(sketch.cover_radii[begin.component], 0.0) and not _is_blocked(begin.xy[None], end.xy[None], obstacles)[0]:
        joined.append((len(sketch.xy), len(sketch.xy) + 1, direct))
    extra = np.array([pair[:2] for pair in joined], dtype=np.int64).reshape(-1, 2)
    return WayGraph(
        xy=xy,
        edges=np.concatenate([edges[is_free], extra]),
        lengths=np.concatenate([lengths[is_free], [pair[2] for pair in joined]]),
    )


def _join_place(
    place: FoundPlace, index: int, sketch: MapSketch, own: BoolArray, obstacles: list[Obstacle]
) -> list[tuple[int, int, float]]:
    """Join a place to itself if it is a point, or else to the nearest points in sight of it, as far as it is in the drawing."""
    if place.point is not None:
        return [(place.point, index, 0.0)]
    candidates = np.flatnonzero(own)
    away = np.hypot(*(sketch.xy[candidates] - place.xy).T)
    is_free = ~_is_blocked(np.repeat(place.xy[None], len(candidates), axis=0), sketch.xy[candidates], obstacles)
    order = np.flatnonzero(is_free)
    order = order[np.argsort(away[order], kind="stable")][:_N_GATES]
    return [(int(candidates[k]), index, float(away[k])) for k in order]


def _is_blocked(starts: FloatArray, ends: FloatArray, obstacles: list[Obstacle]) -> BoolArray:
    """Say which steps pass through an obstacle, shape (k,)."""
    blocked = np.zeros(len(starts), dtype=bool)
    for obstacle in obstacles:
        blocked |= crossing_sides(starts, ends, obstacle.polygon).any(axis=1) | contains(obstacle.polygon, starts)
    return blocked


def turns_about(xy: FloatArray, centre: FloatArray) -> float:
    """How far a way turns about a centre [full turns, counter-clockwise]."""
    x, y = (xy - centre).T
    turned = np.arctan2(x[:-1] * y[1:] - y[:-1] * x[1:], x[:-1] * x[1:] + y[:-1] * y[1:])
    return float(turned.sum()) / (2.0 * np.pi)
