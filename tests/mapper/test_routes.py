"""Routes: the shortest of each kind, against every walk of a small graph; kinds that are told apart are not homotopic."""

from dataclasses import replace
from heapq import heappop, heappush

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapper.crossings import Signature, cross_rays, invert, join
from mapper.errors import PlaceError, RouteError
from mapper.map_sketch import MapSketch, Obstacle
from mapper.places import MapPlace, PointPlace, find_place, parse_place
from mapper.routes import ClassSearch, WayGraph, find_routes, turns_about
from mapper.types import FloatArray

letters = st.lists(st.integers(-4, 4).filter(bool), max_size=8)


@given(letters, letters, letters)
@settings(max_examples=50)
def test_signatures_are_a_group(a: list[int], b: list[int], c: list[int]) -> None:
    one, two, three = (join((), word) for word in (a, b, c))
    assert join(join(one, two), three) == join(one, join(two, three))
    assert join(one, invert(one)) == () == join(invert(one), one)
    assert invert(join(one, two)) == join(invert(two), invert(one))


coordinate = st.integers(-6, 6).map(float)
place = st.tuples(coordinate, coordinate)


@given(st.lists(place, min_size=2, max_size=8), st.lists(place, min_size=1, max_size=3, unique=True))
@settings(max_examples=50)
def test_a_way_there_and_back_crosses_nothing_and_a_closed_one_crosses_as_often_as_it_turns(
    way: list[tuple[float, float]], centres: list[tuple[float, float]]
) -> None:
    """Centres are put off the grid of the way, so that no step goes through one."""
    off = np.array(centres) + np.array([0.5, 0.25])
    corners = np.array([*way, way[0]])
    steps = cross_rays(corners[:-1], corners[1:], off)
    back = cross_rays(corners[1:], corners[:-1], off)
    assert [invert(step) for step in steps] == back
    word: Signature = ()
    for step in steps:
        word = join(word, step)
    if _is_off(corners, off):
        for number, centre in enumerate(off, start=1):
            # Left to right above a centre is clockwise.
            assert round(turns_about(corners, centre)) == sum(letter == -number for letter in word) - sum(
                letter == number for letter in word
            )


def _is_off(corners: FloatArray, centres: FloatArray) -> bool:
    """No step goes through a centre: its ends and the centre are not on one line, or it is not between them."""
    a, b = corners[:-1, None], corners[1:, None]
    cross = (b - a)[..., 0] * (centres - a)[..., 1] - (b - a)[..., 1] * (centres - a)[..., 0]
    return bool((np.abs(cross) > 1e-9).all() or not np.any((np.abs(cross) <= 1e-9) & (np.minimum(a, b) <= centres).all(-1)))


def _grid(width: int, height: int, *, without: set[tuple[int, int]]) -> tuple[FloatArray, list[tuple[int, int]]]:
    cells = [(x, y) for x in range(width) for y in range(height) if (x, y) not in without]
    number = {cell: k for k, cell in enumerate(cells)}
    edges = [
        (number[cell], number[other]) for cell in cells for other in ((cell[0] + 1, cell[1]), (cell[0], cell[1] + 1)) if other in number
    ]
    return np.array(cells, dtype=np.float64), edges


def _shortest_by_kind(graph: WayGraph, centres: FloatArray, *, limit: float) -> dict[Signature, float]:
    """Take every walk in order of length: no bound, no heuristic, no state but the walk's end and its word worked out from its corners."""
    steps: dict[int, list[tuple[int, float]]] = {}
    for (a, b), length in zip(graph.edges.tolist(), graph.lengths.tolist(), strict=True):
        steps.setdefault(a, []).append((b, length))
        steps.setdefault(b, []).append((a, length))
    heap: list[tuple[float, tuple[int, ...]]] = [(0.0, (graph.begin,))]
    found: dict[Signature, float] = {}
    seen: set[tuple[int, Signature]] = set()
    while heap:
        length, walk = heappop(heap)
        word: Signature = ()
        for step in cross_rays(graph.xy[list(walk[:-1])], graph.xy[list(walk[1:])], centres):
            word = join(word, step)
        if (walk[-1], word) in seen:
            continue
        seen.add((walk[-1], word))
        if walk[-1] == graph.end:
            found.setdefault(word, length)
        for following, step_length in steps.get(walk[-1], []):
            if length + step_length <= limit:
                heappush(heap, (length + step_length, (*walk, following)))
    return found


