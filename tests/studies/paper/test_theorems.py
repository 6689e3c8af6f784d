"""The bounds of [Dir16]: formulas by hand, and laws on real runs that the corrected ones keep and the published ones do not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import box

from mapper.pipeline import compute_map
from mapper.types import Method
from mapper.window import make_encounter_table
from simulator.arenas.arena import build_arena
from simulator.arenas.geodesics import geodesic_distances
from studies.paper import theorems
from studies.paper.bound_checks import hold_against_bounds
from studies.paper.carriers import carried_distances
from studies.paper.encounter_space import EncounterSpace, measure_space
from studies.paper.map_scores import recipe_of
from studies.paper.step_checks import check_steps, cover_space_time, measure_steps
from studies.paper.swarm_runs import Place, RunCase, SwarmRun, simulate_run

pytestmark = pytest.mark.xdist_group("paper")
"""What they share is made once, by one worker."""

SCENARIO = "one-obstacle"


@pytest.fixture(scope="module")
def run() -> SwarmRun:
    return simulate_run(RunCase(preset="paper-units", place=Place(scenario=SCENARIO), seed=7, time_share=0.5))


@pytest.fixture(scope="module")
def space(run: SwarmRun) -> EncounterSpace:
    return measure_space(run)


def walk_on_a_line() -> SwarmRun:
    """Make a run on the line y = 10: landmark 1 stands at x = 10; 2 walks from x = 0 to the right, 3 from x = 40 to the left, speed 1.

    2 meets the landmark at second 10, and 3 at second 20, at x = 20; 3 meets the landmark at second 30. r_d is 0, so meetings are points.
    """
    seconds, pairs = np.array([10, 20, 30]), [(1, 2), (2, 3), (1, 3)]
    ns = seconds * 1_000_000_000
    table = make_encounter_table(t_start_ns=ns, t_end_ns=ns, id1=[one for one, _ in pairs], id2=[other for _, other in pairs])
    return SwarmRun(
        arena=build_arena(box(0, 0, 50, 50)),
        speed=1.0,
        reach=0.0,
        start_s=0.0,
        duration_s=40.0,
        table=table,
        spells=(),
        positions=np.array([[10.0, 10.0], [20.0, 10.0], [10.0, 10.0]]),
        landmark_ids=np.array([1]),
        landmark_positions=np.array([[10.0, 10.0]]),
        mover_positions=np.zeros((0, 2)),
    )


def test_a_walk_on_a_line_meets_the_bounds_of_theorem_1_with_equality() -> None:
    """With r_d = 0 and straight walks, d_GE is max(d_M, |dt|), and the landmark's two meetings are at one place."""
    walk, events = walk_on_a_line(), np.arange(3)
    seconds = np.array([10.0, 20.0, 30.0])
    true = np.maximum(geodesic_distances(walk.arena, walk.positions), np.abs(seconds[:, None] - seconds))
    without_landmark = carried_distances(walk, events, events, handover=0.0, landmarks_stand=False)
    over_landmark = carried_distances(walk, np.append(events, -1), events, handover=0.0, landmarks_stand=True)
    np.testing.assert_allclose(without_landmark, true, atol=1e-7)
    np.testing.assert_allclose(over_landmark, [[0, 10, 0], [10, 0, 10], [0, 10, 0], [0, 10, 0]], atol=1e-7)


def test_every_handover_is_paid_for() -> None:
    """From the first meeting to the second one biobot walks all the way; the landmark's own path to the third has none, either."""
    walk, events = walk_on_a_line(), np.arange(3)
    found = carried_distances(walk, events, events, handover=1.0, landmarks_stand=True)
    np.testing.assert_allclose(found, [[0, 11, 1], [11, 0, 11], [1, 11, 0]], atol=1e-7)


