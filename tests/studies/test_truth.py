"""The true diagram of a sample knows the components and holes of its arena, before and after a change."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.arenas.arena import Arena
from simulator.arenas.geodesics import geodesic_distances
from simulator.arenas.geojson import dump_arena
from simulator.arenas.scenarios import SCENARIOS
from studies.errors import RunDirectoryError
from studies.geodesics_check import named_arenas
from studies.truth import diagram_of, load_run, obstacle_points, true_distances

Floats = NDArray[np.float64]

ARENAS = dict(named_arenas(seed=0))
# In the maze and the rubble, holes are too many and too narrow for this few points.
SAMPLED = [name for name in ARENAS if name not in {"maze", "rubble"} and ARENAS[name].betti.holes]


def net(arena: Arena, *, drawn: int, kept: int) -> Floats:
    """Draw places and keep some far from each other: distances between those, shape (kept, kept)."""
    places = arena.draw_places(seed=2, ids=np.arange(1, drawn + 1, dtype=np.uint64))
    lengths = geodesic_distances(arena, places)
    picks, nearest = [0], np.minimum(lengths[0], 1e9)
    while len(picks) < kept:
        picks.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, lengths[picks[-1]])
    return lengths[np.ix_(picks, picks)]


@pytest.mark.parametrize("name", ARENAS)
def test_the_diagram_has_a_lasting_bar_for_every_component(name: str) -> None:
    arena = ARENAS[name]
    places = arena.draw_places(seed=1, ids=np.arange(1, 41, dtype=np.uint64))
    components, holes = diagram_of(geodesic_distances(arena, places))
    assert np.isinf(components[:, 1]).sum() == arena.betti.components
    assert np.isfinite(holes).all()
    assert len(components) == 40


@pytest.mark.parametrize("name", SAMPLED)
def test_the_diagram_has_a_long_bar_for_every_hole(name: str) -> None:
    arena = ARENAS[name]
    _, holes = diagram_of(net(arena, drawn=300, kept=110))
    lengths = holes[:, 1] - holes[:, 0]
    assert lengths[arena.betti.holes - 1] > 1.2 * lengths[arena.betti.holes]


@pytest.mark.parametrize("name", ARENAS)
def test_every_hole_has_a_point_in_its_obstacle(name: str) -> None:
    points = obstacle_points(ARENAS[name])
    assert len(points) == ARENAS[name].betti.holes
    assert not ARENAS[name].has_room(points).any()


# Two places in each room of the closing door, and one where its slab comes to stand.
PLACES = np.array([[5.0, 5.0], [20.0, 25.0], [30.0, 25.0], [45.0, 45.0], [24.95, 24.0]])


def write_run(directory: Path, **further: object) -> Path:
    directory.mkdir()
    scenario = SCENARIOS["closing-door"]
    rows = [f"{k}.0,{k}.5,{2 * k + 1},{2 * k + 2}" for k in range(len(PLACES))]
    (directory / "encounters.csv").write_text("\n".join(["t_start_s,t_end_s,id1,id2", *rows]) + "\n")
    (directory / "arena.geojson").write_text(dump_arena(scenario.build(50.0)))
    (directory / "arena_1.geojson").write_text(dump_arena(scenario.build_changes(50.0)[0][1]))
    changes = [{"at_s": 100.0, "betti_numbers_after": [2, 2], "file": "arena_1.geojson"}]
    run = {"unit_of_length": "unit", "parameters": {"speed": 1.0}, "arena_changes": changes, **further}
    (directory / "run.json").write_text(json.dumps(run))
    file = io.BytesIO()
    np.savez(file, encounter_position=PLACES, t_s=np.zeros(1), ids=np.ones(1, dtype=np.int64), position=np.zeros((1, 1, 2)))
    (directory / "truth.npz").write_bytes(file.getvalue())
    return directory


def test_a_door_that_closed_parts_the_truth(tmp_path: Path) -> None:
    truth = load_run(write_run(tmp_path / "run"))
    assert (truth.betti.components, truth.arena_at(99.9).betti.components, truth.arena_at(100.0).betti.components) == (1, 1, 2)
    rows = np.arange(5)
    before, after = true_distances(truth, rows), true_distances(truth, rows, at_s=150.0)
    assert before[1, 2] == 10
    assert np.isfinite(before).all()
    assert np.isinf(after[1, 2])
    assert after[0, 1] == before[0, 1]
    # What met in the doorway counts to the side of the slab that it was nearer to, 0.05 away.
    assert after[1, 4] == pytest.approx(np.hypot(4.9, 1.0))
    assert np.isinf(diagram_of(after)[0][:, 1]).sum() == 2
    assert np.isinf(diagram_of(before)[0][:, 1]).sum() == 1


def test_a_change_without_its_time_is_refused(tmp_path: Path) -> None:
    directory = write_run(tmp_path / "run", arena_changes=[{"file": "arena_1.geojson"}])
    with pytest.raises(RunDirectoryError, match="at_s of an arena change"):
        load_run(directory)
