"""What is foretold of a plan: the gas, the walk, and the laws about what a map shows."""

from dataclasses import replace
from math import isclose, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.feasibility import (
    chance_connected,
    chance_landmarks_met,
    encounter_rate,
    encounters_per_mover,
    expected_encounters,
    landmark_cover_radius,
    mixing_s,
    path_inflation,
    time_until,
    together_at_once,
    visits_per_landmark,
    wall_share,
)
from mapper.forecast import compare_recording, forecast
from mapper.plan import Plan, make_plan
from mapper.resolution import (
    chance_found,
    chance_of_false_hole,
    count_deviation,
    even_side,
    load_law,
    outside_ranges,
    quantities,
    side_found,
    time_to_find,
)

LAW = load_law()


def square(*, side: float, biobots: int, landmarks: int, speed: float, mean_leg: float, detection_radius: float, duration_s: float) -> Plan:
    return make_plan(
        side=side,
        area=None,
        perimeter=None,
        biobots=biobots,
        landmarks=landmarks,
        speed=speed,
        mean_leg=mean_leg,
        detection_radius=detection_radius,
        duration_s=duration_s,
    )


SWARM = {"biobots": 150, "landmarks": 20, "duration_s": 200.0}
PRINTED = square(side=50.0, speed=0.1, mean_leg=0.3, detection_radius=0.01, **SWARM)  # type: ignore[arg-type]  # one dict, two types
UNITS = square(side=50.0, speed=1.0, mean_leg=10.0, detection_radius=1.0, **SWARM)  # type: ignore[arg-type]  # same
HALF_METRE = square(side=0.5, speed=0.1, mean_leg=0.3, detection_radius=0.01, **SWARM)  # type: ignore[arg-type]  # same
HISSERS = square(side=5.0, biobots=40, landmarks=10, speed=0.04, mean_leg=0.5, detection_radius=0.25, duration_s=1800.0)


@st.composite
def plans(draw: st.DrawFn) -> Plan:
    biobots = draw(st.integers(2, 2000))
    side = draw(st.floats(0.1, 1000.0))
    return square(
        side=side,
        biobots=biobots,
        landmarks=draw(st.integers(0, biobots - 1)),
        speed=draw(st.floats(1e-3, 10.0)),
        mean_leg=side * draw(st.floats(1e-3, 10.0)),
        detection_radius=side * draw(st.floats(1e-4, 0.5)),
        duration_s=draw(st.floats(1.0, 1e6)),
    )


def test_the_printed_units_give_about_two_encounters() -> None:
    assert expected_encounters(PRINTED) == pytest.approx(2.1, abs=0.1)
    foretold = forecast(PRINTED, LAW)
    assert foretold.warnings[0].startswith("hopeless: about 2.1 encounters")
    assert not foretold.changes


def test_both_readings_of_the_units_give_what_their_runs_gave() -> None:
    assert expected_encounters(UNITS) == pytest.approx(2100, rel=0.1)
    assert expected_encounters(HALF_METRE) == pytest.approx(20_000, rel=0.05)


@pytest.mark.parametrize(("share", "lost"), [(1 / 50, 0.025), (1 / 10, 0.124)])
def test_a_square_cuts_the_discs_at_its_walls(share: float, lost: float) -> None:
    plan = replace(UNITS, detection_radius=share * UNITS.side)
    assert 1.0 - wall_share(plan) == pytest.approx(lost, abs=0.001)


@pytest.mark.parametrize(("width", "height", "radius"), [(1.0, 1.0, 0.1), (1.0, 1.0, 0.5), (3.0, 1.0, 0.4)])
def test_the_walls_share_is_that_of_circles_drawn_in_a_rectangle(width: float, height: float, radius: float) -> None:
    """The slow way: directions times places on a grid, and radii for the disc."""
    angle = (np.arange(720) + 0.5) * (2 * pi / 720)

    def inside(distance: float) -> float:
        # A place and the point that far from it in one direction are both inside: a rectangle cut by as much on each axis.
        overlap = (width - np.abs(distance * np.cos(angle))) * (height - np.abs(distance * np.sin(angle)))
        return float(overlap.mean()) / (width * height)

    plan = replace(UNITS, area=width * height, perimeter=2 * (width + height), detection_radius=radius)
    assert wall_share(plan) == pytest.approx(inside(radius), rel=1e-4)
    radii = (np.arange(400) + 0.5) * radius / 400
    disc = sum(2 * pi * one * inside(float(one)) for one in radii) * radius / 400
    pairs = plan.movers * (plan.movers - 1) / 2 + plan.movers * plan.landmarks
    assert together_at_once(plan) == pytest.approx(pairs * disc / plan.area, rel=1e-4)


