"""The commands that are under way, and the last ones that are not: by their id, and by their number on the wire."""

import asyncio
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.messages import StimulateReply
from firmware_protocol.units import NodeId
from gateway.stimulation.ledger import Train
from gateway.stimulation.outside import Sending, StageListener

_MAX_REMEMBERED = 1024

STOPS = frozenset({StimulationAction.STOP, StimulationAction.STOP_ALL})


@dataclass(slots=True, kw_only=True, eq=False)
class Command:
    """A command under way, or finished and remembered."""

    request: StimulationRequest
    key: str
    """Under which the book has it: its id, but for a stop whose id another command has."""
    wire_command: int | None = None
    """Its number on the wire; None: it was refused before it got one."""
    part_of: str = ""
    came_ns: int = 0
    """When it came in (monotonic)."""
    stages: list[CommandStage] = field(default_factory=list)
    listeners: list[StageListener] = field(default_factory=list)
    train: Train | None = None
    """The train that it may give, in the ledger."""
    sendings: list[Sending] = field(default_factory=list)
    """Its frames, in the order in which they were given to dongles."""
    is_overtaken: bool = False
    """A stop came before it was sent, or before its frame was written."""
    overtaken: "asyncio.Future[None]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    reply: "asyncio.Future[StimulateReply]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    finished: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def is_stop(self) -> bool:
        """Whether it stops one biobot or all."""
        return self.request.action in STOPS

    @property
    def is_radio_confirmed(self) -> bool:
        """Whether it was told that a radio has sent it."""
        return any(stage.stage is Stage.RADIO_CONFIRMED for stage in self.stages)

    @property
    def is_final(self) -> bool:
        """Whether its last stage is told."""
        return bool(self.stages) and self.stages[-1].is_final

    def overtake(self) -> None:
        """Keep it from being sent, because a stop has come."""
        self.is_overtaken = True
        if not self.overtaken.done():
            self.overtaken.set_result(None)


@dataclass(slots=True)
class CommandBook:
    """All commands that the gate remembers; those that are finished are bounded, the oldest go."""

    _running: dict[str, Command] = field(default_factory=dict)
    _finished: OrderedDict[str, Command] = field(default_factory=OrderedDict)
    _of_node: dict[NodeId, dict[str, Command]] = field(default_factory=dict)
    _by_wire: dict[tuple[NodeId, int], Command] = field(default_factory=dict)
    _nodes_of_wire: dict[int, NodeId] = field(default_factory=dict)
    """For whom a number was, of those that are one biobot's."""
    _n_stops: int = 0

    def find(self, key: str) -> Command | None:
        """Return a command that is under way or remembered."""
        return self._running.get(key) or self._finished.get(key)

    def running(self) -> list[Command]:
        """Return all that are under way, in the order in which they came."""
        return list(self._running.values())

    def running_of(self, node: NodeId) -> list[Command]:
        """Return those of a biobot that are under way, in the order in which they came."""
        return list(self._of_node.get(node, {}).values())

    @property
    def n_running(self) -> int:
        """How many are under way, stops aside."""
        return len(self._running) - self._n_stops

    def begin(self, command: Command) -> None:
        """Take a command that is new."""
        key, node = command.key, command.request.node
        self._running[key] = command
        self._of_node.setdefault(node, {})[key] = command
        self._n_stops += command.is_stop

    def number(self, command: Command, wire_command: int) -> None:
        """Give a command its number on the wire; the parts of a stop of all share that of the whole."""
        command.wire_command = wire_command
        self._by_wire[command.request.node, wire_command] = command
        if not command.part_of and command.request.action is not StimulationAction.STOP_ALL:
            self._nodes_of_wire[wire_command] = command.request.node

    def answered(self, node: NodeId, wire_command: int) -> Command | None:
        """Return the command to a biobot that has a number on the wire."""
        return self._by_wire.get((node, wire_command))

    def strayed(self, node: NodeId, wire_command: int) -> Command | None:
        """Return the command of that number where it was for one other biobot."""
        meant = self._nodes_of_wire.get(wire_command)
        return None if meant is None or meant == node else self._by_wire.get((meant, wire_command))

    def finish(self, command: Command) -> None:
        """Take note that a command has its last stage, or never will."""
        key, node = command.key, command.request.node
        del self._running[key]
        self._n_stops -= command.is_stop
        of_node = self._of_node[node]
        del of_node[key]
        if not of_node:
            del self._of_node[node]
        self.remember(command)

    def remember(self, command: Command) -> None:
        """Keep a command that is finished, for as long as there is room."""
        command.listeners.clear()
        command.finished.set()
        self._finished[command.key] = command
        for forgotten in self._too_many():
            wire = forgotten.wire_command
            if wire is not None:
                self._by_wire.pop((forgotten.request.node, wire), None)
                self._nodes_of_wire.pop(wire, None)

    def _too_many(self) -> Iterator[Command]:
        while len(self._finished) > _MAX_REMEMBERED:
            yield self._finished.popitem(last=False)[1]


def is_same(one: StimulationRequest, other: StimulationRequest) -> bool:
    """Return whether a request repeats another one; it may have been issued anew."""
    return (one.node, one.action, one.hold_ms, one.pulse, one.commander) == (
        other.node,
        other.action,
        other.hold_ms,
        other.pulse,
        other.commander,
    )
