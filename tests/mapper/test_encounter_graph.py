"""The contracted graph of chains against the literal definition."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.encounter_graph import build_encounter_graph, split_components
from mapper.metric import shortest_times
from mapper.types import ModeSpell
from tests.mapper.oracle import is_in_community, literal_distances
from tests.mapper.worlds import Row, encounter_rows, mode_spells, table_of


def _static(node: int, start: int, end: int | None, cause: Cause = Cause.COMMAND) -> ModeSpell:
    return ModeSpell(node=NodeId(node), t_start_ns=start, t_end_ns=end, mode=Mode.S, cause=cause)


@given(encounter_rows(), mode_spells, st.booleans())
@example([(0, 0, 1, 2), (2, 2, 1, 3), (6, 6, 1, 4), (9, 9, 1, 2)], [_static(1, 4, None)], False).via("a landmark that walked before")
@example([(0, 0, 1, 2), (2, 2, 1, 3), (3, 3, 2, 4), (5, 5, 3, 4)], [_static(1, 0, 9), _static(2, 0, 9)], False).via("landmarks that meet")
@example([(0, 0, 1, 2), (4, 4, 1, 3), (8, 8, 1, 4)], [_static(1, 3, 8, Cause.NATURAL)], True).via("a natural stop")
@example([(0, 0, 1, 2), (3, 3, 1, 3), (5, 5, 1, 4)], [_static(1, 0, 3), _static(1, 3, 6)], False).via("spells that touch")
@example([(0, 4, 1, 2), (2, 2, 1, 3), (1, 3, 3, 2)], [], False).via("equal centres")
def test_chains_and_contraction_give_the_shortest_paths_of_the_literal_definition(
    rows: list[Row], spells: list[ModeSpell], moving_time: bool
) -> None:
    table = table_of(rows)
    wanted = literal_distances(table, spells, moving_time=moving_time)
    graph = build_encounter_graph(table, spells, moving_time=moving_time)
    first = graph.first_encounter
    assert np.array_equal(shortest_times(graph, list(range(graph.n_vertices))), wanted[np.ix_(first, first)])
    # A vertex is all that lies at distance zero, named after its earliest encounter.
    assert np.array_equal(graph.multiplicity, (wanted[first] == 0).sum(axis=1))
    assert np.array_equal(first, np.flatnonzero([not (wanted[i, :i] == 0).any() for i in range(len(rows))]))
    centres = table.t_start_ns + table.t_end_ns
    stood = [
        any(is_in_community(int(biobot), int(centre), spells) for biobot in pair)
        for centre, pair in zip(centres, zip(table.id1, table.id2, strict=True), strict=True)
    ]
    assert np.array_equal(graph.landmarks, np.flatnonzero([(wanted[i] == 0)[stood].any() for i in first]))


@given(encounter_rows(), mode_spells)
def test_components_are_those_of_the_literal_definition_and_the_largest_comes_first(rows: list[Row], spells: list[ModeSpell]) -> None:
    table = table_of(rows)
    is_joined = np.isfinite(literal_distances(table, spells, moving_time=False))
    parts = split_components(build_encounter_graph(table, spells, moving_time=False))
    wanted = sorted({tuple(np.flatnonzero(row)) for row in is_joined}, key=lambda members: (-len(members), members[0]))
    assert [(part.n_encounters, part.first_encounter[0]) for part in parts] == [(len(members), members[0]) for members in wanted]
    assert all(np.isfinite(shortest_times(part, [0])).all() for part in parts)


def test_what_a_landmark_met_while_it_walked_is_not_at_its_place() -> None:
    """Centres 0 and 4 s; the spell begins at 3 s: only the second is in the community, so 4 s lie between them."""
    graph = build_encounter_graph(table_of([(0, 0, 1, 2), (4, 4, 1, 3)]), [_static(1, 3, None)], moving_time=False)
    assert graph.n_vertices == 2
    assert shortest_times(graph, [0])[0].tolist() == [0, 8]
    assert graph.landmarks.tolist() == [1]


def test_a_natural_stop_is_no_hub_in_elapsed_time_and_no_landmark_in_moving_time() -> None:
    rows, spells = [(0, 0, 1, 2), (4, 4, 1, 3)], [_static(1, 0, 9, Cause.NATURAL)]
    elapsed = build_encounter_graph(table_of(rows), spells, moving_time=False)
    moving = build_encounter_graph(table_of(rows), spells, moving_time=True)
    assert (elapsed.n_vertices, moving.n_vertices) == (2, 1)
    assert len(moving.landmarks) == 0


def test_two_stands_of_one_landmark_are_two_places() -> None:
    rows = [(0, 0, 1, 2), (1, 1, 1, 3), (10, 10, 1, 2), (11, 11, 1, 3)]
    graph = build_encounter_graph(table_of(rows), [_static(1, 0, 2), _static(1, 9, None)], moving_time=False)
    assert graph.landmarks.tolist() == [0, 1]
    # From one stand to the other: 10 - 1 s by the landmark itself.
    assert shortest_times(graph, [0])[0].tolist() == [0, 18]


def test_an_edge_is_stored_once_each_way_even_where_two_biobots_share_it() -> None:
    """Biobots 1 and 2 meet twice, so both their chains join the two: the weight is 10 half nanoseconds, not 20."""
    graph = build_encounter_graph(table_of([(0, 0, 1, 2), (5, 5, 1, 2)]), [], moving_time=False)
    assert graph.weights.toarray().tolist() == [[0, 10], [10, 0]]


def test_wall_clock_instants_lose_no_nanosecond() -> None:
    now = 1_790_000_000 * 10**9
    graph = build_encounter_graph(table_of([(now, now + 1, 1, 2), (now + 3, now + 3, 2, 3)]), [], moving_time=False)
    assert shortest_times(graph, [0])[0].tolist() == [0, 5]


@pytest.mark.parametrize("start", [-(10**18), 10**18])
def test_spells_outside_the_record_change_nothing(start: int) -> None:
    rows = [(0, 0, 1, 2), (4, 4, 1, 3)]
    graph = build_encounter_graph(table_of(rows), [_static(1, start, start + 10)], moving_time=True)
    assert graph.n_vertices == 2
    assert len(graph.landmarks) == 0


def test_no_encounters_make_a_graph_without_components() -> None:
    assert split_components(build_encounter_graph(table_of([]), [_static(1, 0, None)], moving_time=True)) == ()