def test_paths_from_biobot_to_biobot_are_the_mappers_metric(run: SwarmRun, space: EncounterSpace) -> None:
    places = np.concatenate([-1 - space.landmarks, space.encounters])
    found = carried_distances(run, places, space.encounters, handover=0.0, landmarks_stand=True)
    wanted = np.vstack([space.to_landmarks.T, space.between_encounters])
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_the_subsample_is_that_of_the_papers_method(run: SwarmRun, space: EncounterSpace) -> None:
    result = compute_map(run.table, run.spells, recipe_of(Method.PAPER, speed=run.speed))
    np.testing.assert_array_equal(result.points.encounter, space.encounters)
    np.testing.assert_allclose(result.components[0].distances, space.between_encounters, rtol=1e-12)


def test_no_pair_breaks_a_corrected_bound_and_some_break_the_published_ones(run: SwarmRun) -> None:
    steps = measure_steps(run, n_events=80)
    checked = check_steps(run, steps)
    assert checked.below_1_handovers == checked.above_1_corrected == 0
    assert checked.below_2_handovers == checked.above_2_corrected == 0
    assert checked.below_corollary_handovers == 0
    assert checked.below_2 > 0
    assert checked.below_corollary > 0
    assert checked.close_pairs_joined < 1
    assert checked.epsilon > 4 * checked.delta_e


def test_every_place_has_at_every_time_an_encounter_within_delta_e(run: SwarmRun) -> None:
    events = np.arange(0, len(run.table), 10)
    delta_e = cover_space_time(run, events)
    rng = np.random.default_rng(0)
    places = run.arena.draw_places(seed=1, ids=np.arange(1, 301, dtype=np.uint64))
    in_space = geodesic_distances(run.arena, places, run.positions[events])
    at = run.start_s + run.duration_s * rng.random(len(places))
    nearest = np.maximum(in_space, run.speed * np.abs(at[:, None] - run.centre_s[events])).min(axis=1)
    assert 0.5 * delta_e < nearest.max() <= delta_e


def test_stability_holds_for_the_error_as_measured_and_so_do_the_corrected_bounds(run: SwarmRun, space: EncounterSpace) -> None:
    held = hold_against_bounds(run, space, scenario=SCENARIO, n_points=80)
    for of in ("l", "e"):
        largest = max(getattr(held, f"bottleneck_{of}_0"), getattr(held, f"bottleneck_{of}_1"))
        assert 0 < largest <= getattr(held, f"stable_{of}")
    assert held.bottleneck_l_1 <= held.corrected_l
    assert held.corollary_by_landmarks == 0


def test_the_published_bounds_are_those_printed() -> None:
    assert theorems.lambda_3(tau=3.0, epsilon=2.0, delta_e=0.25) == pytest.approx(1.5 - 1 + 0.75)
    assert theorems.theorem_3_landmarks(inflation=0.5, delta_l=4.0) == 6.0
    assert theorems.theorem_3_encounters(inflation=0.5, delta_l=4.0, delta_e=2.0) == 15.0
    np.testing.assert_allclose(theorems.corollary_1(np.array([0.0, 1.0]), inflation=0.5, delta_l=4.0), [12.0, 13.5])


@given(tau=st.floats(0.1, 10), stretch=st.floats(1.001, 10), delta_e=st.floats(0.01, 1), length=st.floats(0, 100))
def test_the_corrected_theorem_1_covers_steps_of_which_the_last_is_short(tau: float, stretch: float, delta_e: float, length: float) -> None:
    """The proof needs one step of at most tau for each begun (epsilon - 2 delta_e) of the way."""
    epsilon = 4 * delta_e * stretch
    steps = max(1, np.ceil(length / (epsilon - 2 * delta_e)))
    inflation = theorems.lambda_3(tau=tau, epsilon=epsilon, delta_e=delta_e)
    bound = float(theorems.theorem_1(np.array([length]), inflation=inflation, tau=tau)[0])
    assert steps * tau <= bound * (1 + 1e-9)