@given(plans())
def test_every_encounter_is_one_of_each_of_its_two_biobots(plan: Plan) -> None:
    of_movers, of_landmarks = plan.movers * encounters_per_mover(plan), plan.landmarks * visits_per_landmark(plan)
    assert of_movers + of_landmarks == pytest.approx(2.0 * encounter_rate(plan) * plan.duration_s)


def test_the_inflation_is_that_of_walks_drawn_at_random() -> None:
    """Four thousand walks of three mean legs each: the mean square is known to about 2 %."""
    rng = np.random.default_rng(1)
    plan = next(replace(HISSERS, mean_leg=one) for one in [HISSERS.path / encounters_per_mover(HISSERS) / 3.0])
    ends = []
    for _ in range(4000):
        place, left = np.zeros(2), 3.0
        while left > 0:
            leg, angle = min(left, rng.exponential()), rng.uniform(0, 2 * pi)
            place = place + leg * np.array([np.cos(angle), np.sin(angle)])
            left -= leg
        ends.append(place @ place)
    assert path_inflation(plan) == pytest.approx(3.0 / np.sqrt(np.mean(ends)), rel=0.03)


def test_a_straight_walk_is_not_inflated_and_a_crooked_one_is() -> None:
    legs = [path_inflation(replace(HISSERS, mean_leg=leg)) for leg in (1e7, 1e4, 1e3, 1.0, 0.1)]
    assert legs == sorted(legs)
    assert legs[0] == pytest.approx(1.0, abs=1e-6)
    assert legs[1] == pytest.approx(1.0 + encounters_free_path() / 1e4 / 6.0, rel=1e-6)


def encounters_free_path() -> float:
    return HISSERS.path / encounters_per_mover(HISSERS)


def test_the_landmarks_met_are_counted_as_by_drawing_them() -> None:
    rng = np.random.default_rng(2)
    plan = replace(HISSERS, duration_s=200.0)
    counts = rng.poisson(visits_per_landmark(plan) / plan.movers, (4000, plan.landmarks, plan.movers))
    drawn = ((counts > 0).sum(axis=2) >= 3).all(axis=1).mean()
    assert chance_landmarks_met(plan, by=3) == pytest.approx(drawn, abs=0.03)
    assert chance_landmarks_met(plan, by=plan.movers + 1) == 0.0


def test_no_discs_cover_better_than_the_hexagonal_lattice() -> None:
    # The discs of a hexagonal lattice cover every place 2 pi / (3 sqrt 3) = 1.2092 times on average.
    assert landmark_cover_radius(HISSERS) ** 2 * pi * HISSERS.landmarks / HISSERS.area == pytest.approx(1.2092, abs=1e-4)


@given(plans())
def test_more_biobots_are_never_fewer_encounters_nor_a_coarser_map(plan: Plan) -> None:
    more = replace(plan, biobots=plan.biobots + 1)
    assert expected_encounters(more) >= expected_encounters(plan)
    assert even_side(more, LAW) <= even_side(plan, LAW) * (1 + 1e-12)


@given(plans(), st.floats(1.0, 100.0))
def test_more_time_is_never_fewer_encounters_nor_a_coarser_map(plan: Plan, factor: float) -> None:
    later = replace(plan, duration_s=factor * plan.duration_s)
    assert expected_encounters(later) >= expected_encounters(plan)
    assert even_side(later, LAW) <= even_side(plan, LAW) * (1 + 1e-12)
    assert chance_connected(later) >= chance_connected(plan) - 1e-12


@given(plans())
def test_nothing_finer_than_the_detection_radius_is_claimed(plan: Plan) -> None:
    assert even_side(plan, LAW) >= plan.detection_radius
    assert side_found(plan, LAW, chance=0.8) >= even_side(plan, LAW)


@given(plans(), st.floats(1e-3, 1e3))
def test_another_unit_of_length_changes_no_answer(plan: Plan, factor: float) -> None:
    scaled = replace(
        plan,
        area=plan.area * factor**2,
        perimeter=plan.perimeter * factor,
        speed=plan.speed * factor,
        mean_leg=plan.mean_leg * factor,
        detection_radius=plan.detection_radius * factor,
    )
    assert quantities(scaled) == pytest.approx(quantities(plan))
    assert even_side(scaled, LAW) == pytest.approx(factor * even_side(plan, LAW))
    assert chance_of_false_hole(scaled, LAW) == pytest.approx(chance_of_false_hole(plan, LAW))
    assert path_inflation(scaled) == pytest.approx(path_inflation(plan))
    assert mixing_s(scaled) == pytest.approx(mixing_s(plan))


