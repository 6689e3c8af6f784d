"""The contracted graph of chains against the literal definition, by compiled and by plain kernels."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.kernels import Kernels
from mapper.types import ModeSpell
from tests.mapper.graphs import KERNELS, all_times, components_of, joined_times
from tests.mapper.oracle import is_in_community, literal_distances
from tests.mapper.worlds import Row, encounter_rows, mode_spells, table_of

with_all_kernels = pytest.mark.parametrize("kernels", KERNELS, ids=lambda kernels: kernels.name)


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
    first = np.flatnonzero([not (wanted[i, :i] == 0).any() for i in range(len(rows))])
    centres = table.t_start_ns + table.t_end_ns
    stood = [
        any(is_in_community(int(biobot), int(centre), spells) for biobot in pair)
        for centre, pair in zip(centres, zip(table.id1, table.id2, strict=True), strict=True)
    ]
    landmarks = first[[bool((wanted[i] == 0)[stood].any()) for i in first]]
    for kernels in KERNELS:
        components = components_of(rows, spells, kernels, moving_time=moving_time)
        times, found_first, multiplicity = joined_times(components)
        # A vertex is all that lies at distance zero, named after its earliest encounter.
        assert np.array_equal(found_first, first)
        assert np.array_equal(times, wanted[np.ix_(first, first)])
        assert np.array_equal(multiplicity, (wanted[first] == 0).sum(axis=1))
        assert sorted(np.concatenate([part.first_encounter[part.landmarks] for part in components]).tolist()) == landmarks.tolist()
        assert components.has_landmarks == (len(landmarks) > 0)


@given(encounter_rows(), mode_spells)
def test_components_are_those_of_the_literal_definition_and_the_largest_comes_first(rows: list[Row], spells: list[ModeSpell]) -> None:
    table = table_of(rows)
    is_joined = np.isfinite(literal_distances(table, spells, moving_time=False))
    wanted = sorted({tuple(np.flatnonzero(row)) for row in is_joined}, key=lambda members: (-len(members), members[0]))
    for kernels in KERNELS:
        parts = components_of(rows, spells, kernels)
        assert [(part.n_encounters, part.first_encounter[0]) for part in parts] == [(len(members), members[0]) for members in wanted]
        assert parts.sizes == [len(members) for members in wanted]
        assert all(np.isfinite(all_times(part)).all() for part in parts)


@given(encounter_rows(max_size=30, n_biobots=8), mode_spells, st.booleans())
def test_compiled_and_plain_kernels_make_the_same_arrays(rows: list[Row], spells: list[ModeSpell], moving_time: bool) -> None:
    compiled, plain = (components_of(rows, spells, kernels, moving_time=moving_time) for kernels in KERNELS)
    for one, other in zip(compiled, plain, strict=True):
        for name in ("starts", "neighbours", "times"):
            assert np.array_equal(getattr(one.rows, name), getattr(other.rows, name))
        for name in ("first_encounter", "multiplicity", "landmarks"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
        # Two links into one vertex at one instant may come in either order.
        steps = [sorted(zip(part.links.targets, part.links.sources, part.links.times, strict=True)) for part in (one, other)]
        assert steps[0] == steps[1]


@with_all_kernels
def test_what_a_landmark_met_while_it_walked_is_not_at_its_place(kernels: Kernels) -> None:
    """Centres 0 and 4 s; the spell begins at 3 s: only the second is in the community, so 4 s lie between them."""
    (graph,) = components_of([(0, 0, 1, 2), (4, 4, 1, 3)], [_static(1, 3, None)], kernels, moving_time=False)
    assert graph.n_vertices == 2
    assert all_times(graph)[0].tolist() == [0, 8]
    assert graph.landmarks.tolist() == [1]


@with_all_kernels
def test_a_natural_stop_is_no_hub_in_elapsed_time_and_no_landmark_in_moving_time(kernels: Kernels) -> None:
    rows, spells = [(0, 0, 1, 2), (4, 4, 1, 3)], [_static(1, 0, 9, Cause.NATURAL)]
    (elapsed,) = components_of(rows, spells, kernels, moving_time=False)
    (moving,) = components_of(rows, spells, kernels, moving_time=True)
    assert (elapsed.n_vertices, moving.n_vertices) == (2, 1)
    assert len(moving.landmarks) == 0


@with_all_kernels
def test_two_stands_of_one_landmark_are_two_places(kernels: Kernels) -> None:
    rows = [(0, 0, 1, 2), (1, 1, 1, 3), (10, 10, 1, 2), (11, 11, 1, 3)]
    (graph,) = components_of(rows, [_static(1, 0, 2), _static(1, 9, None)], kernels, moving_time=False)
    assert graph.landmarks.tolist() == [0, 1]
    # From one stand to the other: 10 - 1 s by the landmark itself.
    assert all_times(graph)[0].tolist() == [0, 18]


@with_all_kernels
def test_an_edge_is_stored_once_each_way_even_where_two_biobots_share_it(kernels: Kernels) -> None:
    """Biobots 1 and 2 meet twice, so both their chains join the two: the weight is 10 half nanoseconds, not 20."""
    (graph,) = components_of([(0, 0, 1, 2), (5, 5, 1, 2)], [], kernels, moving_time=False)
    assert graph.rows.starts.tolist() == [0, 1, 2]
    assert graph.rows.neighbours.tolist() == [1, 0]
    assert graph.rows.times.tolist() == [10, 10]


@with_all_kernels
def test_wall_clock_instants_lose_no_nanosecond(kernels: Kernels) -> None:
    now = 1_790_000_000 * 10**9
    (graph,) = components_of([(now, now + 1, 1, 2), (now + 3, now + 3, 2, 3)], [], kernels, moving_time=False)
    assert all_times(graph)[0].tolist() == [0, 5]


@with_all_kernels
@pytest.mark.parametrize("start", [-(10**18), 10**18])
def test_spells_outside_the_record_change_nothing(start: int, kernels: Kernels) -> None:
    rows = [(0, 0, 1, 2), (4, 4, 1, 3)]
    (graph,) = components_of(rows, [_static(1, start, start + 10)], kernels, moving_time=True)
    assert graph.n_vertices == 2
    assert len(graph.landmarks) == 0


@with_all_kernels
def test_no_encounters_make_a_graph_without_components(kernels: Kernels) -> None:
    components = components_of([], [_static(1, 0, None)], kernels, moving_time=True)
    assert len(components) == 0
    assert components.sizes == []
