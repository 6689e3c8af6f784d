"""Laws of arenas."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from shapely.geometry import MultiPolygon, Polygon, box

from simulator.arenas.arena import Arena, build_arena
from simulator.errors import ArenaError
from tests.simulator.arenas import FIVE, arenas, cut_out


@pytest.mark.parametrize(
    ("shape", "components", "holes"),
    [
        (box(0, 0, 9, 9), 1, 0),
        (cut_out(box(0, 0, 9, 9), box(1, 1, 2, 2), box(4, 4, 5, 5)), 1, 2),
        (MultiPolygon([Polygon(box(0, 0, 9, 9).exterior, [box(1, 1, 2, 2).exterior]), box(10, 0, 19, 9)]), 2, 1),
        # Two holes that touch in a corner are one obstacle to whoever walks around them.
        (Polygon(box(0, 0, 9, 9).exterior, [box(2, 2, 4, 4).exterior, box(4, 4, 6, 6).exterior]), 1, 1),
        # A hole that touches the outer wall in a point cannot be walked around.
        (Polygon(box(0, 0, 9, 9).exterior, [[(0, 4), (2, 3), (2, 5)]]), 1, 0),
        (MultiPolygon([box(0, 0, 1, 1), box(1, 1, 2, 2)]), 2, 0),
    ],
)
def test_betti_numbers_count_what_can_be_walked(shape: Polygon | MultiPolygon, components: int, holes: int) -> None:
    betti = build_arena(shape).betti
    assert (betti.components, betti.holes) == (components, holes)


@pytest.mark.parametrize(
    ("shape", "problem"),
    [
        (Polygon(), "empty"),
        (Polygon([(0, 0), (2, 2), (2, 0), (0, 2)]), "Self-intersection"),
        (Polygon(box(0, 0, 1, 1).exterior, [box(2, 2, 3, 3).exterior]), "Hole lies outside"),
        (MultiPolygon([box(0, 0, 2, 2), box(1, 1, 3, 3)]), "not a valid area"),
        (Polygon([(0, 0), (1, 1), (2, 2)]), "not a valid area"),
    ],
)
def test_a_faulty_area_is_refused_with_its_fault(shape: Polygon | MultiPolygon, problem: str) -> None:
    with pytest.raises(ArenaError, match=problem):
        build_arena(shape, source="here")


@settings(max_examples=50)
@given(arenas())
def test_normals_point_inward_and_rings_close(arena: Arena) -> None:
    middle = (arena.wall_start + arena.wall_end) / 2
    step = 1e-9 * arena.wall_inward
    lengths = np.linalg.norm(arena.wall_end - arena.wall_start, axis=1)
    seen = lengths > 1e-6  # shorter walls drown in the rounding of this check
    assert shapely.contains_xy(arena.polygon, *(middle + step)[seen].T).all()
    assert not shapely.contains_xy(arena.polygon, *(middle - step)[seen].T).any()
    np.testing.assert_allclose((arena.wall_end - arena.wall_start).sum(axis=0), 0, atol=1e-9)


@pytest.mark.parametrize("name", FIVE)
def test_places_are_uniform_over_the_area(name: str) -> None:
    """20,000 places, and how many fall in each quadrant: within 5 standard deviations (at most 0.0035) of its share of area."""
    arena = FIVE[name]()
    places = arena.draw_places(seed=3, ids=np.arange(1, 20_001, dtype=np.uint64))
    assert arena.has_room(places).all()
    for quadrant in (box(-5, -5, 5, 5), box(5, -5, 15, 5), box(-5, 5, 5, 15), box(5, 5, 15, 15)):
        share = arena.polygon.intersection(quadrant).area / arena.area
        found = shapely.contains_xy(quadrant, places[:, 0], places[:, 1]).mean()
        assert abs(found - share) < 5 * 0.0035


def test_a_hair_has_no_room() -> None:
    with pytest.raises(ArenaError, match="no room found for 1 of 1 biobots"):
        build_arena(Polygon([(0, 0), (1, 1), (1, 1 + 1e-12), (0, 1e-12)])).draw_places(seed=1, ids=np.array([1], np.uint64))
