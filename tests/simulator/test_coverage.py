"""Laws of coverage: the strongest coordinator first, no flapping, nobody where none is heard."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from simulator.errors import ParameterError
from simulator.radios.coverage import Coverage, CoverageConfig, spread_places
from simulator.radios.radio import Radio

TWO = ((0.0, 0.0), (10.0, 0.0))
places = st.tuples(st.floats(-20, 30), st.floats(-20, 20))


def a_coverage(radius: float | None = None, *, handover_db: float = 6.0, at: tuple[tuple[float, float], ...] = TWO) -> Coverage:
    return Coverage(CoverageConfig(places=at, radius=radius, handover_db=handover_db), strength_dbm=Radio(seed=1).strength_dbm)


@given(places)
def test_at_first_a_backpack_joins_the_nearest_coordinator(place: tuple[float, float]) -> None:
    coverage = a_coverage()
    nearest = min((0, 1), key=lambda index: (coverage.distance(place, index), index))
    choice = coverage.choose(place, home=None)
    assert choice is not None
    assert coverage.distance(place, choice) == pytest.approx(coverage.distance(place, nearest), abs=0.02)


@given(places, st.sampled_from([None, 0, 1]), st.floats(1.0, 15.0))
def test_nobody_belongs_to_a_coordinator_that_does_not_cover_it_and_all_covered_belong_to_one(
    place: tuple[float, float], home: int | None, radius: float
) -> None:
    coverage = a_coverage(radius)
    assume(all(abs(coverage.distance(place, index) - radius) > 1e-9 for index in (0, 1)))
    covering = [index for index in (0, 1) if coverage.distance(place, index) <= radius]
    choice = coverage.choose(place, home=home)
    assert choice in covering if covering else choice is None
    assert all(coverage.covers(index, place) == (index in covering) for index in (0, 1))


@given(places, st.sampled_from([None, 0, 1]))
def test_a_choice_once_made_stands_while_the_backpack_stands(place: tuple[float, float], home: int | None) -> None:
    coverage = a_coverage(8.0)
    choice = coverage.choose(place, home=home)
    assert coverage.choose(place, home=choice) == choice


def test_a_walk_to_the_other_coordinator_hands_over_once_past_the_middle_and_as_far_back_on_the_way_home() -> None:
    """6 dB at an exponent of 2.4 is a ratio of distances of 10^(6/24) = 1.778: at x = 10 * 1.778 / 2.778 = 6.40."""
    coverage = a_coverage()
    home: int | None = 0
    over, back = [], []
    for step in range(1_001):
        x = step / 100
        if (choice := coverage.choose((x, 0.0), home=home)) != home:
            over.append(x)
            home = choice
    for step in range(1_000, -1, -1):
        x = step / 100
        if (choice := coverage.choose((x, 0.0), home=home)) != home:
            back.append(x)
            home = choice
    assert over == [pytest.approx(6.40, abs=0.011)]
    assert back == [pytest.approx(3.60, abs=0.011)]


def test_one_coordinator_without_a_radius_is_heard_everywhere() -> None:
    coverage = a_coverage(at=((3.0, 4.0),))
    assert coverage.is_trivial
    assert coverage.covers(0, (1e9, 1e9))
    assert coverage.choose((math.nan, math.nan), home=None) == 0


@pytest.mark.parametrize(
    ("bounds", "count", "expected"),
    [((0, 0, 10, 10), 1, ((5, 5),)), ((0, 0, 10, 10), 2, ((2.5, 5), (7.5, 5))), ((-1, 0, 1, 12), 3, ((0, 2), (0, 6), (0, 10)))],
)
def test_coordinators_stand_in_the_middles_of_equal_strips_across_the_longer_side(
    bounds: tuple[float, ...], count: int, expected: tuple[tuple[float, float], ...]
) -> None:
    assert spread_places(bounds, count) == expected


@pytest.mark.parametrize(
    "changes", [{"places": ()}, {"places": ((math.nan, 0.0),)}, {"radius": 0.0}, {"radius": math.inf}, {"handover_db": -1.0}]
)
def test_coverage_that_cannot_be_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        CoverageConfig(**{"places": TWO, **changes})  # type: ignore[arg-type]  # wrong on purpose
