"""Laws of landmark selection."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import LandmarkCountError
from firmware_protocol.landmarks import MAX_STARTS, choose_landmarks, next_landmark, select_landmarks


def line(length: int) -> dict[int, set[int]]:
    """Node k hears k - 1 and k + 1."""
    return {k: {other for other in (k - 1, k + 1) if 1 <= other <= length} for k in range(1, length + 1)}


@st.composite
def graphs(draw: st.DrawFn) -> dict[int, set[int]]:
    ids = draw(st.lists(st.integers(min_value=1, max_value=2**63 - 1), unique=True, max_size=25))
    heard = st.sets(st.sampled_from(ids), max_size=4) if ids else st.just(set[int]())
    return {one: draw(heard) for one in ids}


def clusters_of(graph: dict[int, set[int]]) -> list[set[int]]:
    """Join clusters that a link connects until none is left: slow and obvious."""
    clusters = [{one} for one in graph]
    for one, heard in graph.items():
        for other in heard:
            joined = [cluster for cluster in clusters if one in cluster or other in cluster]
            clusters = [cluster for cluster in clusters if cluster not in joined] + [set().union(*joined)]
    return clusters


def hops_between(graph: dict[int, set[int]], start: int, end: int) -> float:
    reached, hops = {start}, 0
    while end not in reached:
        grown = reached | {b for a, heard in graph.items() for b in heard if a in reached} | {
            a for a, heard in graph.items() if heard & reached
        }  # fmt: skip
        if grown == reached:
            return float("inf")
        reached, hops = grown, hops + 1
    return hops


@given(graphs(), st.data())
def test_as_many_different_candidates_are_picked_as_were_asked_for(graph: dict[int, set[int]], data: st.DataObject) -> None:
    count = data.draw(st.integers(0, len(graph)))
    picks = select_landmarks(graph, count=count)
    assert len(picks) == len(set(picks)) == count
    assert set(picks) <= graph.keys()


@given(graphs(), st.data())
def test_each_cluster_gives_its_share_rounded_up_or_down(graph: dict[int, set[int]], data: st.DataObject) -> None:
    count = data.draw(st.integers(0, len(graph)))
    picks = set(select_landmarks(graph, count=count))
    for cluster in clusters_of(graph):
        assert abs(len(picks & cluster) - count * len(cluster) / len(graph)) < 1


@given(graphs(), st.data())
def test_every_pick_is_as_far_from_the_earlier_ones_as_any(graph: dict[int, set[int]], data: st.DataObject) -> None:
    picks = select_landmarks(graph, count=data.draw(st.integers(0, len(graph))))
    for cluster in clusters_of(graph):
        mine = [pick for pick in picks if pick in cluster]
        assert mine[:1] == [min(cluster)][: len(mine)]
        for number in range(1, len(mine)):
            distance = {one: min(hops_between(graph, one, earlier) for earlier in mine[:number]) for one in cluster}
            assert mine[number] == min(cluster, key=lambda one: (-distance[one], one))


@given(graphs(), st.data())
def test_order_of_reports_and_who_of_two_reports_change_nothing(graph: dict[int, set[int]], data: st.DataObject) -> None:
    count = data.draw(st.integers(0, len(graph)))
    turned: dict[int, set[int]] = {one: set() for one in data.draw(st.permutations(sorted(graph)))}
    for one, heard in graph.items():
        for other in heard:
            turned[other].add(one)
    assert select_landmarks(turned, count=count) == select_landmarks(graph, count=count)


def test_a_line_gives_its_ends_then_its_middle() -> None:
    assert select_landmarks(line(9), count=3) == (1, 9, 5)


def test_equal_remainders_go_to_the_larger_cluster_then_to_the_lowest_id() -> None:
    pairs = {1: {2}, 2: {1}, 3: {4}, 4: {3}}
    assert select_landmarks(pairs, count=1) == (1,)
    assert select_landmarks(pairs, count=3) == (1, 2, 3)


def test_those_who_are_no_candidates_are_left_aside() -> None:
    assert select_landmarks({5: {5, 99}, 7: {99}}, count=2) == (5, 7)


@pytest.mark.parametrize("count", [-1, 4])
def test_more_landmarks_than_candidates_are_refused(count: int) -> None:
    with pytest.raises(LandmarkCountError, match=f"{count} landmarks wanted from 3 candidates; ask for 0 to 3"):
        select_landmarks(line(3), count=count)


def literal_maxmin(distance: dict[tuple[int, int], float], able: list[int], *, first: int, count: int) -> list[int]:
    """METHOD 9 word by word: the next landmark is the one that is furthest from those there are; ties to the lowest id."""
    picks = [first]
    while len(picks) < count:
        left = [one for one in able if one not in picks]
        picks.append(min(left, key=lambda one: (-min(distance[one, pick] for pick in picks), one)))
    return picks


@given(graphs(), st.data())
def test_a_choice_is_the_literal_rule_from_the_first_pick_that_covers_best(graph: dict[int, set[int]], data: st.DataObject) -> None:
    eligible = data.draw(st.sets(st.sampled_from(sorted(graph)))) if graph else set[int]()
    count = data.draw(st.integers(0, len(eligible)))
    choices = choose_landmarks(graph, count=count, eligible=eligible)

    assert sum(len(one.picks) for one in choices) == count
    assert sorted(map(set, clusters_of(graph)), key=min) == [set(one.members) for one in choices]
    for one in choices:
        able = sorted(set(one.members) & eligible)
        assert set(one.picks) <= set(able)
        if eligible == graph.keys():
            assert abs(len(one.picks) - count * len(one.members) / len(graph)) < 1, "shares are in proportion"
        if not one.picks:
            continue
        distance = {(a, b): hops_between(graph, a, b) for a in one.members for b in able}

        def cover(
            picks: list[int], one: tuple[int, ...] = one.members, distance: dict[tuple[int, int], float] = distance
        ) -> tuple[float, float]:
            hops = [min(distance[member, pick] for pick in picks) for member in one]
            return max(hops), sum(hops)

        assert len(able) <= MAX_STARTS
        by_start = [literal_maxmin(distance, able, first=first, count=len(one.picks)) for first in able]
        best = min(map(cover, by_start))
        assert list(one.picks) == next(picks for picks in by_start if cover(picks) == best)
        assert one.radius == best[0]


def test_another_turn_takes_another_first_pick_that_covers_as_well() -> None:
    ring = {k: {(k + 1) % 12, (k - 1) % 12} for k in range(12)}
    turns = [choose_landmarks(ring, count=3, eligible=ring, turn=turn)[0] for turn in range(13)]
    assert len({one.picks[0] for one in turns}) == 12
    assert {one.radius for one in turns} == {3}
    assert turns[12] == turns[0]


def test_a_cluster_in_which_too_few_may_be_picked_leaves_its_share_to_the_others() -> None:
    two_lines = {k: {k - 1, k + 1} - {0, 6, 5, 11} | ({4} if k == 5 else set()) for k in range(1, 11)}
    chosen = choose_landmarks(two_lines, count=4, eligible={1, 6, 7, 8, 9, 10})
    assert [len(one.picks) for one in chosen] == [1, 3]


@given(graphs(), st.data())
def test_who_takes_a_lost_place_is_furthest_from_those_that_stand_in_the_cluster_that_has_fewest(
    graph: dict[int, set[int]], data: st.DataObject
) -> None:
    some = st.sets(st.sampled_from(sorted(graph))) if graph else st.just(set[int]())
    standing, eligible, near = data.draw(some), data.draw(some), data.draw(st.sampled_from([*sorted(graph), None]))
    found = next_landmark(graph, standing=standing, eligible=eligible, near=near)
    able = eligible - standing
    assert (found is None) == (not able)
    if found is None:
        return
    mine = next(cluster for cluster in clusters_of(graph) if found in cluster)

    def gap(one: int) -> float:
        return min((hops_between(graph, one, other) for other in standing & mine), default=float("inf"))

    rivals = able & mine
    furthest = {one for one in rivals if gap(one) == max(map(gap, rivals))}
    assert found in furthest
    to_lost = {one: hops_between(graph, one, near) if near in mine else 0.0 for one in furthest}
    assert found == min(furthest, key=lambda one: (to_lost[one], one))