@given(st.data())
@settings(max_examples=20)
def test_each_route_is_the_shortest_walk_of_its_kind(data: st.DataObject) -> None:
    xy, edges = _grid(4, 3, without={(1, 1)} if data.draw(st.booleans()) else set())
    lengths = np.array(data.draw(st.lists(st.integers(1, 4), min_size=len(edges), max_size=len(edges))), dtype=np.float64)
    begin, end = data.draw(st.permutations(range(len(xy))))[:2]
    centres = np.array(
        data.draw(st.lists(st.sampled_from([(0.4, 0.6), (1.1, 1.2), (2.3, 0.7), (1.6, 1.4)]), min_size=1, max_size=2, unique=True))
    )
    graph = WayGraph(
        xy=np.concatenate([xy, xy[[begin, end]]]),
        edges=np.array([*edges, (begin, len(xy)), (end, len(xy) + 1)]),
        lengths=np.array([*lengths, 0.0, 0.0]),
    )
    search = ClassSearch(graph, centres, longest_detour=5.0)
    found = list(search.run())
    assert search.is_exhausted
    assert len({signature for _, _, signature in found}) == len(found)
    assert [length for _, length, _ in found] == sorted(length for _, length, _ in found)
    assert {signature: length for _, length, signature in found} == _shortest_by_kind(graph, centres, limit=search.shortest + 5.0)
    for path, length, signature in found:
        steps = [(min(pair), max(pair)) for pair in zip(path[:-1].tolist(), path[1:].tolist(), strict=True)]
        known = dict(zip([(min(edge), max(edge)) for edge in graph.edges.tolist()], graph.lengths.tolist(), strict=True))
        assert sum(known[step] for step in steps) == length
        word: Signature = ()
        for step in cross_rays(graph.xy[path[:-1]], graph.xy[path[1:]], centres):
            word = join(word, step)
        assert word == signature


def _square(x: float, y: float, half: float) -> FloatArray:
    return np.array([(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)])


