"""Geodesics agree with a slow obvious version, obey the laws of a metric, and know what is outside and what only touches."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from shapely.affinity import rotate, translate
from shapely.geometry import MultiPolygon, Point, Polygon, box

from simulator.arenas.arena import Arena, build_arena
from simulator.arenas.geodesics import Geodesics, geodesic_distances
from simulator.errors import OutsideArenaError
from tests.simulator.arenas import arenas

Floats = NDArray[np.float64]
Shape = Polygon | MultiPolygon

ROOM = box(0, 0, 10, 10)
# Lines may leave the oracle's arena by this much, so that rounding does not close its walls.
_SLACK = 1e-10


def _without(*obstacles: Shape) -> Polygon:
    shape = ROOM.difference(shapely.union_all(obstacles))
    assert isinstance(shape, Polygon)
    return shape


def _spiral() -> Polygon:
    """A corridor that winds inwards for two turns."""
    outer: list[tuple[float, float]] = [
        (0, 0),
        (10, 0),
        (10, 10),
        (0, 10),
        (0, 2),
        (8, 2),
        (8, 8),
        (2, 8),
        (2, 4),
        (6, 4),
        (6, 6),
        (4, 6),
        (4, 5),
        (5, 5),
    ]
    inner: list[tuple[float, float]] = [(5, 4.5), (3, 4.5), (3, 7), (7, 7), (7, 3), (1, 3), (1, 9), (9, 9), (9, 1), (0, 1)]
    return Polygon(outer + inner)


KINDS: dict[str, Callable[[], Shape]] = {
    "no hole": lambda: ROOM,
    "two square holes": lambda: _without(box(1, 1, 4, 4), box(6, 6, 9, 9)),
    "walls in line": lambda: _without(box(1, 1, 3, 3), box(4, 1, 6, 3), box(7, 1, 9, 3), box(1, 5, 3, 7)),
    "non-convex holes": lambda: _without(
        Polygon([(2, 2), (8, 2), (8, 8), (7, 8), (7, 3), (3, 3), (3, 8), (2, 8)]), Polygon([(4, 5), (6, 4.5), (5, 6), (5, 5.2)])
    ),
    "L": lambda: Polygon([(0, 0), (10, 0), (10, 3), (3, 3), (3, 10), (0, 10)]),
    "U corridor": lambda: Polygon([(0, 0), (10, 0), (10, 10), (8, 10), (8, 2), (2, 2), (2, 10), (0, 10)]),
    "spiral corridor": _spiral,
    "thin walls": lambda: _without(box(0, 2.5, 8, 2.500001), box(2, 5, 10, 5.000001), box(0, 7.5, 8, 7.500001)),
    "round hole": lambda: _without(Point(5, 5).buffer(3)),
    "corners in walls": lambda: _without(
        box(2, 0.5, 4, 1), Polygon([(2, 2), (5, 5), (2, 5)]), Polygon([(8, 8), (5, 7), (8, 6)]), Polygon([(5, 7), (4, 8), (4, 7)])
    ),
    "two rooms": lambda: MultiPolygon([box(0, 0, 4.9, 10), Polygon([(5.1, 0), (10, 0), (10, 10), (8, 10), (8, 1), (5.1, 1)])]),
}


# Two of its walls are in one line, and the outside between them.
_ALONG_TWO_WALLS = MultiPolygon(
    [
        Polygon(
            [
                (-1.8369701987210296e-15, -10),
                (7.071067811865474, -7.071067811865477),
                (5, 0),
                (3.3184596357233542, 3),
                (0.37936640060244353, 3),
                (0.19707724047709727, 1.9285334300587678),
                (0.3685172114594669, 2.5),
                (1.768517211459467, 0.7),
                (-0.23148278854053306, 0.5),
                (-0.13045230626647325, 0.8367682742468661),
                (-6.397333378037128, 4.0373314928857305),
                (-10, 1.2246467991473533e-15),
                (-7.071067811865477, -7.071067811865475),
            ]
        ),
        Polygon([(1.0637345307083175, 7.0226065688021), (0.37953328217409604, 3.000980903225633), (3.3179098262675706, 3.000980903225633)]),
    ]
)


def plain_arenas() -> st.SearchStrategy[Arena]:
    """Arenas without coordinates whose squares underflow: GEOS, which judges here, divides by zero then."""
    return arenas().filter(lambda arena: not np.any((arena.wall_start != 0) & (np.abs(arena.wall_start) < 1e-100)))


def roomy(shape: Shape) -> Shape:
    """Return the shape with a hair's breadth of what is around it."""
    with_slack: Shape = shape.buffer(_SLACK, join_style="mitre", mitre_limit=50.0)
    shapely.prepare(with_slack)
    return with_slack


