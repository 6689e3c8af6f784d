"""Whether an insect did what it was told: the mode that its backpack reports within some seconds of a start or a stop.

To follow walls is a start; a turn shows in no mode. What no report speaks of in time is left open, and so is what the end of its hold or a
further command cut short.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.contract.records import Mode
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from gateway.stimulation.commands import Command

LATENCY_NS = 300 * NS_PER_MS
"""An insect takes up to 200 ms to respond, as the simulator has it, and a report some time to come: one that comes earlier may be older."""

ANSWERABLE_NS = 10 * NS_PER_S
"""A mode reported later than this may have other causes."""

_WANTED = {StimulationAction.START: Mode.CRW, StimulationAction.FOLLOW_WALLS: Mode.CRW, StimulationAction.STOP: Mode.S}
_ANSWERED = frozenset({Stage.BIOBOT_CONFIRMED, Stage.UNKNOWN})


@dataclass(slots=True)
class Effects:
    """Awaits what a command was to bring about; of each biobot the last command counts."""

    now_ns: Callable[[], int]
    _awaited: dict[NodeId, tuple[Command, int]] = field(default_factory=dict)

    def begin(self, command: Command) -> None:
        """Take note that a command has its last stage."""
        if command.request.action in _WANTED and command.stages[-1].stage in _ANSWERED:
            self._awaited[command.request.node] = (command, self.now_ns())

    def forget(self, node: NodeId | None) -> None:
        """Await nothing more of a biobot, or (None) of all: they are told something else now, and report that."""
        if node is None:
            self._awaited.clear()
        else:
            self._awaited.pop(node, None)

    def judge(self, node: NodeId, mode: Mode) -> tuple[Command, bool] | None:
        """Take a reported mode; return the command that it answers for, and whether it was obeyed."""
        awaited = self._awaited.get(node)
        if awaited is None:
            return None
        command, since_ns = awaited
        age_ns = self.now_ns() - since_ns
        if age_ns < LATENCY_NS:
            return None
        del self._awaited[node]
        hold_ns = command.request.hold_ms * NS_PER_MS
        is_held_out = bool(hold_ns) and self.now_ns() - command.came_ns >= hold_ns - LATENCY_NS
        return None if age_ns > ANSWERABLE_NS or is_held_out else (command, mode is _WANTED[command.request.action])
