"""Which biobots are under controlled motion, by whom, and until when: pure.

Controlled motion begins with an accepted start or turn that has a hold or a commander; to follow walls is a start. It ends when
the biobot confirms a stop that was given after it, when a start without either is accepted, or when it turns out that the command that
began it never reached the biobot. A stop that nobody confirmed ends nothing: that biobot may still be moving.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.units import NS_PER_MS, NodeId

_TURNS = {StimulationAction.TURN_LEFT, StimulationAction.TURN_RIGHT}
_MOTIONS = {StimulationAction.START, StimulationAction.FOLLOW_WALLS, *_TURNS}
_STOPS = {StimulationAction.STOP, StimulationAction.STOP_ALL}


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Somebody moves a biobot."""

    node: NodeId
    commander: str
    """Empty: nobody has to be there; the hold alone ends it."""
    operator: str
    command_id: str
    since_ns: int
    until_ns: int | None
    """When its hold is over; None: it has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Takeover:
    """A biobot went from one commander to another."""

    before: Control
    after: Control


class ControlBook:
    """Keeps account from the stages of all commands; instants are on one monotonic clock [ns]."""

    def __init__(self) -> None:
        self._controls: dict[NodeId, Control] = {}
        self._pending: dict[str, tuple[NodeId, Control | None, Control | None]] = {}
        """Of each accepted motion whose outcome is not known: biobot, what was before, and what it made of it."""
        self._stopping: dict[str, Control | None] = {}
        """Of each accepted stop whose outcome is not known: what it is to end. A motion that was accepted after it goes on."""

    @property
    def controlled(self) -> Mapping[NodeId, Control]:
        """All controls there are."""
        return MappingProxyType(self._controls)

    def operator_of(self, node: NodeId) -> str:
        """Return the operator who moves a biobot, or nothing."""
        control = self._controls.get(node)
        return "" if control is None else control.operator

    def moving(self) -> list[tuple[str, int]]:
        """Return each commander who moves anybody, and since when it last began to."""
        since: dict[str, int] = {}
        for control in self._controls.values():
            if control.commander:
                since[control.commander] = max(control.since_ns, since.get(control.commander, control.since_ns))
        return list(since.items())

    def of_commander(self, commander: str) -> list[Control]:
        """Return whom a commander moves."""
        return [control for control in self._controls.values() if control.commander == commander]

    def overdue(self, *, now_ns: int) -> list[Control]:
        """Return those whose hold is over."""
        return [control for control in self._controls.values() if control.until_ns is not None and control.until_ns <= now_ns]

    def next_end_ns(self) -> int | None:
        """When the first hold is over."""
        return min((control.until_ns for control in self._controls.values() if control.until_ns is not None), default=None)

    def note(self, request: StimulationRequest, stage: CommandStage, *, now_ns: int) -> Takeover | None:
        """Take a stage of a command; return whom it took from whom, if it did."""
        if request.action in _STOPS:
            self._note_stop(stage)
            return None
        if request.action not in _MOTIONS:
            return None
        if stage.stage is Stage.ACCEPTED and request.command_id not in self._pending:
            return self._begin(request, now_ns=now_ns)
        if stage.is_final:
            self._settle(request.command_id, was_obeyed=stage.stage in {Stage.BIOBOT_CONFIRMED, Stage.UNKNOWN})
        return None

    def _note_stop(self, stage: CommandStage) -> None:
        if stage.stage is Stage.ACCEPTED:
            self._stopping[stage.command_id] = self._controls.get(stage.node)
        elif stage.is_final:
            ended = self._stopping.pop(stage.command_id, None)
            if stage.stage is Stage.BIOBOT_CONFIRMED and ended is not None and self._controls.get(stage.node) == ended:
                del self._controls[stage.node]

    def _begin(self, request: StimulationRequest, *, now_ns: int) -> Takeover | None:
        before = self._controls.get(request.node)
        is_controlled = bool(request.hold_ms or request.commander)
        if not is_controlled and request.action in _TURNS:
            return None  # a turn alone is over by itself, and takes no control from anybody
        after = None
        if is_controlled:
            after = Control(
                node=request.node,
                commander=request.commander,
                operator=request.operator,
                command_id=request.command_id,
                since_ns=now_ns,
                until_ns=now_ns + request.hold_ms * NS_PER_MS if request.hold_ms else None,
            )
        self._pending[request.command_id] = (request.node, before, after)
        self._put(request.node, after)
        if before is not None and after is not None and before.commander != after.commander:
            return Takeover(before=before, after=after)
        return None

    def _settle(self, command_id: str, *, was_obeyed: bool) -> None:
        node, before, after = self._pending.pop(command_id, (None, None, None))
        if node is None or was_obeyed or self._controls.get(node) != after:
            return
        self._put(node, before)

    def _put(self, node: NodeId, control: Control | None) -> None:
        if control is None:
            self._controls.pop(node, None)
        else:
            self._controls[node] = control
