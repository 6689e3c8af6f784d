"""Laws of the walk: within walls, and as random as it should be."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.arenas.arena import Arena
from simulator.legs import Legs
from tests.simulator.arenas import FIVE, arenas, square, world_in
from tests.simulator.plain.walk import reach_walls


def walk_legs(arena: Arena, *, until_s: float, seed: int = 1, biobots: int = 20, mean_leg: float = 2.0) -> Legs:
    world = world_in(arena, seed=seed, biobots=biobots, mean_leg=mean_leg)
    world.advance(until_s)
    return world.legs()


def check_inside(arena: Arena, legs: Legs) -> None:
    lines = shapely.linestrings(np.stack([np.column_stack(legs.at(legs.t_start_s)), np.column_stack(legs.at(legs.t_end_s))], axis=1))
    shapely.prepare(arena.polygon)
    assert shapely.covers(arena.polygon, lines).all()
    assert shapely.distance(arena.polygon.boundary, lines).min() > 0.99 * arena.margin


@settings(max_examples=60)
@given(arenas(), st.integers(0, 2**64 - 1), st.floats(0.01, 100))
def test_no_insect_ever_leaves_a_random_polygon(arena: Arena, seed: int, mean_leg: float) -> None:
    check_inside(arena, walk_legs(arena, until_s=20.0, seed=seed, biobots=10, mean_leg=max(mean_leg, 0.1)))


@pytest.mark.parametrize("name", FIVE)
def test_no_insect_ever_leaves_the_five_arenas(name: str) -> None:
    arena = FIVE[name]()
    check_inside(arena, walk_legs(arena, until_s=300.0, mean_leg=30.0))


@pytest.mark.parametrize("name", FIVE)
def test_paths_are_unbroken(name: str) -> None:
    legs = walk_legs(FIVE[name](), until_s=100.0)
    order = np.arange(len(legs))
    end_x, end_y = legs.at(legs.t_end_s)
    same = legs.biobot[order][1:] == legs.biobot[order][:-1]
    for start, end in ((legs.t_start_s, legs.t_end_s), (legs.x, end_x), (legs.y, end_y)):
        assert (start[order][1:][same] == end[order][:-1][same]).all()
    np.testing.assert_allclose(legs.vx**2 + legs.vy**2, 1, atol=1e-14)


def test_the_share_of_time_in_each_ring_of_a_square_stays_near_its_share_of_area() -> None:
    """Legs short against the side 10 make the wall's law matter little: 100 insects, 400 s, 5 % of the half with most rounding."""
    legs = walk_legs(square(), until_s=400.0, biobots=100, mean_leg=1.0)
    middle = legs.at((legs.t_start_s + legs.t_end_s) / 2)
    time_s = legs.t_end_s - legs.t_start_s
    inner = (np.abs(middle[0] - 5) < 3.5355) & (np.abs(middle[1] - 5) < 3.5355)
    assert abs(time_s[inner].sum() / time_s.sum() - 0.5) < 0.05


def test_mean_squared_displacement_follows_theory() -> None:
    """E[r^2] = 2 l*^2 (s - 1 + exp(-s)) after s mean legs, for isotropic turns.

    4,000 insects: r^2 is near exponential, so its mean has a relative standard deviation of 1/sqrt(4000) = 1.6 %.
    """
    world = world_in(square(10_000.0), biobots=4000, seed=4, mean_leg=2.0)
    start = world.positions()
    for legs_walked in (0.5, 2.0, 20.0):
        world.advance(2.0 * legs_walked)
        measured = np.mean(((world.positions() - start) ** 2).sum(axis=1))
        theory = 2 * 2.0**2 * (legs_walked - 1 + np.exp(-legs_walked))
        assert measured == pytest.approx(theory, rel=0.05)


def test_free_legs_are_exponential_and_point_everywhere() -> None:
    legs = walk_legs(square(10_000.0), until_s=200.0, biobots=200, mean_leg=2.0)
    length = legs.t_end_s - legs.t_start_s
    # Length-biased at the end of the window: only legs that began well before it.
    length = length[legs.t_start_s < 150]
    np.testing.assert_allclose([length.mean(), length.std()], [2.0, 2.0], rtol=0.05)
    headings = np.histogram(np.arctan2(legs.vy, legs.vx), bins=8, range=(-np.pi, np.pi))[0]
    np.testing.assert_allclose(headings / headings.sum(), 1 / 8, rtol=0.1)


def test_directions_from_a_wall_are_uniform_over_the_half_plane() -> None:
    legs = walk_legs(square(1.0), until_s=200.0, biobots=50, mean_leg=1e6)
    from_left = legs.x < 2e-9
    angle = np.arctan2(legs.vy, legs.vx)[from_left & (legs.y > 0.01) & (legs.y < 0.99)]
    assert np.abs(angle).max() <= np.pi / 2
    counts = np.histogram(angle, bins=6, range=(-np.pi / 2, np.pi / 2))[0]
    np.testing.assert_allclose(counts / counts.sum(), 1 / 6, rtol=0.15)


def test_a_ray_stops_a_margin_before_the_wall_and_meets_its_normal() -> None:
    arena = square()
    reach = reach_walls(
        arena, x=np.array([5.0, 9.0]), y=np.array([5.0, 5.0]), direction_x=np.array([1.0, 0.6]), direction_y=np.array([0.0, 0.8])
    )
    np.testing.assert_allclose(reach.length, [5 - arena.margin, (1 - arena.margin) / 0.6], rtol=1e-12)
    assert reach.normal_x.tolist() == [-1, -1]
    assert reach.normal_y.tolist() == [0, 0]


@pytest.mark.parametrize("biobots", [1, 7, 20])
def test_blocks_of_the_ray_search_change_nothing(biobots: int) -> None:
    arena = FIVE["thin walls"]()
    few, many = walk_legs(arena, until_s=50.0, biobots=biobots), walk_legs(arena, until_s=50.0, biobots=20)
    for row in range(biobots):
        assert (few.x[few.biobot == row] == many.x[many.biobot == row]).all()
