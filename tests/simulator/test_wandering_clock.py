"""Laws of a clock whose rate changes."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.clock import DriftingClock
from simulator.errors import ParameterError
from simulator.wandering_clock import WanderingClock

HOUR_NS = 3600 * 10**9
clocks = st.builds(
    WanderingClock,
    start_ms=st.integers(0, 10**7),
    drift_ppb=st.integers(-(10**6), 10**6),
    wander_ppb=st.integers(0, 10**6),
    seed=st.integers(0, 9),
    node=st.integers(1, 9),
)


@given(clock=clocks, first_ns=st.integers(0, HOUR_NS), further_ns=st.integers(0, HOUR_NS))
def test_the_clock_never_goes_back(clock: WanderingClock, first_ns: int, further_ns: int) -> None:
    assert clock.read_ms(first_ns) <= clock.read_ms(first_ns + further_ns)


@given(clock=clocks, ahead_ms=st.integers(-60_000, 3_600_000))
def test_elapsed_is_the_first_instant_at_which_the_clock_shows_it(clock: WanderingClock, ahead_ms: int) -> None:
    ms = clock.start_ms + ahead_ms
    at_ns = clock.elapsed_ns(ms)
    assert clock.read_ms(at_ns) == ms
    assert clock.read_ms(at_ns - 1) < ms


@given(clock=clocks, instants=st.lists(st.integers(0, HOUR_NS), max_size=6))
def test_the_order_of_asking_changes_nothing(clock: WanderingClock, instants: list[int]) -> None:
    fresh = WanderingClock(
        start_ms=clock.start_ms, drift_ppb=clock.drift_ppb, wander_ppb=clock.wander_ppb, seed=clock.seed, node=clock.node
    )
    assert {t: clock.read_ms(t) for t in instants} == {t: fresh.read_ms(t) for t in reversed(instants)}


@given(elapsed_ns=st.integers(-HOUR_NS, HOUR_NS), drift_ppb=st.integers(-(10**5), 10**5))
def test_without_wandering_it_is_the_drifting_clock_to_a_nanosecond_a_minute(elapsed_ns: int, drift_ppb: int) -> None:
    wandering = WanderingClock(start_ms=5, drift_ppb=drift_ppb, wander_ppb=0, seed=1, node=1)
    drifting = DriftingClock(start_ms=5, drift_ppb=drift_ppb)
    assert abs(wandering.read_ms(elapsed_ns) - drifting.read_ms(elapsed_ns)) <= 1


def test_the_rate_wanders_and_stays_within_its_limit() -> None:
    clock = WanderingClock(start_ms=0, drift_ppb=10_000, wander_ppb=5_000, seed=1, node=1)
    minute_ns = 60 * 10**9
    shown = [clock.read_ms(k * minute_ns * 100) for k in range(200)]  # every 100 minutes
    rates = [(later - earlier) / (minute_ns * 100 / 1e6) - 1 for earlier, later in itertools.pairwise(shown)]
    assert all(4_999e-9 - 2e-7 <= rate <= 15_001e-9 + 2e-7 for rate in rates)
    assert max(rates) - min(rates) > 3e-6


def test_a_clock_that_might_stand_still_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"drift and wander is \(400000000, 200000000\); wanted at most 500000000 ppb together"):
        WanderingClock(start_ms=0, drift_ppb=400_000_000, wander_ppb=200_000_000, seed=1, node=1)
