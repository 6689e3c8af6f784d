"""Laws of the named arenas."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LinearRing, Polygon, box

from simulator.arenas.arena import Arena, build_arena
from simulator.arenas.maze import LOOPS
from simulator.arenas.scenarios import SCENARIOS
from simulator.config import WorldConfig
from simulator.errors import ParameterError
from simulator.presets import PRESETS
from simulator.setting import choose_setting

# Components and holes; those of random arenas with the default seed.
BETTI = {
    "no-obstacle": (1, 0),
    "one-obstacle": (1, 1),
    "two-obstacles": (1, 2),
    "three-obstacles": (1, 3),
    "four-obstacles": (1, 4),
    "five-obstacles": (1, 5),
    "six-pillars": (1, 6),
    "disc": (1, 0),
    "corridor": (1, 0),
    "l-room": (1, 0),
    "u-corridor": (1, 0),
    "t-junction": (1, 0),
    "cross": (1, 0),
    "ring-corridor": (1, 1),
    "star": (1, 0),
    "thin-walls": (1, 0),
    "office": (1, 3),
    "maze": (1, 4),
    "rubble": (1, 12),
    "two-islands": (2, 1),
    "closing-door": (1, 2),
}


def holes_of(arena: Arena) -> list[LinearRing]:
    assert isinstance(arena.polygon, Polygon)
    return list(arena.polygon.interiors)


def test_every_scenario_has_its_betti_numbers() -> None:
    built = {name: scenario.build(50.0).betti for name, scenario in SCENARIOS.items()}
    assert {name: (betti.components, betti.holes) for name, betti in built.items()} == BETTI


def test_a_closing_door_parts_two_rooms_and_leaves_their_obstacles() -> None:
    scenario = SCENARIOS["closing-door"]
    ((share, after),) = scenario.build_changes(50.0)
    assert share == 0.5
    assert (after.betti.components, after.betti.holes) == (2, 2)
    slab = scenario.build(50.0).polygon.difference(after.polygon)
    assert slab.equals(box(24.9, 20, 25.1, 30))


def test_the_squares_of_the_paper_stay_where_they_were() -> None:
    """The corners are products of the side over 50 and whole numbers, bit for bit, and the outer ones are 0 and the side."""
    holes: dict[str, list[tuple[int, int, int, int]]] = {
        "no-obstacle": [],
        "one-obstacle": [(17, 17, 33, 33)],
        "two-obstacles": [(8, 8, 21, 21), (29, 29, 42, 42)],
    }
    for side in (50.0, 0.5, 5.0, 0.11, 7.3):
        for name, boxes in holes.items():
            scale = side / 50.0
            rings = [box(scale * x, scale * y, scale * x_max, scale * y_max).exterior for x, y, x_max, y_max in boxes]
            wanted = build_arena(Polygon(box(0.0, 0.0, side, side).exterior, rings))
            found = SCENARIOS[name].build(side, seed=9)
            assert np.array_equal(found.wall_start, wanted.wall_start)
            assert np.array_equal(found.wall_end, wanted.wall_end)
            assert found.margin == wanted.margin


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_fits_its_square_and_has_room(name: str) -> None:
    arena = SCENARIOS[name].build(5.0)
    x_min, y_min, x_max, y_max = arena.bounds
    assert min(x_min, y_min) >= 0
    assert 4.9 < max(x_max, y_max) <= 5
    assert arena.has_room(arena.draw_places(seed=1, ids=np.arange(1, 101, dtype=np.uint64))).all()


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_seed_matters_only_where_it_is_said_to(name: str) -> None:
    scenario = SCENARIOS[name]
    one, same, other = (scenario.build(50.0, seed=seed).polygon for seed in (1, 1, 2))
    assert one.wkb == same.wkb
    assert (one.wkb != other.wkb) == scenario.is_random


@settings(max_examples=25)
@given(st.integers(0, 2**64 - 1))
def test_every_maze_is_in_one_piece_and_has_its_loops(seed: int) -> None:
    arena = SCENARIOS["maze"].build(50.0, seed=seed)
    assert (arena.betti.components, arena.betti.holes) == (1, LOOPS)
    # No hole is a bare post: one wall of a cell at least, 0.4 thick and 8 long.
    assert min(Polygon(hole).area for hole in holes_of(arena)) > 0.4 * 8


@settings(max_examples=15)
@given(st.integers(0, 2**64 - 1))
def test_rubble_is_in_one_piece_with_passages_between_its_heaps(seed: int) -> None:
    arena = SCENARIOS["rubble"].build(50.0, seed=seed)
    assert arena.betti.components == 1
    assert arena.betti.holes > 3
    heaps = holes_of(arena)
    gaps = [one.distance(other) for number, one in enumerate(heaps) for other in heaps[:number]]
    assert min(gaps) > 1.5 - 1e-5


def test_round_arenas_are_regular() -> None:
    corners = shapely.get_coordinates(SCENARIOS["disc"].build(50.0).polygon)[:-1]
    assert len(corners) >= 64
    assert np.hypot(*(corners - 25).T) == pytest.approx(25, rel=1e-14)
    sides = np.hypot(*(corners - np.roll(corners, 1, axis=0)).T)
    assert sides == pytest.approx(sides.mean(), rel=1e-12)


def test_a_run_takes_the_rubble_of_its_own_seed() -> None:
    one, other = (choose_setting(WorldConfig(scenario="rubble", seed=seed)) for seed in (5, 6))
    assert one.arena.polygon.equals(SCENARIOS["rubble"].build(50.0, seed=5).polygon)
    assert not one.arena.polygon.equals(other.arena.polygon)


def test_an_arena_file_may_be_followed_by_others(tmp_path: Path) -> None:
    for number, size in enumerate((9, 8, 7)):
        shape = {"type": "Polygon", "coordinates": [[[0, 0], [size, 0], [size, size], [0, size], [0, 0]]]}
        (tmp_path / f"{number}.geojson").write_text(json.dumps(shape))
    later = (f"10:{tmp_path}/1.geojson", f"20.5:{tmp_path}/2.geojson")
    config = WorldConfig(arena=f"{tmp_path}/0.geojson", arena_scale=2.0, arena_then=later, seed=1, duration_s=60.0)
    setting = choose_setting(config)
    assert setting.arena.area == 18**2
    assert [(change.at_s, change.arena.area) for change in setting.arena_changes] == [(10, 16**2), (20.5, 14**2)]
    with pytest.raises(ValueError, match=r"arena_then has the times \[20.5, 10.0\]; wanted each later"):
        msgspec.structs.replace(config, arena_then=later[::-1])
    with pytest.raises(ParameterError, match=r"2.geojson \[s\] is 20.5; wanted less than the duration, 20"):
        choose_setting(msgspec.structs.replace(config, duration_s=20.0))


@pytest.mark.parametrize("preset", PRESETS)
def test_changes_come_at_their_share_of_the_time_of_exploration(preset: str) -> None:
    setting = choose_setting(WorldConfig(scenario="closing-door", preset=preset, seed=1, duration_s=60.0))
    (change,) = setting.arena_changes
    assert change.at_s == 30
    assert setting.describe_changes() == [{"at_s": 30.0, "betti_numbers_after": [2, 2], "file": "arena_1.geojson"}]
