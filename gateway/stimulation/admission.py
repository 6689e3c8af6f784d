"""Whether a command may go to its animal: a request and all that is known become a pulse train, or a refusal. Pure.

A stop is never asked any of this; see ``stops.py``.
"""

from dataclasses import dataclass

from firmware_protocol.contract.commands import Refusal, StimulationAction, StimulationRequest
from firmware_protocol.messages import Capability
from firmware_protocol.units import EVERYBODY, NS_PER_MS
from gateway.config import StimulationTable
from gateway.nodes import Node
from gateway.stimulation.ledger import TrainLedger
from gateway.stimulation.pulses import Pulse, pulse_of, pulse_refusal
from gateway.stimulation.verdict import Refused

MAX_RUNNING = 256
"""Commands under way, stops aside; more are refused."""

MAX_RUNNING_OF_ONE = 4
"""The same of one biobot: no more wait in a backpack (WIRE_FORMAT.md §6.8)."""

_MAX_TTL_MS = 0xFFFF
_TURNS = {StimulationAction.TURN_LEFT, StimulationAction.TURN_RIGHT}

_OVERTAKEN = Refused(
    refusal=Refusal.OVERTAKEN,
    reason="it was issued, or came, before a stop of this biobot that is here already; send it anew if it is still wanted, and set clocks",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Circumstances:
    """What is so when a request comes. ``node`` is None where its biobot was never heard of."""

    node: Node | None
    now_ns: int
    now_wall_ns: int
    n_running: int
    n_running_of_node: int
    is_overtaken: bool
    is_stopping: bool
    is_commander_there: bool
    journal_fault: str | None


def admit(request: StimulationRequest, *, table: StimulationTable, ledger: TrainLedger, so: Circumstances) -> Pulse | Refused:
    """Return the train that a motion may give now, or why it may not."""
    node = so.node
    if node is None:
        return unknown_biobot(request)
    refused = (
        _why_unfit(node)
        or why_unable(node, request.action)
        or _why_late(request, table=table, now_wall_ns=so.now_wall_ns)
        or (_OVERTAKEN if so.is_overtaken else None)
        or _why_endless(request)
        or why_unattended(request, is_stopping=so.is_stopping, is_commander_there=so.is_commander_there)
        or _why_unrecorded(so)
        or _why_too_many(so)
    )
    if refused is not None:
        return refused
    pulse = pulse_of(request.pulse, table, is_bare=request.action is StimulationAction.FOLLOW_WALLS)
    if request.action in _TURNS and not (pulse.duration_ms and pulse.amplitude_mv):
        what, unit = ("amplitude_mv", "mV") if pulse.duration_ms else ("duration_ms", "ms")
        return Refused(refusal=Refusal.PULSE, reason=f"a turn without a train is none: {what} is 0; ask for 1 {unit} or more")
    refused = pulse_refusal(pulse, table=table, limits=node.limits)
    refused = refused or ledger.refusal(node.node, train_ms=pulse.duration_ms, now_ns=so.now_ns, announced=node.limits)
    return refused or pulse


def unknown_biobot(request: StimulationRequest) -> Refused:
    """Return the refusal of a command to a biobot that this gateway has never heard."""
    heard = "it was never heard by this gateway; see that it is on and near, or ask the gateway that hears it"
    why = heard if request.node < EVERYBODY else f"the largest number of a biobot is {EVERYBODY - 1}"
    return Refused(refusal=Refusal.UNKNOWN_BIOBOT, reason=f"biobot {request.node} is not known here: {why}")


def why_unattended(request: StimulationRequest, *, is_stopping: bool, is_commander_there: bool) -> Refused | None:
    """Return why nobody would look after the command: the gateway ends, or its commander is away."""
    if is_stopping:
        return Refused(refusal=Refusal.STOPPING, reason="the gateway is about to end; send it when it runs again")
    if not is_commander_there:
        reason = f"its commander {request.commander!r} is not there: it has no liveliness token; declare it, and send the command anew"
        return Refused(refusal=Refusal.NO_COMMANDER, reason=reason)
    return None


def _why_endless(request: StimulationRequest) -> Refused | None:
    if not request.commander or request.hold_ms:
        return None
    reason = (
        f"it has a commander ({request.commander!r}) and hold_ms is 0: a backpack that nobody reaches would never stop by itself; "
        "give hold_ms of 1 or more, as 10000, and give the command anew before that is over"
    )
    return Refused(refusal=Refusal.NO_HOLD, reason=reason)


def remaining_ms(request: StimulationRequest, *, now_wall_ns: int) -> int:
    """Return how much of a command's time to live is left [ms]; one from the future has all of it."""
    age_ms = (now_wall_ns - request.issued_wall_ns) // NS_PER_MS
    return min(request.ttl_ms - max(0, age_ms), _MAX_TTL_MS)


def _why_unfit(node: Node) -> Refused | None:
    if node.is_introduced and not node.capabilities & Capability.STIMULATION:
        return Refused(
            refusal=Refusal.UNFIT_BIOBOT, reason=f"biobot {node.node} cannot be stimulated: its backpack says so; take another one"
        )
    if not node.last_heard_ns:
        reason = (
            f"biobot {node.node} was not heard since the gateway started, and another may have its address by now; it is being asked: "
            "try again soon"
        )
        return Refused(refusal=Refusal.UNFIT_BIOBOT, reason=reason)
    return None


def why_unable(node: Node, action: StimulationAction) -> Refused | None:
    """Return why a biobot cannot be sent along walls: its backpack has not said since its start that it can."""
    if action is not StimulationAction.FOLLOW_WALLS or (node.is_introduced and node.capabilities & Capability.FOLLOW_WALLS):
        return None
    why = "its backpack does not say that it can" if node.is_introduced else "its backpack has not said since its start what it can"
    return Refused(refusal=Refusal.UNFIT_BIOBOT, reason=f"biobot {node.node} is not told to follow walls: {why}; ask for start instead")


def _why_late(request: StimulationRequest, *, table: StimulationTable, now_wall_ns: int) -> Refused | None:
    ahead_ms = (request.issued_wall_ns - now_wall_ns) // NS_PER_MS
    if ahead_ms > table.max_clock_ahead_s * 1000:
        reason = f"it was issued {ahead_ms} ms in the future, the limit is {table.max_clock_ahead_s * 1000:g} ms; set the clocks"
        return Refused(refusal=Refusal.FROM_THE_FUTURE, reason=reason)
    if remaining_ms(request, now_wall_ns=now_wall_ns) <= 0:
        reason = f"it is stale: issued {-ahead_ms} ms ago with a time to live of {request.ttl_ms} ms; send it anew"
        return Refused(refusal=Refusal.STALE, reason=reason)
    return None


def _why_unrecorded(so: Circumstances) -> Refused | None:
    if so.journal_fault is not None:
        return Refused(refusal=Refusal.JOURNAL, reason=f"the journal takes nothing ({so.journal_fault}); make room on its disk")
    return None


def _why_too_many(so: Circumstances) -> Refused | None:
    for n, limit, whose in ((so.n_running, MAX_RUNNING, ""), (so.n_running_of_node, MAX_RUNNING_OF_ONE, " to this biobot")):
        if n >= limit:
            reason = f"{n} commands{whose} are under way, the limit is {limit}; wait for their answers"
            return Refused(refusal=Refusal.TOO_MANY, reason=reason)
    return None
