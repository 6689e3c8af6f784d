"""Laws of the pace at which frames are handed to a line."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.units import NS_PER_MS, NS_PER_S
from gateway.line_pace import LinePace


@given(
    rate=st.integers(960, 400_000),
    frames=st.lists(st.tuples(st.integers(1, 150), st.integers(0, 40)), min_size=1, max_size=60),
)
def test_a_frame_that_is_handed_over_finds_little_before_it_and_the_line_does_not_rest(rate: int, frames: list[tuple[int, int]]) -> None:
    """The line sends one byte after the other; each frame is handed over when the pace allows it, or so many milliseconds later."""
    pace = LinePace(bytes_per_s=rate)
    now_ns = empty_at_ns = NS_PER_S
    for size, late_ms in frames:
        had_to_wait = pace.free_at_ns >= now_ns
        now_ns = max(now_ns, pace.free_at_ns) + late_ms * NS_PER_MS
        left_bytes = max(0, empty_at_ns - now_ns) * rate / NS_PER_S
        assert left_bytes <= max(32, rate * 0.002) + 1
        if had_to_wait and late_ms <= 1:
            assert now_ns < empty_at_ns, "the line never rested, though the gateway was a millisecond late"
        empty_at_ns = max(empty_at_ns, now_ns) + size * NS_PER_S // rate
        pace.note(size, now_ns=now_ns)


def test_a_line_that_needs_no_pace_is_always_free() -> None:
    pace = LinePace(bytes_per_s=None)
    pace.note(10**6, now_ns=NS_PER_S)
    assert pace.free_at_ns <= NS_PER_S
