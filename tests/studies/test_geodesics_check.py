"""The simulator's geodesics agree with an independent method in every named arena, and large arenas stay quick."""

import numpy as np
import pytest
from shapely.geometry import box

from simulator.arenas.arena import Arena, build_arena
from simulator.arenas.geodesics import Geodesics
from studies.geodesics_check import WANTED_ERROR, check, draw_places, large_plan, main, named_arenas, slow_distances

ARENAS = dict(named_arenas(seed=3))
TURNED = dict(named_arenas(seed=4, degrees=17.3))


@pytest.mark.parametrize("name", ARENAS)
def test_geodesics_are_exact_in_every_named_arena(name: str) -> None:
    result = check(name, ARENAS[name], pairs=60, seed=7)
    assert max(result.error, check(name, TURNED[name], pairs=30, seed=8).error) <= WANTED_ERROR
    assert (result.without_way > 0) == (ARENAS[name].betti.components > 1)


def test_the_independent_method_goes_round_a_square_by_its_corners() -> None:
    """Centres of opposite sides of a square of side 4, 1 off it: 2 * sqrt(1 + 4) + 4."""
    arena = build_arena(box(0, 0, 10, 10).difference(box(3, 3, 7, 7)))  # type: ignore[arg-type]  # it stays a polygon
    one, other = np.array([[2.0, 5.0], [2.0, 5.0]]), np.array([[8.0, 5.0], [2.0, 5.0]])
    assert slow_distances(arena, one, other) == pytest.approx([2 * 5**0.5 + 4, 0.0])


def test_places_lie_within_on_walls_and_in_corners() -> None:
    arena: Arena = ARENAS["office"]
    places = draw_places(arena, np.random.default_rng(1), count=200)
    assert places.shape == (200, 2)
    roomy = arena.has_room(places)
    in_corners = (np.abs(places[:, None] - arena.wall_start).max(axis=2).min(axis=1) < 1e-12).sum()
    assert roomy.sum() >= 50
    assert in_corners >= 50
    assert 200 - roomy.sum() - in_corners >= 25


def test_a_floor_plan_of_two_thousand_walls_is_measured_and_agrees() -> None:
    arena = large_plan(seed=1)
    assert len(arena.wall_start) > 1_800
    places = draw_places(arena, np.random.default_rng(2), count=60)
    lengths = Geodesics(arena).distances(places)
    assert np.isfinite(lengths).all()
    around = np.min(lengths[:, :, None] + lengths[None, :, :], axis=1)
    assert np.all(lengths <= around + 1e-9)


def test_the_table_has_a_row_for_every_arena(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--pairs", "4", "--points", "0"]) == 0
    told = capsys.readouterr().out
    assert all(f"| {name} |" in told for name in ARENAS)
    with pytest.raises(SystemExit, match="2"):
        main(["--pairs", "0"])
