"""The emergency stop: of all biobots at every gateway of the site, or of some. It goes out before anything is waited for.

Nothing holds it back: no limit, no queue, no map, no store. What it is answered with is what gateways have told by then.
"""

import uuid
from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

from firmware_protocol.contract.commands import StimulationAction
from firmware_protocol.units import EVERYBODY, NodeId
from mapper.command_log import Command, has_ended
from mapper.commands import CommandDesk, Wish
from mapper.log import EventLog

_log = EventLog(__name__)

MAX_STOP_ID: Final = 40
"""Characters: the commands of a stop of some biobots are named for it and the biobot."""

_KEPT: Final = 100
_FIRST_WORDS_S: Final = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A stop; ``biobots`` is None for one of all."""

    stop_id: str
    operator: str
    biobots: tuple[NodeId, ...] | None
    commands: tuple[Command, ...]

    @property
    def is_taken(self) -> bool:
        """Every gateway that was asked has told something."""
        return all(not command.silent and command.answers for command in self.commands)

    @property
    def has_ended(self) -> bool:
        """All that it is for have stopped, or nothing more is awaited."""
        return all(map(has_ended, self.commands))

    @property
    def is_settled(self) -> bool:
        """Of no gateway more is awaited."""
        return all(command.is_settled for command in self.commands)

    @property
    def silent(self) -> list[str]:
        """The gateways that were asked and told nothing."""
        return sorted({name for command in self.commands for name in command.silent})


class EmergencyStop:
    """Gives stops, and remembers the newest hundred by their ids."""

    def __init__(self, desk: CommandDesk) -> None:
        self._desk = desk
        self._stops: OrderedDict[str, Stop] = OrderedDict()

    def stop(self, *, operator: str, biobots: tuple[NodeId, ...] | None = None, stop_id: str | None = None) -> Stop:
        """Stop all biobots, or some, now. The same id again means the same stop: gateways that told nothing of it are asked once more.

        Under an id that another stop has, this one gets an id of its own.
        """
        known = None if stop_id is None else self._stops.get(stop_id)
        if known is not None and known.biobots != biobots:
            known, stop_id = None, None
        if known is not None:
            for command in known.commands:
                self._desk.insist(command)
            return known
        name = stop_id or uuid.uuid4().hex
        made = Stop(stop_id=name, operator=operator, biobots=biobots, commands=tuple(self._give(name, operator=operator, biobots=biobots)))
        self._stops[name] = made
        while len(self._stops) > _KEPT:
            self._stops.popitem(last=False)
        _log.warning("stop.given", id=name, operator=operator, biobots="all" if biobots is None else len(biobots))
        return made

    async def wait(self, stop: Stop, *, wait_s: float | None) -> None:
        """Wait for the end of a stop, or (None) for what gateways say first, which is not long in coming."""
        if wait_s is None:
            await self._desk.log.wait(lambda: stop.is_taken or stop.is_settled, of=stop.commands, timeout_s=_FIRST_WORDS_S)
        elif wait_s > 0:
            await self._desk.log.wait(lambda: stop.has_ended, of=stop.commands, timeout_s=wait_s)

    def _give(self, name: str, *, operator: str, biobots: tuple[NodeId, ...] | None) -> list[Command]:
        if biobots is None:
            return [self._desk.stop(Wish(node=EVERYBODY, action=StimulationAction.STOP_ALL, operator=operator, command_id=name))]
        return [
            self._desk.stop(Wish(node=node, action=StimulationAction.STOP, operator=operator, command_id=f"{name}.{node}"))
            for node in biobots
        ]
