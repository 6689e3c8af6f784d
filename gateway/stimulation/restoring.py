"""What a new process knows of the trains and stops of earlier ones, from the rows of the audit log. Pure.

Rows are placed by clocks that nobody sets; where these do not say when a train was, it counts as later than it was, never as earlier.
"""

from collections.abc import Callable, Iterable, Iterator

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import decode_record
from firmware_protocol.units import NS_PER_S
from gateway.journal_file import SENT_AGAIN, STAGE, AuditEntry
from gateway.stimulation.ledger import Train, TrainLedger
from gateway.stimulation.precedence import KEPT_NS, Precedence
from gateway.stimulation.telling import COMMIT_TIMEOUT_S, STRAYED, TAKEN_BACK

_UNSENT = frozenset({Stage.REFUSED.value, Stage.FAILED.value})


def restore_trains(
    ledger: TrainLedger,
    rows: Iterable[AuditEntry],
    *,
    instant_of: Callable[[AuditEntry], int],
    latest_ns: Callable[[int], int],
    now_ns: int,
) -> None:
    """Give a ledger the trains of earlier processes.

    Parameters
    ----------
    rows
        Of the audit log, in order.
    instant_of
        Says when a row was written, on this process's monotonic clock, or later than it was.
    latest_ns
        Says when a train begins at the latest whose frame was given to a radio at an instant.
    """
    horizon_ns = now_ns - int(ledger.limits.window_s * NS_PER_S) - latest_ns(0) - _LONGEST_NS
    trains: dict[str, Train] = {}
    for row in rows:
        at_ns = instant_of(row)
        if row.node is None or at_ns < horizon_ns:
            continue
        if row.train_ms:
            begins_ns = at_ns if row.kind == STRAYED else latest_ns(at_ns + int(COMMIT_TIMEOUT_S * NS_PER_S))
            train = ledger.reserve(row.node, train_ms=row.train_ms, latest_ns=begins_ns, now_ns=now_ns)
            if row.kind in {STAGE, SENT_AGAIN}:
                trains[row.command_id] = train
        elif row.command_id in trains:
            known = trains[row.command_id]
            if row.kind == TAKEN_BACK or (row.kind == STAGE and row.stage in _UNSENT and not _is_stop(row)):
                ledger.take_back(row.node, trains.pop(row.command_id))
            elif row.kind == STAGE and row.stage == Stage.BIOBOT_CONFIRMED.value and not _is_stop(row):
                known.latest_ns = min(known.latest_ns, at_ns)


def restore_stops(
    precedence: Precedence, rows: Iterable[AuditEntry], *, instant_of: Callable[[AuditEntry], int], now_ns: int
) -> Iterator[AuditEntry]:
    """Yield the rows of the audit log, and take from them which stops may yet be newer than a command that comes."""
    for row in rows:
        if row.kind == STAGE and row.stage == Stage.ACCEPTED.value and (at_ns := instant_of(row)) >= now_ns - KEPT_NS and _is_stop(row):
            request = decode_record(row.request, StimulationRequest)
            precedence.stopped(request, came_ns=min(at_ns, now_ns), came_wall_ns=row.wall_ns)
        yield row


def _is_stop(row: AuditEntry) -> bool:
    """Whether a row is of a stop: of its frames several may have been on their way, and its answer speaks of one of them."""
    return decode_record(row.body, CommandStage).action in {StimulationAction.STOP, StimulationAction.STOP_ALL}


_LONGEST_NS = 66 * NS_PER_S
"""The longest pause that a backpack can announce (WIRE_FORMAT.md §5.8), and the longest train."""
