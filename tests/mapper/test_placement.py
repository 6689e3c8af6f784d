"""Places in the plane: what fits stays, what is exact comes out exact, and neither names nor kernels matter."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.config import RecipeConfig, make_recipe
from mapper.embedding import turn_to_axes
from mapper.kernels import Kernels, Links, Tension
from mapper.metric import ProfileMetric
from mapper.pipeline import compute_map
from mapper.placement import place_in_plane, placed_profiles
from mapper.subsampling import stand_for, subsample_maxmin
from mapper.types import TICKS_PER_S, FloatArray, IntArray, ModeSpell, ProfileNorm
from tests.mapper.graphs import KERNELS, largest_of
from tests.mapper.worlds import NS, Row, table_of

_TENSION = Tension(blur=0.1, drift=0.1, swerve=0.3)
_WALKERS = 12


def _chain_links(tracks: list[list[int]], times: list[list[float]]) -> Links:
    """Links of tracks over numbered places, track after track."""
    sources: list[int] = []
    targets: list[int] = []
    before: list[int] = []
    durations: list[float] = []
    for track, walked in zip(tracks, times, strict=True):
        for step, (source, target) in enumerate(pairwise(track)):
            before.append(len(sources) - 1 if step else -1)
            sources.append(source)
            targets.append(target)
            durations.append(walked[step])
    return Links(
        sources=np.array(sources, dtype=np.int32),
        targets=np.array(targets, dtype=np.int32),
        times=np.array(durations, dtype=np.float64),
        before=np.array(before, dtype=np.int32),
    )


@st.composite
def tracks_over_places(draw: st.DrawFn) -> tuple[Links, FloatArray, FloatArray]:
    """Any links between any places, with the places' start and pulls."""
    n = draw(st.integers(1, 9))
    lengths = st.floats(0.01, 10.0)
    tracks = draw(st.lists(st.lists(st.integers(0, n - 1), min_size=2, max_size=7), max_size=5))
    times = [draw(st.lists(lengths, min_size=len(track), max_size=len(track))) for track in tracks]
    coordinate = st.floats(-5.0, 5.0)
    start = draw(st.lists(st.tuples(coordinate, coordinate), min_size=n, max_size=n))
    pull = draw(st.lists(st.floats(0.01, 10.0), min_size=n, max_size=n))
    return _chain_links(tracks, times), np.array(start).reshape(n, 2), np.array(pull)


@settings(max_examples=60)
@given(tracks_over_places(), st.integers(0, 3), st.integers(0, 5))
def test_every_kind_of_kernels_settles_tracks_to_the_same_bits(net: tuple[Links, FloatArray, FloatArray], rounds: int, steps: int) -> None:
    links, start, pull = net
    one, other = (kernels.settle_tracks(links, start, pull, tension=_TENSION, rounds=rounds, steps=steps) for kernels in KERNELS)
    assert np.array_equal(one, other)
    assert np.isfinite(one).all()


@pytest.mark.parametrize("kernels", KERNELS, ids=lambda kernels: kernels.name)
def test_places_that_fit_their_straight_tracks_stay_where_they_are(kernels: Kernels) -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(0.0, 10.0, (40, 2))
    angles = rng.uniform(0.0, 2.0 * np.pi, 8)
    lines, tracks = [places], []
    for number, angle in enumerate(angles):  # eight straight tracks of ten places each, which none of the others is on
        along = np.cumsum(rng.uniform(0.3, 1.5, 10))
        lines.append(5.0 + along[:, None] * np.array([np.cos(angle), np.sin(angle)]))
        tracks.append(list(range(40 + 10 * number, 50 + 10 * number)))
    start = np.concatenate(lines)
    times = [np.hypot(*np.diff(start[track], axis=0).T).tolist() for track in tracks]
    settled = kernels.settle_tracks(_chain_links(tracks, times), start, np.ones(len(start)), tension=_TENSION, rounds=5, steps=8)
    assert np.abs(settled - start).max() < 1e-6