@given(plans(), st.floats(1e-3, 1e3))
def test_twice_the_speed_in_half_the_time_changes_no_answer(plan: Plan, factor: float) -> None:
    hurried = replace(plan, speed=plan.speed * factor, duration_s=plan.duration_s / factor)
    assert quantities(hurried) == pytest.approx(quantities(plan))
    assert even_side(hurried, LAW) == pytest.approx(even_side(plan, LAW))
    assert count_deviation(hurried, LAW) == pytest.approx(count_deviation(plan, LAW))
    assert chance_connected(hurried) == pytest.approx(chance_connected(plan))


@given(plans(), st.floats(0.01, 0.99))
def test_the_side_found_with_a_chance_is_found_with_that_chance(plan: Plan, chance: float) -> None:
    if plan.landmarks:
        obstacle = side_found(plan, LAW, chance=chance)
        assert chance_found(plan, LAW, obstacle=obstacle) == pytest.approx(chance)


@pytest.mark.parametrize("obstacle", [1.2, 2.0, 3.0])
def test_an_obstacle_is_found_at_the_time_told_and_not_before(obstacle: float) -> None:
    told = time_to_find(HISSERS, LAW, obstacle=obstacle)
    assert told is not None
    assert chance_found(replace(HISSERS, duration_s=told), LAW, obstacle=obstacle) >= 0.8
    assert chance_found(replace(HISSERS, duration_s=0.999 * told), LAW, obstacle=obstacle) < 0.8


def test_what_no_time_shows_is_found_never() -> None:
    assert time_to_find(HISSERS, LAW, obstacle=0.3) is None
    assert time_to_find(replace(HISSERS, landmarks=0), LAW, obstacle=4.0) is None
    assert time_until(HISSERS, lambda _later: False) is None


def test_few_hissers_do_not_see_in_an_hour_what_forty_see_in_half_of_one() -> None:
    """Runs of old: a square of 2 m in 5 m x 5 m."""
    few = replace(HISSERS, biobots=10, landmarks=3, duration_s=3600.0)
    some = replace(HISSERS, biobots=20, landmarks=6, duration_s=3600.0)
    chances = [chance_found(plan, LAW, obstacle=2.0) for plan in (few, some, HISSERS)]
    assert chances[0] < 0.2
    assert chances[0] < chances[1] < 0.6
    assert chances[2] > 0.65


def test_the_number_of_biobots_told_is_the_least_that_does_it() -> None:
    foretold = forecast(HISSERS, LAW, obstacle=1.5)
    needed = foretold.obstacle_biobots
    assert needed is not None
    for biobots, suffices in ((needed, True), (needed - 1, False)):
        plan = replace(HISSERS, biobots=biobots, landmarks=round(biobots / 4))
        assert (chance_found(plan, LAW, obstacle=1.5) >= 0.8) is suffices


def test_advice_comes_with_the_best_first_and_each_helps() -> None:
    foretold = forecast(HISSERS, LAW, obstacle=2.0)
    now = foretold.outlooks[0]
    sides = [change.outlook.usual_side for change in foretold.changes]
    assert sides == sorted(sides)
    assert foretold.changes[0].name.startswith("twice the biobots (80, landmarks 20)")
    for change in foretold.changes:
        then = change.outlook
        assert then.usual_side < now.usual_side or then.chance_of_false_hole < now.chance_of_false_hole


def test_what_was_never_run_is_called_a_guess() -> None:
    assert outside_ranges(UNITS, LAW) == ()
    assert any(one.startswith("biobots 400 ") for one in outside_ranges(replace(UNITS, biobots=400), LAW))
    assert len(outside_ranges(PRINTED, LAW)) >= 4


def test_a_recording_is_compared_for_its_own_time() -> None:
    half = replace(HISSERS, duration_s=900.0)
    expected = round(expected_encounters(half))
    same = compare_recording(HISSERS, LAW, encounters=expected, duration_s=900.0)
    assert same.least < expected < same.most
    assert same.radius == pytest.approx(0.25, rel=0.01)
    poor = compare_recording(HISSERS, LAW, encounters=expected // 2, duration_s=900.0)
    assert poor.encounters < poor.least
    assert poor.radius is not None
    assert isclose(expected_encounters(replace(half, detection_radius=poor.radius)), expected // 2, rel_tol=1e-6)
    assert compare_recording(HISSERS, LAW, encounters=10**9, duration_s=900.0).radius is None
