"""A note book, and a gate whose biobots answer as they are told, for tests of the dead-man."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationRequest
from firmware_protocol.units import EVERYBODY, Nanoseconds, NodeId


class NoteBook:
    """Keeps what is noted."""

    def __init__(self) -> None:
        self.entries: list[tuple[str, dict[str, object]]] = []
        self.of_whom: list[tuple[str, NodeId | None]] = []

    def note(self, kind: str, *, facts: Mapping[str, object], operator: str = "", node: NodeId | None = None) -> None:
        self.entries.append((kind, dict(facts)))
        self.of_whom.append((operator, node))

    def events(self, kind: str) -> list[object]:
        return [facts["event"] for one, facts in self.entries if one == kind]


@dataclass
class AnsweringGate:
    """Tells the stages of each command as the real one does; of a stop the last one is what the biobot's turn says."""

    listener: Callable[[StimulationRequest, CommandStage], None] = lambda _request, _stage: None
    ends: dict[NodeId, list[Stage]] = field(default_factory=dict)
    """How the next stops of a biobot end; where none is left, it confirms."""
    taken: list[StimulationRequest] = field(default_factory=list)
    never_answers: set[NodeId] = field(default_factory=set)

    async def handle(self, request: StimulationRequest, listener: Callable[[CommandStage], None]) -> None:
        self.taken.append(request)
        self._tell(request, Stage.ACCEPTED, listener)
        await asyncio.sleep(0)
        if request.node in self.never_answers:
            await asyncio.Event().wait()
        ends = self.ends.get(request.node, [])
        self._tell(request, ends.pop(0) if ends else Stage.BIOBOT_CONFIRMED, listener)

    def nodes(self) -> list[int]:
        return [int(request.node) for request in self.taken if request.node != EVERYBODY]

    def _tell(self, request: StimulationRequest, stage: Stage, listener: Callable[[CommandStage], None]) -> None:
        told = CommandStage(
            command_id=request.command_id, gateway="base1", node=request.node, action=request.action, stage=stage, wall_ns=Nanoseconds(0)
        )
        listener(told)
        self.listener(request, told)