def test_exact_lengths_bring_places_back_that_start_wrong() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform(0.0, 10.0, (60, 2))
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    pairs = [(i, j) for i in range(60) for j in range(i) if apart[i, j] < 3.0]
    links = _chain_links([[i, j] for i, j in pairs], [[apart[i, j]] for i, j in pairs])
    start = places + rng.normal(0.0, 0.5, places.shape)
    settled = KERNELS[0].settle_tracks(links, start, np.full(60, 1e-3), tension=_TENSION, rounds=30, steps=20)
    assert _misfit(settled, places) < _misfit(start, places) / 4


def _walk_between_places(names: IntArray) -> tuple[list[Row], tuple[ModeSpell, ...], FloatArray]:
    """Let walkers go straight from place to place at speed 1; at six of 40 a landmark stands, at the others each meets a biobot of its own.

    ``names`` are the ids of the walkers. Returns rows, spells, and where each row's encounter was [s].
    """
    rng = np.random.default_rng(3)
    places = rng.uniform(0.0, 20.0, (40, 2))
    rows, where, stranger = [], [], 10_000
    for name in names.tolist():
        at, time = places[int(rng.integers(40))], 1.0 + float(rng.uniform(0.0, 1.0))
        for place in rng.integers(0, 40, 30).tolist():
            time += float(np.hypot(*(places[place] - at)))
            at = places[place]
            stranger += 1
            rows.append((round(time * NS) - NS // 1000, round(time * NS) + NS // 1000, name, 5000 + place if place < 6 else stranger))
            where.append(at)
    spells = tuple(ModeSpell(node=NodeId(5000 + k), t_start_ns=0, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for k in range(6))
    return rows, spells, np.array(where)


def test_exact_distances_to_landmarks_give_the_exact_picture() -> None:
    rows, spells, where = _walk_between_places(np.arange(1, _WALKERS + 1))
    graph = largest_of(rows, spells, KERNELS[0])
    order = sorted(range(len(rows)), key=lambda row: (rows[row][0], rows[row][1], min(rows[row][2:]), max(rows[row][2:])))
    places = where[order][graph.first_encounter]
    middle = np.hypot(*(places[:, None] - places[graph.landmarks][None]).transpose(2, 0, 1)) * TICKS_PER_S
    placement = place_in_plane(graph, graph.landmarks, middle=middle, doubt=np.zeros(len(places)), contact=0.5 * TICKS_PER_S)
    assert placement.is_placed.all()
    assert _misfit(placement.xy / TICKS_PER_S, places) < 0.3  # 1.5 % of the side: a turn at every place is let go of, but not quite
    metric = ProfileMetric(
        graph=graph,
        profiles=placed_profiles(graph, placement, placement.is_placed, graph.landmarks, middle=middle, n_neighbours=1),
        norm=ProfileNorm.MAX,
    )
    sample = subsample_maxmin(metric, placement.is_placed, n_points=30)
    true = np.hypot(*(places[sample.vertices][:, None] - places[sample.vertices][None]).transpose(2, 0, 1))
    assert np.abs(sample.distances / TICKS_PER_S - true).max() < 0.05 * true.max()


def test_every_landmark_has_distances_to_every_point_though_few_encounters_may_become_points() -> None:
    """What merges maps and finds routes asks for them, and JSON knows no nan."""
    rows, spells, _ = _walk_between_places(np.arange(1, _WALKERS + 1))
    recipe = dataclasses.replace(make_recipe(RecipeConfig()), max_candidates=len(rows) // 4)
    (part,) = compute_map(table_of(rows), spells, recipe).components
    assert part.places is not None
    assert set(part.places.node.tolist()) == {5000, 5001, 5002, 5003, 5004, 5005}
    assert np.isfinite(part.places.to_points).all()
    assert np.isfinite(part.places.between).all()


def test_names_of_walkers_do_not_move_a_place() -> None:
    found = []
    for names in (np.arange(1, _WALKERS + 1), np.arange(_WALKERS, 0, -1), np.arange(90_000, 90_000 + _WALKERS)):
        rows, spells, _ = _walk_between_places(names)
        graph = largest_of(rows, spells, KERNELS[0])
        rng = np.random.default_rng(4)
        middle = rng.uniform(1.0, 10.0, (graph.n_vertices, len(graph.landmarks))) * TICKS_PER_S
        doubt = rng.uniform(0.0, 3.0, graph.n_vertices) * TICKS_PER_S
        found.append(place_in_plane(graph, graph.landmarks, middle=middle, doubt=doubt, contact=1e8).xy)
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_who_stands_for_a_pick_is_near_it_known_better_and_stands_for_no_other(seed: int, n_points: int) -> None:
    rows, spells, _ = _walk_between_places(np.arange(1, 3))
    graph = largest_of(rows, spells, KERNELS[0])
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 10.0, (graph.n_vertices, 2))
    doubt, candidates = rng.integers(0, 5, graph.n_vertices).astype(np.float64), rng.random(graph.n_vertices) < 0.8
    candidates[0] = True
    metric = ProfileMetric(graph=graph, profiles=xy, norm=ProfileNorm.MAX)
    sample = subsample_maxmin(metric, candidates, n_points=n_points)
    chosen = stand_for(sample, metric, candidates, doubt=doubt, xy=xy)
    assert len(set(chosen.tolist())) == len(chosen)
    assert candidates[chosen].all()
    assert (doubt[chosen] <= doubt[sample.vertices]).all()
    moved = np.abs(xy[chosen] - xy[sample.vertices]).max(axis=1)
    others = np.where(np.eye(len(chosen), dtype=bool), np.inf, sample.distances).min(axis=1)
    assert (moved <= others).all()
    # Whoever is nearer than the next pick in the plane, free and known better, would have been taken by the first to choose.
    straight = np.hypot(*(xy - xy[sample.vertices[0]]).T)
    reach = min(others[0], 1.5 * float(np.median(others)))
    around = candidates & (straight < reach) & ~np.isin(np.arange(len(xy)), sample.vertices)
    assert doubt[chosen[0]] <= doubt[around].min(initial=np.inf)


def test_more_than_forty_thousand_places_are_placed_in_spells_of_time_with_all_landmarks() -> None:
    rng = np.random.default_rng(5)
    n = 44_000
    begin = np.sort(rng.integers(0, 10**13, n))
    one = rng.integers(1, 41, n)
    walkers = np.column_stack([one, (one + rng.integers(0, 39, n)) % 40 + 1])  # never itself
    is_landmark = rng.random(n) < 0.02
    walkers[is_landmark, 1] = rng.integers(1001, 1006, is_landmark.sum())
    rows: list[Row] = [(t, t + 1000, one, other) for t, (one, other) in zip(begin.tolist(), walkers.tolist(), strict=True)]
    spells = tuple(ModeSpell(node=NodeId(1001 + k), t_start_ns=0, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for k in range(5))
    graph = largest_of(rows, spells, KERNELS[0])
    middle = rng.uniform(1.0, 2.0, (graph.n_vertices, 5)) * TICKS_PER_S
    placement = place_in_plane(graph, graph.landmarks, middle=middle, doubt=np.ones(graph.n_vertices), contact=1e6)
    assert 39_990 <= placement.is_placed.sum() <= 40_005
    assert placement.is_placed[graph.landmarks].all()
    assert placement.is_placed[[0, -1]].all()
    assert np.isfinite(placement.xy[placement.is_placed]).all()
    assert np.isnan(placement.xy[~placement.is_placed]).all()


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 6.3), st.booleans())
def test_a_picture_turned_moved_or_mirrored_comes_to_the_same_axes(seed: int, angle: float, is_mirrored: bool) -> None:
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(20, 2)) * np.array([5.0, 1.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ np.diag([1.0, -1.0 if is_mirrored else 1.0])
    one, other = turn_to_axes(places), turn_to_axes(places @ turn + rng.normal(size=2))
    assert np.abs(np.abs(one) - np.abs(other)).max() < 1e-9
    assert np.ptp(one[:, 0]) > np.ptp(one[:, 1])


def _misfit(found: FloatArray, places: FloatArray) -> float:
    """Root mean square distance after the best shift, turn and mirroring."""
    one, other = found - found.mean(axis=0), places - places.mean(axis=0)
    left, _, right = np.linalg.svd(one.T @ other)
    return float(np.sqrt(((one @ (left @ right) - other) ** 2).sum(axis=1).mean()))