def oracle(shape: Shape, points: Floats, *, closed: Floats | None = None) -> Floats:
    """Join all points and all corners between which the line is in the arena, and look for shortest paths; ``closed`` lets none through."""
    corners = np.unique(shapely.get_coordinates(shape), axis=0)
    if closed is not None:
        corners = corners[np.abs(corners[:, None] - closed).max(axis=2).min(axis=1) > 1e-6]
    places = np.vstack([points, corners])
    i, j = np.triu_indices(len(places), 1)
    lines = shapely.linestrings(np.stack([places[i], places[j]], axis=1))
    free = shapely.covers(roomy(shape), lines)
    if closed is not None:
        free &= shapely.distance(lines, shapely.MultiPoint(closed)) > 1e-7
    lengths = np.maximum(np.linalg.norm(places[i] - places[j], axis=1), 1e-300)[free]
    graph = csr_array((lengths, (i[free], j[free])), shape=(len(places), len(places)))
    return dijkstra(graph, directed=False)[: len(points), : len(points)]


def sample(shape: Shape, rng: np.random.Generator, n: int) -> Floats:
    """Draw points inside, on walls, in corners, and in line with two corners each."""
    x_min, y_min, x_max, y_max = shape.bounds
    anywhere = rng.uniform((x_min, y_min), (x_max, y_max), size=(8 * n, 2))
    inside = anywhere[shapely.contains_xy(shape, anywhere[:, 0], anywhere[:, 1])][:n]
    on_walls = shapely.get_coordinates(shapely.line_interpolate_point(shape.boundary, rng.uniform(0, shape.length, n // 2)))
    corners = shapely.get_coordinates(shape)
    pairs = rng.integers(len(corners), size=(2 * n, 2))
    share = rng.choice([0.25, 0.5, -0.5, 1.5, 2.0, -1.0, 0.1], size=(2 * n, 1))
    in_line = corners[pairs[:, 0]] + share * (corners[pairs[:, 1]] - corners[pairs[:, 0]])
    in_line = in_line[shapely.distance(shape, shapely.points(in_line)) < 1e-13]
    return np.vstack([inside, on_walls, corners[rng.integers(len(corners), size=n // 2)], in_line])


def assert_equal_distances(found: Floats, wanted: Floats) -> None:
    assert np.array_equal(np.isfinite(found), np.isfinite(wanted))
    assert np.allclose(found, wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 17.3, 261.4])
@pytest.mark.parametrize("kind", KINDS)
def test_geodesics_agree_with_all_pairs_of_corners_joined(kind: str, degrees: float) -> None:
    shape = KINDS[kind]()
    touching = np.array([[5.0, 7.0]]) if kind == "corners in walls" else None
    turned = translate(rotate(shape, degrees, origin=(0, 0)), 3 * degrees, -degrees)
    if touching is not None:
        moved = translate(rotate(Point(5, 7), degrees, origin=(0, 0)), 3 * degrees, -degrees)
        touching = np.array([[moved.x, moved.y]])
    for seed in range(3):
        points = sample(turned, np.random.default_rng(seed), 24)
        if touching is not None:
            points = points[np.linalg.norm(points - touching, axis=1) > 1e-6]
        assert_equal_distances(geodesic_distances(build_arena(turned), points), oracle(turned, points, closed=touching))


@settings(max_examples=40)
@given(arena=plain_arenas(), seed=st.integers(0, 2**32 - 1))
def test_geodesics_agree_with_the_oracle_in_any_arena(arena: Arena, seed: int) -> None:
    points = sample(arena.polygon, np.random.default_rng(seed), 12)
    assume(len(points) > 2)
    assert_equal_distances(geodesic_distances(arena, points), oracle(arena.polygon, points))


@settings(max_examples=60)
@example(arena=build_arena(_ALONG_TWO_WALLS), seed=11)
@given(arena=plain_arenas(), seed=st.integers(0, 2**32 - 1))
def test_geodesics_obey_the_laws_of_a_metric(arena: Arena, seed: int) -> None:
    points = sample(arena.polygon, np.random.default_rng(seed), 16)
    assume(len(points) > 2)
    lengths = geodesic_distances(arena, points)
    straight = np.linalg.norm(points[:, None] - points, axis=2)
    i, j = np.triu_indices(len(points), 1)
    lines = shapely.linestrings(np.stack([points[i], points[j]], axis=1))
    free = shapely.covers(arena.polygon, lines)
    # GEOS takes a line along two walls for covered, though the outside is between them; not so where no wall is exactly in line.
    free &= shapely.covers(roomy(arena.polygon), lines)
    assert np.array_equal(lengths, lengths.T)
    assert not lengths.diagonal().any()
    assert np.all(lengths >= straight - 1e-12)
    assert np.allclose(lengths[i[free], j[free]], straight[i[free], j[free]], rtol=0, atol=1e-9)
    around = np.min(lengths[:, :, None] + lengths[None, :, :], axis=1)
    assert np.all(lengths <= around + 1e-9)


@given(st.floats(-1000, 1000), st.floats(-1000, 1000), st.floats(0, 360), st.floats(0.01, 100))
def test_moving_turning_and_scaling_the_arena_does_so_with_geodesics(x: float, y: float, degrees: float, scale: float) -> None:
    shape = KINDS["non-convex holes"]()
    points = sample(shape, np.random.default_rng(1), 8)

    def move(places: Floats) -> Floats:
        turn = math.radians(degrees)
        matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        moved: Floats = scale * places @ matrix.T + (x, y)
        return moved

    moved = shapely.transform(shape, move)
    wanted = scale * geodesic_distances(build_arena(shape), points)
    assert np.allclose(geodesic_distances(build_arena(moved), move(points)), wanted, rtol=1e-9, atol=1e-10 * scale)


def test_the_way_round_a_square_is_by_its_corners() -> None:
    """Centres of opposite sides of a square of side 4, 1 off it: 2 * sqrt(1 + 4) + 4."""
    lengths = geodesic_distances(build_arena(_without(box(3, 3, 7, 7))), np.array([[2.0, 5.0], [8.0, 5.0], [2.0, 5.0]]))
    assert np.isclose(lengths[0, 1], 2 * math.sqrt(5) + 4, rtol=0, atol=1e-12)
    assert lengths[0, 2] == 0


def test_nothing_passes_where_two_obstacles_touch() -> None:
    """Two squares of side 3 touch in (5, 5): from (4, 6) to (6, 4) the way is round one, sqrt(1 + 4) + 3 + 3 + sqrt(4 + 1)."""
    arena = build_arena(_without(box(2, 2, 5, 5), box(5, 5, 8, 8)))
    assert arena.betti.holes == 1
    lengths = geodesic_distances(arena, np.array([[4.0, 6.0], [6.0, 4.0], [5.0, 5.0]]))
    assert np.isclose(lengths[0, 1], 2 * math.sqrt(5) + 6, rtol=0, atol=1e-12)
    assert np.allclose(lengths[:2, 2], math.sqrt(2), rtol=0, atol=1e-12)


def test_rooms_that_only_touch_are_no_way_apart() -> None:
    lengths = geodesic_distances(build_arena(MultiPolygon([box(0, 0, 1, 1), box(1, 1, 2, 2)])), np.array([[0.5, 0.5], [1.5, 1.5]]))
    assert np.isinf(lengths[0, 1])


def test_two_sets_of_points_give_the_block_of_all() -> None:
    arena = build_arena(KINDS["two rooms"]())
    points = sample(arena.polygon, np.random.default_rng(5), 30)
    geodesics = Geodesics(arena)
    both = geodesics.distances(points)
    block = geodesics.distances(points[:7], points[5:])
    assert np.allclose(block, both[:7, 5:], rtol=0, atol=1e-12)
    assert geodesics.distances(points[:0]).shape == (0, 0)
    assert geodesics.distances(points[:0], points).shape == (0, len(points))
    assert geodesics.distances(points[:1]).tolist() == [[0.0]]


def test_many_points_in_many_blocks_change_nothing() -> None:
    arena = build_arena(KINDS["walls in line"]())
    points = sample(arena.polygon, np.random.default_rng(6), 300)
    lengths = geodesic_distances(arena, points)
    few = np.arange(0, len(points), 37)
    assert np.allclose(lengths[np.ix_(few, few)], geodesic_distances(arena, points[few]), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("place", "said"),
    [((5.0, 5.0), "row 1 at (5.0, 5.0), 2 from it"), ((-1.0, 3.0), "1 from it"), ((math.nan, 1.0), "nan"), ((math.inf, 1.0), "inf")],
)
def test_a_point_outside_is_named(place: tuple[float, float], said: str) -> None:
    arena = build_arena(_without(box(3, 3, 7, 7)))
    with pytest.raises(OutsideArenaError, match="1 point outside the arena") as caught:
        geodesic_distances(arena, np.array([[1.0, 1.0], place]))
    assert said in str(caught.value)
    assert caught.value.row == 1
