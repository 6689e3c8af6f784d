"""Frames of starts and turns that may still come to a biobot after a stop has.

A dongle may try for seconds to deliver one frame and deliver the next at once. A stop does not reach what it has in hand already, and a
backpack that knows the stop's number takes its repetitions for answered. So a stop remembers what was on its way when it came.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_protocol.units import NodeId
from gateway.radio import Fate
from gateway.stimulation.commands import Command

_MAX_OF_ONE = 16
"""Of a biobot at most so many are remembered, the latest; limits and time-outs allow fewer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LateFrame:
    """A frame that may come to its biobot until ``latest_ns`` (monotonic)."""

    command: Command
    latest_ns: int

    def is_on_its_way(self, *, now_ns: int) -> bool:
        """Whether it may still come: nobody has answered it, and no radio says that it was not sent."""
        sending = self.command.sendings[0]
        is_unsent = sending.done() and not sending.cancelled() and sending.result().fate is Fate.NOT_SENT
        return not is_unsent and not self.command.reply.done() and now_ns < self.latest_ns


@dataclass(slots=True, kw_only=True)
class LateFrames:
    """Those of all biobots, and what each was told last."""

    now_ns: Callable[[], int]
    _frames: dict[NodeId, deque[LateFrame]] = field(default_factory=dict)
    _newest: dict[NodeId, Command] = field(default_factory=dict)

    def begin(self, command: Command) -> None:
        """Take note that a command is what its biobot was told last."""
        self._newest[command.request.node] = command

    def is_newest(self, command: Command) -> bool:
        """Whether its biobot was told nothing since."""
        return self._newest.get(command.request.node) is command

    def add(self, command: Command, *, latest_ns: int) -> None:
        """Take note of a frame that was given to a radio."""
        frames = self._frames.setdefault(command.request.node, deque(maxlen=_MAX_OF_ONE))
        frames.append(LateFrame(command=command, latest_ns=latest_ns))
        self.begin(command)

    def of(self, node: NodeId) -> list[LateFrame]:
        """Return those that may still come to a biobot."""
        now_ns = self.now_ns()
        on_their_way = [frame for frame in self._frames.get(node, ()) if frame.is_on_its_way(now_ns=now_ns)]
        if on_their_way:
            self._frames[node] = deque(on_their_way, maxlen=_MAX_OF_ONE)
        else:
            self._frames.pop(node, None)
        return on_their_way
