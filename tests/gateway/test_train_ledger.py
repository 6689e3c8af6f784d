"""Laws of the stimulation limits, held at the electrode: whenever within what is possible a train is given, no limit is exceeded."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from firmware_protocol.contract.commands import Refusal
from firmware_protocol.messages import Limits
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.stimulation.ledger import Train, TrainLedger

_NODE = NodeId(1)
_LIMITS = StimulationTable()
_ANNOUNCED = Limits(
    channels=0b111,
    waveforms=0b011,
    max_frequency_hz=150,
    max_pulse_width_us=10_000,
    max_amplitude_mv=4_000,
    max_duration_ms=1_000,
    min_gap_ms=0,
    max_on_ms_per_minute=60_000,
    battery_mv=2_900,
    battery_empty_mv=2_000,
    encounter_capacity=256,
)


@dataclass(frozen=True, slots=True)
class _Wish:
    """A command: how long after the one before, its length, how late its train really is, and when its answer comes (or never)."""

    pause_ms: int
    train_ms: int
    lag_ms: int
    answer_ms: int | None
    is_taken_back: bool


_wishes = st.lists(
    st.builds(
        _Wish,
        pause_ms=st.one_of(st.integers(0, 4_000), st.integers(0, 20_000)),
        train_ms=st.integers(1, 500),
        lag_ms=st.integers(0, 7_000),
        answer_ms=st.none() | st.integers(0, 9_000),
        is_taken_back=st.sampled_from([False] * 9 + [True]),
    ),
    max_size=80,
)
_FLIGHT_MS = 7_000


def _given(wishes: Sequence[_Wish], announced: Limits | None) -> list[tuple[int, int]]:
    """Return begin [ms] and length [ms] of the trains that an animal gets when a ledger decides on these wishes."""
    ledger, now_ms, trains = TrainLedger(limits=_LIMITS), 0, list[tuple[int, int]]()
    answers: list[tuple[int, Train]] = []
    for wish in wishes:
        now_ms += wish.pause_ms
        for at_ms, train in answers:
            if at_ms <= now_ms:
                train.latest_ns = min(train.latest_ns, at_ms * NS_PER_MS)
        now_ns = now_ms * NS_PER_MS
        if ledger.refusal(_NODE, train_ms=wish.train_ms, now_ns=now_ns, announced=announced) is not None:
            continue
        assert ledger.refusal(_NODE, train_ms=wish.train_ms, now_ns=now_ns) is None, "what a backpack announces never loosens the table"
        train = ledger.reserve(_NODE, train_ms=wish.train_ms, latest_ns=now_ns + _FLIGHT_MS * NS_PER_MS, now_ns=now_ns)
        if wish.is_taken_back:
            ledger.take_back(_NODE, train)
            continue
        trains.append((now_ms + wish.lag_ms, wish.train_ms))
        if wish.answer_ms is not None:
            answers.append((now_ms + wish.lag_ms + wish.answer_ms, train))
    return trains


@given(_wishes, st.none() | st.tuples(st.integers(0, 10_000), st.integers(0, 20_000)))
def test_no_history_exceeds_a_limit_at_the_electrode(wishes: list[_Wish], of_backpack: tuple[int, int] | None) -> None:
    announced, gap_ms, minute_ms = None, 2_000, 9_000
    if of_backpack is not None:
        announced = replace(_ANNOUNCED, min_gap_ms=of_backpack[0], max_on_ms_per_minute=of_backpack[1])
        gap_ms, minute_ms = max(gap_ms, of_backpack[0]), min(minute_ms, of_backpack[1])
    trains = _given(wishes, announced)
    for (begin, length), (following, _) in itertools.pairwise(trains):
        assert following - (begin + length) >= gap_ms
    for window_begins in [begin for begin, _ in trains] + [begin + length - 60_000 for begin, length in trains]:
        window = [(begin, length) for begin, length in trains if begin + length > window_begins and begin < window_begins + 60_000]
        on_ms = sum(min(begin + length, window_begins + 60_000) - max(begin, window_begins) for begin, length in window)
        assert len(window) <= 30
        assert on_ms <= minute_ms


@given(_wishes, st.integers(0, 100_000), st.integers(1, 500))
def test_a_biobot_is_ready_exactly_when_it_is_said_to_be(wishes: list[_Wish], now_ms: int, train_ms: int) -> None:
    ledger, at_ms = TrainLedger(limits=_LIMITS), 0
    for wish in wishes:
        at_ms += wish.pause_ms
        latest_ns = (at_ms + wish.lag_ms) * NS_PER_MS
        ledger.reserve(_NODE, train_ms=wish.train_ms, latest_ns=latest_ns, now_ns=at_ms * NS_PER_MS)
    now_ns = now_ms * NS_PER_MS
    ready_ns = ledger.ready_ns(_NODE, train_ms=train_ms, now_ns=now_ns)
    assert ready_ns is not None
    assert ready_ns >= now_ns
    assert ledger.refusal(_NODE, train_ms=train_ms, now_ns=ready_ns) is None
    if ready_ns > now_ns:
        assert ledger.refusal(_NODE, train_ms=train_ms, now_ns=ready_ns - 1) is not None


def test_a_train_without_an_answer_counts_from_the_latest_moment_at_which_it_can_come() -> None:
    ledger = TrainLedger(limits=_LIMITS)
    train = ledger.reserve(_NODE, train_ms=500, latest_ns=6 * NS_PER_S, now_ns=0)
    refused = ledger.refusal(_NODE, train_ms=500, now_ns=4 * NS_PER_S)
    assert refused is not None
    assert refused.refusal is Refusal.GAP
    assert "may still come" in refused.reason
    assert ledger.ready_ns(_NODE, train_ms=500, now_ns=4 * NS_PER_S) == 8_500 * NS_PER_MS
    train.latest_ns = NS_PER_S
    assert ledger.refusal(_NODE, train_ms=500, now_ns=4 * NS_PER_S) is None


def test_biobots_have_limits_of_their_own() -> None:
    ledger = TrainLedger(limits=_LIMITS)
    ledger.reserve(_NODE, train_ms=500, latest_ns=0, now_ns=0)
    assert ledger.refusal(_NODE, train_ms=500, now_ns=NS_PER_S) is not None
    assert ledger.refusal(NodeId(2), train_ms=500, now_ns=NS_PER_S) is None
    assert ledger.refusal(_NODE, train_ms=500, now_ns=3 * NS_PER_S) is None


def test_what_is_kept_of_a_biobot_is_bounded_and_refuses_as_all_of_it_would() -> None:
    ledger = TrainLedger(limits=_LIMITS)
    for _ in range(1_000):
        ledger.reserve(_NODE, train_ms=1, latest_ns=0, now_ns=0)
    assert len(ledger._trains[_NODE]) == 4 * _LIMITS.max_trains
    refused = ledger.refusal(_NODE, train_ms=1, now_ns=50 * NS_PER_S)
    assert refused is not None
    assert refused.refusal is Refusal.TRAINS
    assert ledger.refusal(_NODE, train_ms=1, now_ns=61 * NS_PER_S) is None
