"""Laws of what a new process knows of the trains of those before it."""

import itertools
from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction
from firmware_protocol.contract.records import encode_record
from firmware_protocol.units import NS_PER_MS, Nanoseconds, NodeId
from gateway.config import StimulationTable
from gateway.journal_file import AuditEntry
from gateway.stimulation.ledger import TrainLedger
from gateway.stimulation.restoring import restore_trains
from gateway.stimulation.stimuli import Flight

_NODE = NodeId(1)
_LIMITS = StimulationTable()
_FLIGHT = Flight(table=_LIMITS)


def _latest_ns(at_ns: int) -> int:
    return _FLIGHT.latest_ns(now_ns=at_ns)


@dataclass(frozen=True, slots=True)
class _Wish:
    """A start: when it is wanted, its length, how late its train really is, its end, and whether the process ends right after it."""

    pause_ms: int
    train_ms: int
    lag_ms: int
    end: Stage | None
    is_killed: bool


_wishes = st.lists(
    st.builds(
        _Wish,
        pause_ms=st.integers(0, 4_000) | st.integers(0, 20_000),
        train_ms=st.integers(1, 500),
        lag_ms=st.integers(0, 7_000),
        end=st.sampled_from([Stage.BIOBOT_CONFIRMED, Stage.BIOBOT_CONFIRMED, Stage.UNKNOWN, Stage.REFUSED, Stage.FAILED, None]),
        is_killed=st.sampled_from([False, False, True]),
    ),
    max_size=60,
)


def _row(number: int, stage: Stage, at_ms: int, *, train_ms: int = 0) -> AuditEntry:
    body = CommandStage(
        command_id=str(number), gateway="g", node=_NODE, action=StimulationAction.START, stage=stage, wall_ns=Nanoseconds(0)
    )
    return AuditEntry(
        wall_ns=0,
        command_id=str(number),
        stage=stage.value,
        node=_NODE,
        train_ms=train_ms,
        body=encode_record(body),
        mono_ns=at_ms * NS_PER_MS,
    )


@given(_wishes, st.integers(0, 100_000))
def test_no_history_exceeds_a_limit_however_often_the_gateway_is_killed(wishes: list[_Wish], late_ms: int) -> None:
    """``late_ms``: so much later than they were are the rows of earlier processes taken to be, as after a boot of the machine."""
    ledger, rows, now_ms, trains = TrainLedger(limits=_LIMITS), list[AuditEntry](), 0, list[tuple[int, int]]()
    for number, wish in enumerate(wishes):
        now_ms += wish.pause_ms
        now_ns = now_ms * NS_PER_MS
        if ledger.refusal(_NODE, train_ms=wish.train_ms, now_ns=now_ns) is None:
            train = ledger.reserve(_NODE, train_ms=wish.train_ms, latest_ns=_latest_ns(now_ns), now_ns=now_ns)
            rows.append(_row(number, Stage.ACCEPTED, now_ms, train_ms=wish.train_ms))
            is_given = wish.end not in {Stage.REFUSED, Stage.FAILED}
            if is_given:
                trains.append((now_ms + wish.lag_ms, wish.train_ms))
            else:
                ledger.take_back(_NODE, train)
            if wish.end is Stage.BIOBOT_CONFIRMED:
                now_ms += wish.lag_ms + wish.train_ms
                train.latest_ns = now_ms * NS_PER_MS
            if wish.end is not None:
                rows.append(_row(number, wish.end, now_ms))
        if wish.is_killed:
            ledger = TrainLedger(limits=_LIMITS)
            at_ns = now_ms * NS_PER_MS

            def instant_of(entry: AuditEntry, at_ns: int = at_ns) -> int:
                assert entry.mono_ns is not None
                return min(at_ns, entry.mono_ns + late_ms * NS_PER_MS)

            restore_trains(ledger, rows, instant_of=instant_of, latest_ns=_latest_ns, now_ns=at_ns)
    for (begin, length), (following, _) in itertools.pairwise(trains):
        assert following - (begin + length) >= 2_000
    for begin, _ in trains:
        window = [(at, length) for at, length in trains if begin - 60_000 < at <= begin]
        assert len(window) <= 30
        assert sum(length for _, length in window) <= 9_000


def test_a_command_that_was_not_sent_leaves_no_train() -> None:
    for end in (Stage.REFUSED, Stage.FAILED):
        ledger = TrainLedger(limits=_LIMITS)
        rows = [_row(1, Stage.ACCEPTED, 0, train_ms=500), _row(1, end, 1)]
        restore_trains(ledger, rows, instant_of=lambda entry: entry.mono_ns or 0, latest_ns=_latest_ns, now_ns=NS_PER_MS)
        assert ledger.refusal(_NODE, train_ms=500, now_ns=NS_PER_MS) is None
