"""Laws of the fit of a backpack's clock."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, NodeId
from gateway.clocks import PATIENCE_NS, ROUGH_PATIENCE_NS, WIDE_PATIENCE_NS, ClockBook, NodeClock
from gateway.encounters import margin_of

_delays_ms = st.lists(st.integers(0, 3000), min_size=1, max_size=40)


@given(
    offset_s=st.integers(-10_000, 10_000),
    ppm=st.integers(-90, 90),
    delays=_delays_ms,
    down_delays=st.lists(st.integers(0, 500), min_size=1, max_size=5),
    age_s=st.integers(0, 60),
)
def test_after_a_time_sync_the_truth_is_within_the_bound(
    offset_s: int, ppm: int, delays: list[int], down_delays: list[int], age_s: int
) -> None:
    """The backpack's tick at gateway time t is ``(t - offset) * (1 + ppm)``; every delay is at least zero."""
    offset_ns = (offset_s + 20_000) * NS_PER_S

    def tick_at(t_ns: int) -> Milliseconds:
        return Milliseconds((t_ns - offset_ns) * (1_000_000 + ppm) // 1_000_000 // NS_PER_MS)

    clock = NodeClock(window_ns=300 * NS_PER_S)
    now_ns = offset_ns + 1000 * NS_PER_S
    for at, delay in enumerate(delays):
        clock.observe(sent_ms=tick_at(now_ns), received_ns=now_ns + delay * NS_PER_MS)
        now_ns += NS_PER_S
        if at < len(down_delays):
            clock.bound_below(requested_ns=now_ns, arrived_ms=tick_at(now_ns + down_delays[at] * NS_PER_MS))
            clock.observe(sent_ms=tick_at(now_ns + NS_PER_S), received_ns=now_ns + NS_PER_S + delay * NS_PER_MS)
            now_ns += 4 * NS_PER_S
    event_ns = now_ns - age_s * NS_PER_S
    reading = clock.read(tick_at(event_ns))
    assert abs(reading.t_ns - event_ns) <= reading.error_ns
    assert clock.n_jumps == 0


def test_one_quick_message_among_slow_ones_sets_the_offset() -> None:
    clock = NodeClock(window_ns=300 * NS_PER_S)
    for second, delay_ms in ((0, 900), (1, 700), (2, 3), (3, 800)):
        clock.observe(sent_ms=Milliseconds(1000 * second), received_ns=(50_000 + 1000 * second + delay_ms) * NS_PER_MS)
    clock.bound_below(requested_ns=54_000 * NS_PER_MS, arrived_ms=Milliseconds(4002))
    assert clock.is_settled
    reading = clock.read(Milliseconds(2000))
    assert abs(reading.t_ns - 52_000 * NS_PER_MS) < 4 * NS_PER_MS
    assert reading.error_ns < 6 * NS_PER_MS


def test_without_a_time_sync_a_clock_is_not_settled() -> None:
    clock = NodeClock(window_ns=NS_PER_S)
    clock.observe(sent_ms=Milliseconds(5), received_ns=NS_PER_S)
    assert not clock.is_settled


def test_a_clock_that_jumps_is_believed_anew() -> None:
    clock = NodeClock(window_ns=300 * NS_PER_S)
    clock.observe(sent_ms=Milliseconds(0), received_ns=100 * NS_PER_S)
    clock.bound_below(requested_ns=101 * NS_PER_S, arrived_ms=Milliseconds(1001))
    # The host slept for an hour and its monotonic clock did not go on: the backpack seems to be an hour ahead.
    clock.observe(sent_ms=Milliseconds(3_602_000), received_ns=102 * NS_PER_S)
    assert clock.n_jumps == 1
    assert not clock.is_settled
    assert abs(clock.read(Milliseconds(3_602_000)).t_ns - 102 * NS_PER_S) <= 50 * NS_PER_MS


def test_a_time_sync_reply_counts_once_and_only_from_whom_was_asked() -> None:
    book = ClockBook(window_ns=300 * NS_PER_S)
    asked, other, boot = NodeId(1), NodeId(2), BootId(1)
    for node in (asked, other):
        book.observe(node=node, boot=boot, sent_ms=Milliseconds(0), received_ns=NS_PER_S)
    token = book.begin_exchange(node=asked, now_ns=NS_PER_S)
    assert not book.end_exchange(node=other, boot=boot, token=token, arrived_ms=Milliseconds(1))
    assert book.end_exchange(node=asked, boot=boot, token=token, arrived_ms=Milliseconds(1))
    assert not book.end_exchange(node=asked, boot=boot, token=token, arrived_ms=Milliseconds(1))
    assert book.is_settled(node=asked, boot=boot)
    assert not book.is_settled(node=other, boot=boot)


def test_a_clock_with_a_wide_bound_is_believed_after_seconds_and_one_with_none_after_a_minute() -> None:
    def patience_of(clock: NodeClock) -> int:
        return next(at for at in (0, ROUGH_PATIENCE_NS, PATIENCE_NS, WIDE_PATIENCE_NS) if clock.is_believed(now_ns=clock.first_ns + at))

    clock = NodeClock(window_ns=300 * NS_PER_S)
    clock.observe(sent_ms=Milliseconds(0), received_ns=100 * NS_PER_S)
    assert patience_of(clock) == PATIENCE_NS
    clock.bound_below(requested_ns=100 * NS_PER_S, arrived_ms=Milliseconds(1_500))
    assert patience_of(clock) == WIDE_PATIENCE_NS, "hardly a bound, and a better one is to come"
    clock.bound_below(requested_ns=102 * NS_PER_S, arrived_ms=Milliseconds(2_900))
    assert patience_of(clock) == ROUGH_PATIENCE_NS
    assert 0.8 * NS_PER_S < clock.read(Milliseconds(2_900)).error_ns < NS_PER_S
    clock.bound_below(requested_ns=104 * NS_PER_S, arrived_ms=Milliseconds(4_010))
    assert patience_of(clock) == 0


def test_a_margin_covers_the_error_of_a_bounded_clock_and_not_what_is_only_assumed() -> None:
    assert margin_of(beacon_period_ms=0, error_ns=5) == 5
    assert margin_of(beacon_period_ms=0, error_ns=900 * NS_PER_MS) == 900 * NS_PER_MS
    assert margin_of(beacon_period_ms=0, error_ns=1_100 * NS_PER_MS) == NS_PER_S
    assumed = NodeClock(window_ns=300 * NS_PER_S)
    assumed.observe(sent_ms=Milliseconds(0), received_ns=100 * NS_PER_S)
    assert margin_of(beacon_period_ms=0, error_ns=assumed.read(Milliseconds(0)).error_ns) == 100 * NS_PER_MS


@given(
    ppm=st.integers(-90, 90),
    delay_ms=st.integers(0, 40),
    down_ms=st.integers(0, 40),
    away_s=st.integers(0, 600),
    late_ms=st.integers(0, 3_000),
)
def test_a_clock_known_again_is_good_at_once_and_its_bound_holds(ppm: int, delay_ms: int, down_ms: int, away_s: int, late_ms: int) -> None:
    def tick_at(t_ns: int) -> Milliseconds:
        return Milliseconds(t_ns * (1_000_000 + ppm) // 1_000_000 // NS_PER_MS)

    before = NodeClock(window_ns=300 * NS_PER_S)
    now_ns = 1_000 * NS_PER_S
    before.observe(sent_ms=tick_at(now_ns), received_ns=now_ns + delay_ms * NS_PER_MS)
    before.bound_below(requested_ns=now_ns - down_ms * NS_PER_MS, arrived_ms=tick_at(now_ns))
    memory = before.memory(anchor_ns=7)
    assert memory is not None
    now_ns += away_s * NS_PER_S
    book = ClockBook(window_ns=300 * NS_PER_S)
    book.restore(memory, node=NodeId(1), boot=BootId(2), now_ns=now_ns)
    assert book.is_settled(node=NodeId(1), boot=BootId(2))
    after = book.observe(node=NodeId(1), boot=BootId(2), sent_ms=tick_at(now_ns), received_ns=now_ns + late_ms * NS_PER_MS)
    assert after.n_jumps == 0
    reading = after.read(tick_at(now_ns))
    assert abs(reading.t_ns - now_ns) <= reading.error_ns < 250 * NS_PER_MS
