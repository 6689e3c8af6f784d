"""The study of outlines judges by the truth: each outline around one obstacle, and one around each."""

import numpy as np
import pytest

from mapper.persistence import rips_persistence
from simulator.arenas.arena import build_arena
from simulator.arenas.geodesics import geodesic_distances
from studies.arenas import ArenaFamily, draw_arena
from studies.outlines import _judge, close_birth_edge, main
from studies.samples import sample_arena

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def test_a_table_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--arenas", "1", "--points", "60"]) == 0
    out = capsys.readouterr().out
    assert [line.split("%")[0].split()[:2] for line in out.splitlines()[3:]] == [[n, "squares"] for n in ("2", "2", "3", "3", "4-6", "4-6")]


def test_each_obstacle_wants_an_outline_of_its_own() -> None:
    obstacles = np.array([[0.0, 0.0], [5.0, 0.0]])
    assert _judge([SQUARE, SQUARE + np.array([5.0, 0.0])], obstacles, seconds=1.0).is_right
    assert not _judge([SQUARE, SQUARE], obstacles, seconds=1.0).is_right
    assert not _judge([SQUARE, 9.0 * SQUARE], obstacles, seconds=1.0).is_right
    assert not _judge([SQUARE], obstacles, seconds=1.0).is_right
    assert not _judge([], obstacles, seconds=1.0).is_right


def test_the_plain_way_closes_the_birth_edge_by_older_ones() -> None:
    arena = build_arena(draw_arena(ArenaFamily.SQUARES, seed=1))
    _, distances = sample_arena(arena, geodesic_distances, n_points=60, seed=1)
    diagram = rips_persistence(distances)
    for row, (birth, _) in enumerate(diagram.intervals[1]):
        path = close_birth_edge(distances, diagram, row)
        assert sorted((path[0], path[-1])) == diagram.birth_edges[row].tolist()
        assert distances[path, np.roll(path, -1)].max() == birth