def _field(*blocks: tuple[int, int]) -> MapSketch:
    """Lay out a field of 11 x 7 points a unit apart, joined also across; blocks of 3 x 3 points stand in it, with all that is in them."""
    without = {(x + dx, y + dy) for x, y in blocks for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
    xy, straight = _grid(11, 7, without=without)
    across = [(i, j) for i in range(len(xy)) for j in range(i) if np.allclose(np.abs(xy[i] - xy[j]), 1.0)]
    edges = np.array([*straight, *across])
    return MapSketch(
        xy=xy,
        component=np.zeros(len(xy), dtype=np.int64),
        met_xy=xy,
        met_component=np.zeros(len(xy), dtype=np.int64),
        met_t_s=np.arange(len(xy), dtype=np.float64),
        met_id1=tuple(map(str, range(len(xy)))),
        met_id2=("door",) * len(xy),
        landmarks=(),
        obstacles=tuple(
            Obstacle(number=number, component=0, polygon=_square(x, y, 1.4), centre=np.array([float(x), float(y)]))
            for number, (x, y) in enumerate(blocks, start=1)
        ),
        edges=edges,
        cover_radii=(1.0,),
        length_unit="m",
    )


def _ends(sketch: MapSketch, begin: tuple[float, float], end: tuple[float, float]) -> tuple[PointPlace, PointPlace]:
    first, last = (int(np.flatnonzero((sketch.xy == place).all(axis=1))[0]) for place in (begin, end))
    return PointPlace(index=first), PointPlace(index=last)


def test_one_obstacle_is_passed_on_either_side_and_there_is_no_third_way() -> None:
    sketch = _field((5, 3))
    begin, end = (find_place(place, sketch) for place in _ends(sketch, (0.0, 3.0), (10.0, 3.0)))
    found = find_routes(sketch, begin, end, classes=16)
    assert found.is_complete
    # Two columns up or down: six straight steps and four across.
    assert [route.length for route in found.routes] == pytest.approx([6 + 4 * np.sqrt(2)] * 2)
    assert sorted(round(route.passes[0][1], 3) for route in found.routes) == [-0.5, 0.5]


def test_two_obstacles_one_after_the_other_are_passed_in_four_ways_first() -> None:
    sketch = _field((3, 3), (7, 3))
    begin, end = (find_place(place, sketch) for place in _ends(sketch, (0.0, 3.0), (10.0, 3.0)))
    found = find_routes(sketch, begin, end, classes=4)
    sides = {tuple(turns > 0 for _, turns in route.passes) for route in found.routes}
    assert len(sides) == 4
    assert all(abs(turns) < 1 for route in found.routes for _, turns in route.passes)


def test_no_route_passes_through_an_obstacle() -> None:
    """Edges are added that lead straight through; none is used."""
    sketch = _field((5, 3))
    begin, end = _ends(sketch, (3.0, 3.0), (7.0, 3.0))
    through = replace(sketch, edges=np.concatenate([sketch.edges, [[begin.index, end.index]]]))
    ends = find_place(begin, sketch), find_place(end, sketch)
    assert [route.length for route in find_routes(through, *ends, classes=2).routes] == [
        route.length for route in find_routes(sketch, *ends, classes=2).routes
    ]


def test_from_a_place_to_itself_there_is_one_route_of_no_length() -> None:
    sketch = _field((5, 3))
    for named in (PointPlace(index=0), MapPlace(x=0.3, y=0.2)):
        found = find_routes(sketch, find_place(named, sketch), find_place(named, sketch), classes=4)
        assert [(route.length, route.length_error, len(route.xy)) for route in found.routes] == [(0.0, 0.0, 1)]


def test_there_and_back_are_as_long() -> None:
    sketch = _field((3, 2), (7, 4))
    begin, end = (find_place(place, sketch) for place in (MapPlace(x=0.2, y=0.1), MapPlace(x=9.8, y=5.9)))
    forth, back = find_routes(sketch, begin, end, classes=5), find_routes(sketch, end, begin, classes=5)
    assert [route.length for route in forth.routes] == pytest.approx([route.length for route in back.routes])
    assert {route.signature for route in forth.routes} == {invert(route.signature) for route in back.routes}


def test_places_that_nothing_joins_are_told() -> None:
    sketch = _field((5, 3))
    is_left = sketch.xy[:, 0] < 5
    cut = is_left[sketch.edges[:, 0]] == is_left[sketch.edges[:, 1]]
    apart = replace(sketch, edges=sketch.edges[cut])
    begin, end = (find_place(place, sketch) for place in _ends(sketch, (0.0, 3.0), (10.0, 3.0)))
    with pytest.raises(RouteError, match="no edges of the complex join them"):
        find_routes(apart, begin, end, classes=2)
    two = replace(sketch, cover_radii=(1.0, 1.0), component=np.where(is_left, 0, 1))
    begin, end = (find_place(place, two) for place in _ends(sketch, (0.0, 3.0), (10.0, 3.0)))
    with pytest.raises(RouteError, match="components 0 and 1"):
        find_routes(two, begin, end, classes=2)
    inside = find_place(MapPlace(x=5.0, y=3.0), sketch)
    with pytest.raises(RouteError, match="inside the obstacle drawn in hole 1"):
        find_routes(sketch, inside, find_place(PointPlace(index=0), sketch), classes=2)


@pytest.mark.parametrize(
    "text",
    [
        "landmark:7",
        "landmark:7@12.5",
        "landmark:north door",
        "biobot:a@b@3",
        "biobot:3@61.5",
        "biobot:3",
        "point:17",
        "xy:1.5,-2,0",
        "xy:-1e-05,2,3",
    ],
)
def test_places_are_written_as_they_are_read(text: str) -> None:
    assert str(parse_place(text)) == text


@pytest.mark.parametrize("text", ["", "landmark", "biobot:", "point:-1", "xy:1", "xy:nan,1", "xy:1e999,0"])
def test_what_is_no_place_is_told(text: str) -> None:
    with pytest.raises(PlaceError):
        parse_place(text)
