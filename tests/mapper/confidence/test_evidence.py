"""What is seen of a map does not depend on units, clocks and names, and a loop is found again where it is."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.units import NodeId
from mapper.confidence.assess import cut_time
from mapper.confidence.evidence import LOOP_FEATURES, POINT_FEATURES, RUN_FEATURES, find_near, match_loops
from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import compute_evidence
from mapper.types import FloatArray, ModeSpell
from tests.mapper.worlds import Row, encounter_rows, table_of, walk_track

_RECIPE = make_recipe(RecipeConfig(n_points=60))
ROWS, SPELLS = walk_track(n_landmarks=12, n_walkers=12, duration_s=60, seed=4, is_ring=True)


def _columns(rows: list[Row], spells: tuple[ModeSpell, ...]) -> dict[str, FloatArray]:
    _, (evidence,) = compute_evidence(table_of(rows), spells, _RECIPE)
    return evidence.loop_columns() | evidence.point_columns()


def _moved(*, factor: int, shift: int) -> tuple[list[Row], tuple[ModeSpell, ...]]:
    rows = [(factor * start + shift, factor * end + shift, first, second) for start, end, first, second in ROWS]
    spells = tuple(
        ModeSpell(node=one.node, t_start_ns=factor * one.t_start_ns + shift, t_end_ns=None, mode=one.mode, cause=one.cause)
        for one in SPELLS
    )
    return rows, spells


@pytest.mark.parametrize(("factor", "shift"), [(1, 10**15), (8, 0)])
def test_neither_the_unit_nor_the_zero_of_time_matters(factor: int, shift: int) -> None:
    expected, found = _columns(ROWS, SPELLS), _columns(*_moved(factor=factor, shift=shift))
    assert set(found) == {*LOOP_FEATURES, *RUN_FEATURES, *POINT_FEATURES}
    for name, column in expected.items():
        assert found[name] == pytest.approx(column, rel=1e-9, abs=1e-9), name


def test_names_do_not_matter() -> None:
    rows = [(start, end, 5000 - first, 9000 + second) for start, end, first, second in ROWS]
    spells = tuple(
        ModeSpell(node=NodeId(9000 + one.node), t_start_ns=one.t_start_ns, t_end_ns=None, mode=one.mode, cause=one.cause) for one in SPELLS
    )
    found = _columns(rows, spells)
    for name, column in _columns(ROWS, SPELLS).items():
        assert found[name] == pytest.approx(column, rel=1e-9, abs=1e-9), name


def test_a_map_finds_its_loops_in_itself() -> None:
    _, (evidence,) = compute_evidence(table_of(ROWS), SPELLS, _RECIPE)
    loops, n = evidence.part.intervals[1], evidence.n_judged
    lengths = np.diff(loops, axis=1)[:n, 0]
    assert match_loops(loops[:n], loops) == pytest.approx(lengths)
    assert (find_near(evidence.sighting, evidence.sighting, n=n) * evidence.part.diameter >= lengths * (1.0 - 1e-9)).all()


@given(
    st.lists(st.tuples(st.floats(0.1, 2.0), st.floats(0.1, 2.0)), max_size=3),
    st.lists(st.tuples(st.floats(0.1, 2.0), st.floats(0.1, 2.0)), max_size=3),
)
def test_loops_are_matched_with_the_least_sum_of_moves(one: list[tuple[float, float]], other: list[tuple[float, float]]) -> None:
    """Against all ways to pair them: partners keep their lengths, so the sum over loops of what was found tells the pairs."""
    loops, others = (np.array([(birth, birth + length) for birth, length in few]).reshape(-1, 2) for few in (one, other))
    n, m = len(loops), len(others)
    ways = []
    for chosen in set(permutations([*range(m), *[None] * n], n)):
        paired = [(row, column) for row, column in enumerate(chosen) if column is not None]
        cost = sum(float(np.abs(loops[row] - others[column]).max()) for row, column in paired)
        cost += sum(float(np.diff(loops[row])[0]) / 2 for row in range(n) if chosen[row] is None)
        cost += sum(float(np.diff(others[column])[0]) / 2 for column in range(m) if column not in chosen)
        ways.append((cost, [float(np.diff(others[column])[0]) if column is not None else 0.0 for column in chosen]))
    least = min(cost for cost, _ in ways)
    found = match_loops(loops, others).tolist()
    assert any(cost == pytest.approx(least, abs=1e-9) and found == pytest.approx(lengths) for cost, lengths in ways)


@given(encounter_rows(max_size=30), st.integers(1, 6))
def test_each_replica_lacks_one_block_of_the_time_and_no_two_lack_the_same(rows: list[Row], replicates: int) -> None:
    table = table_of(rows)
    parts = cut_time(table, replicates=replicates)
    assert len(parts) == replicates
    kept = np.array([np.isin(table.source_row, part.source_row) for part in parts])
    if replicates > 1:
        assert (kept.sum(axis=0) == replicates - 1).all()
    for lacking in ~kept:
        places = np.flatnonzero(lacking)
        assert len(places) == 0 or np.ptp(places) == len(places) - 1
        assert len(places) <= len(table) // max(2, replicates) + 1
