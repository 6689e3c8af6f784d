"""Laws of the line that a backpack's clock is fitted with."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, NodeId
from gateway.clock_fit import MAX_DRIFT, Point, fit
from gateway.clocks import ASSUMED_DELAY_NS, ClockBook, NodeClock

_WINDOW_NS = 300 * NS_PER_S


def _fit_all(upper: list[Point], lower: list[Point], *, at_ns: int) -> tuple[float, float, float, float]:
    """Bounds of offset and rate by trying rates one by one: slow and plain, and in whole numbers, for the room may be none."""
    possible = []
    for ppm in range(-100, 101):
        top = min(o * 1_000_000 + ppm * (at_ns - t) for t, o in upper)
        bottom = max(o * 1_000_000 + ppm * (at_ns - t) for t, o in lower)
        if bottom <= top:
            possible.append((ppm * 1e-6, bottom / 1e6, top / 1e6))
    return possible[0][0], possible[-1][0], min(one[1] for one in possible), max(one[2] for one in possible)


@given(
    ppm=st.integers(-90, 90),
    upper=st.lists(st.tuples(st.integers(0, 300), st.integers(0, 400)), min_size=1, max_size=12),
    lower=st.lists(st.tuples(st.integers(0, 300), st.integers(0, 400)), min_size=1, max_size=12),
    at_s=st.integers(-100, 400),
)
def test_a_fit_has_room_for_every_line_that_trying_all_rates_finds(
    ppm: int, upper: list[tuple[int, int]], lower: list[tuple[int, int]], at_s: int
) -> None:
    """Points are seconds and delays in ms, about a line of so many ppm."""
    above = [(t * NS_PER_S, t * ppm * 1000 + delay * NS_PER_MS) for t, delay in upper]
    below = [(t * NS_PER_S, t * ppm * 1000 - delay * NS_PER_MS) for t, delay in lower]
    found = fit(above, below, at_ns=at_s * NS_PER_S, assumed_delay_ns=ASSUMED_DELAY_NS)
    slowest, fastest, bottom, top = _fit_all(above, below, at_ns=at_s * NS_PER_S)
    assert found is not None
    assert found.rate - found.rate_error <= slowest + 1e-12
    assert found.rate + found.rate_error >= fastest - 1e-12
    assert found.lower_ns <= bottom + 1
    assert found.upper_ns >= top - 1


def test_minutes_of_traffic_bound_the_rate_better_than_the_largest_drift() -> None:
    """A room of 2 x 6 ms and a tick over 280 s bounds the rate to 13 ms / 280 s = 46.4 ppm either side; 5 ppm are for wander."""
    clock = NodeClock(window_ns=_WINDOW_NS)
    for second in range(0, 301, 10):
        at_ns = (1000 + second) * NS_PER_S
        clock.observe(sent_ms=Milliseconds(second * 1000), received_ns=at_ns + 6 * NS_PER_MS)
        clock.bound_below(requested_ns=at_ns - 6 * NS_PER_MS, arrived_ms=Milliseconds(second * 1000))
    fitted = clock.fitted
    assert fitted is not None
    assert fitted.rate_error < 52e-6 < MAX_DRIFT
    assert abs(fitted.rate) < fitted.rate_error
    assert clock.n_jumps == 0


@pytest.mark.parametrize("age_s", [0, 60, 3600])
def test_the_bound_grows_with_the_distance_to_the_traffic(age_s: int) -> None:
    clock = NodeClock(window_ns=_WINDOW_NS)
    for second in range(3600, 3900, 10):
        at_ns = (1000 + second) * NS_PER_S
        clock.observe(sent_ms=Milliseconds(second * 1000), received_ns=at_ns + 5 * NS_PER_MS)
        clock.bound_below(requested_ns=at_ns - 5 * NS_PER_MS, arrived_ms=Milliseconds(second * 1000))
    reading = clock.read(Milliseconds((3890 - age_s) * 1000))
    assert 5 * NS_PER_MS <= reading.error_ns <= 7 * NS_PER_MS + age_s * 50_000


def test_a_host_that_slept_is_noticed_and_the_next_time_sync_settles_the_clock_again() -> None:
    clock = NodeClock(window_ns=_WINDOW_NS)
    for second in range(60):
        clock.observe(sent_ms=Milliseconds(second * 1000), received_ns=(1000 + second) * NS_PER_S + 5 * NS_PER_MS)
        clock.bound_below(requested_ns=(1000 + second) * NS_PER_S, arrived_ms=Milliseconds(second * 1000 + 5))
    # The host's monotonic clock stood still for 10 s: a message seems to come before it was sent.
    clock.observe(sent_ms=Milliseconds(70_000), received_ns=1_060 * NS_PER_S + 5 * NS_PER_MS)
    settled = [clock.is_settled]
    clock.bound_below(requested_ns=1_060 * NS_PER_S, arrived_ms=Milliseconds(70_005))
    assert [*settled, clock.is_settled] == [False, True]
    assert clock.n_jumps == 1
    assert abs(clock.read(Milliseconds(70_000)).t_ns - 1_060 * NS_PER_S) < 10 * NS_PER_MS


def test_a_time_sync_that_contradicts_all_before_is_believed() -> None:
    """A backpack whose clock went back by 10 s in one life: requests then seem to arrive before they are made."""
    clock = NodeClock(window_ns=_WINDOW_NS)
    for second in range(60):
        clock.observe(sent_ms=Milliseconds(second * 1000), received_ns=(1000 + second) * NS_PER_S + 5 * NS_PER_MS)
    clock.observe(sent_ms=Milliseconds(50_000), received_ns=1_060 * NS_PER_S + 5 * NS_PER_MS)
    clock.bound_below(requested_ns=1_060 * NS_PER_S, arrived_ms=Milliseconds(49_998))
    assert clock.n_jumps == 1
    assert clock.is_settled
    assert abs(clock.read(Milliseconds(50_000)).t_ns - 1_060 * NS_PER_S) < 10 * NS_PER_MS


@given(st.lists(st.tuples(st.integers(0, (1 << 32) - 1), st.integers(0, 1 << 44), st.booleans()), max_size=200))
def test_whatever_a_backpack_says_of_its_clock_nothing_raises_and_memory_is_bounded(said: list[tuple[int, int, bool]]) -> None:
    book = ClockBook(window_ns=_WINDOW_NS)
    node, boot = NodeId(1), BootId(1)
    for ms, received_ns, is_reply in said:
        clock = book.observe(node=node, boot=boot, sent_ms=Milliseconds(ms), received_ns=received_ns)
        if is_reply:
            token = book.begin_exchange(node=node, now_ns=received_ns)
            book.end_exchange(node=node, boot=boot, token=token, arrived_ms=Milliseconds(ms ^ 0x5555))
        assert clock.read(Milliseconds(ms)).error_ns > 0
        assert len(clock._upper) <= 33
        assert len(clock._lower) <= 33
