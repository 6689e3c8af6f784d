"""Whom this mapper moves: biobots that are to be stopped when it is gone. Pure: instants are arguments, on the monotonic clock.

More may be listed than are moved, and never fewer: a beat too many does no harm.
"""

from typing import Final

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId

_STARTS: Final = frozenset({StimulationAction.START, StimulationAction.FOLLOW_WALLS})
_MOTIONS: Final = _STARTS | {StimulationAction.TURN_LEFT, StimulationAction.TURN_RIGHT}
# A hold begins when the biobot obeys: up to a time to live after the command, and as long as a frame may be on its way.
_SLACK_NS: Final = 2 * NS_PER_S
_MAX_OF_ONE_BIOBOT: Final = 16


class ControlledMotion:
    """Biobots under the control of commands given here; a command counts until its hold must be over."""

    def __init__(self) -> None:
        self._ends_ns: dict[NodeId, dict[str, int]] = {}

    def begin(self, request: StimulationRequest, *, now_ns: int) -> None:
        """Note a command with a commander that is about to be sent."""
        if request.action not in _MOTIONS or not request.commander:
            return
        holds = self._ends_ns.setdefault(request.node, {})
        holds[request.command_id] = now_ns + (request.ttl_ms + request.hold_ms) * NS_PER_MS + _SLACK_NS
        if len(holds) > _MAX_OF_ONE_BIOBOT:
            del holds[min(holds, key=lambda command_id: holds[command_id])]

    def forget(self, *, node: NodeId, command_id: str) -> None:
        """Note that a command was not obeyed; one before it may be obeyed still."""
        holds = self._ends_ns.get(node, {})
        holds.pop(command_id, None)
        if not holds:
            self._ends_ns.pop(node, None)

    def heed(self, stage: CommandStage) -> None:
        """Take in what became of any command: a stop ends the control, and a start given anew without it, or by another."""
        holds = self._ends_ns.get(stage.node)
        if holds is None:
            return
        match stage.stage:
            case Stage.REFUSED:
                self.forget(node=stage.node, command_id=stage.command_id)
            case Stage.BIOBOT_CONFIRMED if stage.action is StimulationAction.STOP:
                del self._ends_ns[stage.node]
            case Stage.ACCEPTED if stage.action in _STARTS and stage.command_id not in holds:
                del self._ends_ns[stage.node]
            case Stage.BIOBOT_CONFIRMED if stage.command_id in holds:
                self._ends_ns[stage.node] = {stage.command_id: holds[stage.command_id]}
            case _:
                pass

    def nodes(self, *, now_ns: int) -> list[NodeId]:
        """List who may be under control now, by id."""
        for node, holds in list(self._ends_ns.items()):
            left = {command_id: end_ns for command_id, end_ns in holds.items() if end_ns > now_ns}
            if left:
                self._ends_ns[node] = left
            else:
                del self._ends_ns[node]
        return sorted(self._ends_ns)
