"""Horizons hide nothing that can be seen, and most of what cannot."""

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.arenas.arena import Arena
from simulator.arenas.horizon import Bools, Floats, Indices, find_hidden
from simulator.arenas.scenarios import SCENARIOS
from tests.simulator.arenas import arenas


def is_covered(arena: Arena, points: Floats, targets: Floats, *, slack: float) -> Bools:
    roomy = arena.polygon.buffer(slack, join_style="mitre", mitre_limit=50.0)
    return np.asarray(shapely.covers(roomy, shapely.linestrings(np.stack([points, targets], axis=1))))


def hidden_among(arena: Arena, points: Floats) -> tuple[Bools, Indices, Indices]:
    i, j = np.triu_indices(len(points), 1)
    order = np.random.default_rng(1).permutation(i.size)
    i, j = i[order], j[order]
    return find_hidden(points, points, i=i, j=j, start=arena.wall_start, end=arena.wall_end), i, j


@settings(max_examples=30)
@given(arena=arenas(), seed=st.integers(0, 1000))
def test_nothing_in_sight_is_hidden(arena: Arena, seed: int) -> None:
    points = np.vstack([arena.draw_places(seed=seed, ids=np.arange(1, 21, dtype=np.uint64)), arena.wall_start])
    hidden, i, j = hidden_among(arena, points)
    assert not np.any(hidden & is_covered(arena, points[i], points[j], slack=1e-10))


def test_most_that_is_out_of_sight_in_rubble_is_hidden() -> None:
    arena = SCENARIOS["rubble"].build(50.0)
    points = arena.draw_places(seed=1, ids=np.arange(1, 101, dtype=np.uint64))
    hidden, i, j = hidden_among(arena, points)
    out_of_sight = ~is_covered(arena, points[i], points[j], slack=1e-10)
    assert not np.any(hidden & ~out_of_sight)
    assert hidden.sum() > 0.8 * out_of_sight.sum()
