"""Commands to biobots: sent through the gateway that heard the biobot last, stops also to all, and followed to the end."""

import asyncio
import time
import uuid
from collections.abc import AsyncGenerator, Callable, Coroutine, Mapping
from contextlib import aclosing
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import msgspec

from firmware_protocol.contract.commands import CommandStage, PulseRequest, Refusal, StimulationAction, StimulationRequest
from firmware_protocol.units import EVERYBODY, Nanoseconds, NodeId
from mapper.bus import Bus
from mapper.command_log import Command, CommandLog, Outcome, has_ended
from mapper.commander import Commander
from mapper.errors import BiobotNotFoundError, CommandRefusedError, QueryError, TooManyError
from mapper.fleet import Fleet
from mapper.log import EventLog

_log = EventLog(__name__)

STOPS: Final = frozenset({StimulationAction.STOP, StimulationAction.STOP_ALL})

_Stages: TypeAlias = AsyncGenerator[CommandStage | QueryError, None]

_MAX_AT_ONCE: Final = 256
# Beyond its time to live a command may still wait for the biobot's confirmation, and a STOP is tried several times.
_PATIENCE_S: Final = 10.0
# A stop of all is confirmed by one biobot after the other.
_PATIENCE_FOR_ALL_S: Final = 60.0
# A gateway that told nothing of a stop is asked again: it may have been connected again meanwhile, or the question was lost.
_ASK_AGAIN_S: Final = 0.5
_ASKED_FOR_S: Final = 10.0
_MAX_INSISTED: Final = 1024
_TOKEN_WAIT_S: Final = 5.0
_LAST_STOPS_S: Final = 2.0
_LAST_OPERATOR: Final = "mapper-shutdown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What somebody wants a biobot, or (``node`` is EVERYBODY) all of them, to be told."""

    node: NodeId
    action: StimulationAction
    operator: str
    ttl_ms: int = 5_000
    hold_ms: int = 0
    pulse: PulseRequest | None = None
    command_id: str | None = None

    def is_that_of(self, request: StimulationRequest) -> bool:
        """Say whether a request is what this wish was made into."""
        mine = (self.node, self.action, self.operator, self.hold_ms, self.pulse)
        return mine == (request.node, request.action, request.operator, request.hold_ms, request.pulse)


class CommandDesk:
    """Sends commands; ``log`` remembers them."""

    def __init__(self, *, bus: Bus, fleet: Fleet, log: CommandLog, commander: Commander, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self.log = log
        self._bus = bus
        self._fleet = fleet
        self._commander = commander
        self._wall_ns = wall_ns
        self._group: asyncio.TaskGroup | None = None
        self._n_under_way = 0
        self._is_closing = False
        self._insisting: set[str] = set()
        self._held_back: dict[object, NodeId] = {}
        log.listen(commander.motion.heed)

    async def run(self) -> None:
        """Follow commands until cancelled: one whose sender hung up is followed all the same."""
        async with asyncio.TaskGroup() as self._group:
            await asyncio.Event().wait()

    async def submit(self, wish: Wish) -> Command:
        """Send a command; the same id again means the same command, which is not sent twice.

        One with a hold is controlled motion, with this mapper as its commander. A stop goes out at once, whatever else waits, and to
        all gateways where nobody here knows whose the biobot is.

        Raises
        ------
        BiobotNotFoundError
            No gateway has spoken of the biobot.
        CommandRefusedError
            The id is that of another command, or this mapper cannot be a commander now.
        TooManyError
            Too many commands are under way; a STOP is never held back for that.
        """
        if wish.action in STOPS:
            return self.stop(wish)
        known = self._known(wish)
        if known is not None:
            return known
        gateway = self._fleet.gateway_of(wish.node)
        if gateway is None:
            raise BiobotNotFoundError(biobot=wish.node)
        if self._n_under_way >= _MAX_AT_ONCE:
            raise TooManyError(what="commands are under way", limit=_MAX_AT_ONCE)
        issued_wall_ns = self._wall_ns()
        commander = await self._commander_for(wish) if wish.hold_ms else ""
        known = self._known(wish)  # a second one of the same id may have waited for the same
        if known is not None:
            return known
        request = self._request(wish, commander=commander, issued_wall_ns=issued_wall_ns)
        command = self.log.add(request, gateway=gateway, asked=[gateway])
        self._let_go_of_stops(wish.node)
        self._commander.motion.begin(request, now_ns=time.monotonic_ns())
        self._n_under_way += 1
        timeout_s = request.ttl_ms / 1000 + _PATIENCE_S
        self._start(self._follow(command, self._ask(request, gateway=gateway, timeout_s=timeout_s)), command)
        return command

    def stop(self, wish: Wish) -> Command:
        """Send a stop now: nothing is waited for, and no limit asked. Under an id that another command has, it gets one of its own."""
        try:
            known = self._known(wish)
        except CommandRefusedError:
            known, wish = None, replace(wish, command_id=uuid.uuid4().hex)
        if known is not None:
            return known
        is_for_all = wish.action is StimulationAction.STOP_ALL
        self._held_back = {token: node for token, node in self._held_back.items() if not is_for_all and node != wish.node}
        # Whoever has ever heard it may be who reaches it now; where nobody is there who has, all are asked.
        hearers = [] if is_for_all else [name for name in self._fleet.hearers_of(wish.node) if self._is_there(name)]
        nearest = hearers[0] if hearers else None
        request = self._request(wish, commander="", issued_wall_ns=self._wall_ns())
        timeout_s = _PATIENCE_FOR_ALL_S if is_for_all else request.ttl_ms / 1000 + _PATIENCE_S
        names: list[str | None] = [*hearers] if hearers else [None]
        asking = {name: self._ask(_stop_for(request, name, nearest=nearest), gateway=name, timeout_s=timeout_s) for name in names}
        asked = hearers or self._fleet.gateways_heard()
        command = self.log.add(request, gateway=nearest if len(hearers) == 1 else None, asked=asked, nearest=nearest)
        self._start(self._insist(command, asking, timeout_s=timeout_s), command)
        return command

    def insist(self, command: Command) -> None:
        """Ask once more about a stop that not all gateways have answered; that it is known to those that have does no harm."""
        request = command.request
        if request is None or command.is_answered or not command.is_closed:
            return
        command.reopen()
        timeout_s = _PATIENCE_FOR_ALL_S if command.nearest is None else request.ttl_ms / 1000 + _PATIENCE_S
        names: list[str | None] = [None] if command.nearest is None else [*command.unfinished]
        asking = {name: self._ask(_stop_for(request, name, nearest=command.nearest), gateway=name, timeout_s=timeout_s) for name in names}
        self._start(self._insist(command, asking, timeout_s=timeout_s), command)

    async def release(self) -> None:
        """Stop whom this mapper moves, wait a little for the answers, and move nobody any more."""
        self._is_closing = True
        nodes = self._commander.motion.nodes(now_ns=time.monotonic_ns())
        stops = [self.stop(Wish(node=node, action=StimulationAction.STOP, operator=_LAST_OPERATOR)) for node in nodes]
        if stops:
            await self.log.wait(lambda: all(map(has_ended, stops)), of=stops, timeout_s=_LAST_STOPS_S)
            outcomes = [str(stop.outcome or "unknown") for stop in stops]
            _log.info("commander.released", biobots=len(nodes), confirmed=outcomes.count(str(Outcome.BIOBOT_CONFIRMED)))

    async def _commander_for(self, wish: Wish) -> str:
        """Return who is the commander of controlled motion, once gateways can see it."""
        token = object()
        self._held_back[token] = wish.node
        try:
            is_there = await self._commander.wait_until_there(timeout_s=min(wish.ttl_ms / 1000, _TOKEN_WAIT_S))
            refusal, reason = None, ""
            if token not in self._held_back:
                refusal, reason = Refusal.OVERTAKEN, "a stop of this biobot came before it was sent; give it anew if it is still wanted"
            elif self._is_closing:
                refusal, reason = Refusal.STOPPING, "this mapper is about to end; start it again first"
            elif not is_there:
                refusal = Refusal.NO_COMMANDER
                reason = "a hold needs a commander, and this mapper has not joined the bus under its name yet; try again in a few seconds"
        finally:
            self._held_back.pop(token, None)
        if refusal is not None:
            raise CommandRefusedError(command_id=wish.command_id or "", reason=reason, refusal=refusal)
        return self._commander.name

    def _let_go_of_stops(self, node: NodeId) -> None:
        """Repeat no stop of a biobot that is told something else now; one of all is repeated all the same."""
        stops = [self.log.find(command_id) for command_id in self._insisting]
        self._insisting -= {stop.command_id for stop in stops if stop is not None and stop.node == node}

    def _known(self, wish: Wish) -> Command | None:
        """Return the command of this id, or None for a new one."""
        known = None if wish.command_id is None else self.log.find(wish.command_id)
        if known is None:
            return None
        if known.request is None or not wish.is_that_of(known.request):
            raise CommandRefusedError(
                command_id=known.command_id, reason="its id was used for another command; choose a new id", refusal=Refusal.ID_REUSED
            )
        return known

    def _request(self, wish: Wish, *, commander: str, issued_wall_ns: int) -> StimulationRequest:
        return StimulationRequest(
            command_id=wish.command_id or uuid.uuid4().hex,
            node=EVERYBODY if wish.action is StimulationAction.STOP_ALL else wish.node,
            action=wish.action,
            operator=wish.operator,
            issued_wall_ns=Nanoseconds(issued_wall_ns),
            ttl_ms=wish.ttl_ms,
            hold_ms=wish.hold_ms,
            commander=commander,
            pulse=wish.pulse,
        )

    def _ask(self, request: StimulationRequest, *, gateway: str | None, timeout_s: float) -> _Stages:
        return self._bus.send_command(request, gateway=gateway, timeout_s=timeout_s)

    def _start(self, following: Coroutine[None, None, None], command: Command) -> None:
        assert self._group is not None  # whatever may give commands is started after `run`
        self._group.create_task(following, name=f"command {command.command_id}")
        operator = command.operator
        _log.info("command.sent", id=command.command_id, biobot=command.node, action=command.action.value, operator=operator)

    async def _follow(self, command: Command, stages: _Stages) -> None:
        """Take in what the gateway tells until it is final."""
        try:
            fault = await self._take_in(command, stages)
            for name in command.answers:
                self._settle(command, name, fault)
        finally:
            self._n_under_way -= 1
            self._end(command)

    async def _insist(self, command: Command, first: Mapping[str | None, _Stages], *, timeout_s: float) -> None:
        """Follow a stop, and ask gateways that tell nothing again and again, for a while; until they do, they count as away."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        faults: dict[str | None, QueryError | None] = {}
        request = command.request
        assert request is not None

        n_open = 0

        async def follow(name: str | None, stages: _Stages) -> None:
            nonlocal n_open
            n_open += 1
            faults[name] = await self._take_in(command, stages)
            n_open -= 1
            self.log.tell(command)

        def judge(names: list[str]) -> None:
            command.is_unheard = not command.answers
            for name in names:
                fault = faults.get(name, faults.get(None)) if self._is_there(name) else None
                self._settle(command, name, fault)
            self.log.tell(command)

        if len(self._insisting) < _MAX_INSISTED:
            self._insisting.add(command.command_id)
        try:
            async with asyncio.TaskGroup() as group:
                asking = [group.create_task(follow(name, stages)) for name, stages in first.items()]
                await asyncio.sleep(0)  # it has begun
                while not command.is_done and loop.time() - begun_s < _ASKED_FOR_S and command.command_id in self._insisting:
                    if await self.log.wait(lambda: command.is_answered or n_open == 0, of=[command], timeout_s=_ASK_AGAIN_S):
                        judge(command.unfinished)
                        await self.log.wait(lambda: command.is_done, of=[command], timeout_s=_ASK_AGAIN_S)
                    if command.command_id not in self._insisting:
                        break  # while this waited its biobot was told something else, which an old stop must not undo
                    asking += [
                        group.create_task(
                            follow(name, self._ask(_stop_for(request, name, nearest=command.nearest), gateway=name, timeout_s=timeout_s))
                        )
                        for name in self._untold(command, is_idle=n_open == 0)
                    ]
                if command.command_id in self._insisting:
                    judge(command.silent)
                await self.log.wait(lambda: command.is_answered or n_open == 0, of=[command], timeout_s=timeout_s)
                for one in asking:
                    one.cancel()
            judge(command.unfinished)
        finally:
            self._insisting.discard(command.command_id)
            self._end(command)

    def _untold(self, command: Command, *, is_idle: bool) -> list[str]:
        """Name the gateways on the bus that told nothing of a stop, and (nothing is asked any more) no end of it.

        Where it is for all, those that came since it was given are among them; where it is for one, those that came to hear the biobot.
        """
        if command.is_done:
            return []
        near = self._fleet.gateways_heard() if command.gateway is None else self._fleet.hearers_of(command.node)
        late = [name for name in near if name not in command.answers]
        return [name for name in [*(command.unfinished if is_idle else command.silent), *late] if self._is_there(name)]

    def _is_there(self, gateway: str) -> bool:
        # A connection that is lost is known sooner than whose tokens were behind it.
        return self._bus.is_connected and self._fleet.is_on_bus(gateway)

    async def _take_in(self, command: Command, stages: _Stages) -> QueryError | None:
        """Take in the answers of one question; return what was wrong with them, if anything."""
        fault = None
        async with aclosing(stages):
            async for stage in stages:
                if isinstance(stage, QueryError):
                    fault = stage
                    continue
                self.log.take(stage)
                if command.gateway is not None and stage.is_final:
                    break
        return fault

    def _settle(self, command: Command, gateway: str, fault: QueryError | None) -> None:
        """Judge a command at a gateway that gave it no end.

        One that had begun to act and is silent now may have done it: whether the biobot got the command, nobody here knows.
        """
        if command.answers[gateway].stages:
            outcome, reason = Outcome.UNKNOWN, str(fault) if fault else "the gateway's answer broke off"
        elif fault is not None:
            outcome, reason = Outcome.UNKNOWN if fault.is_timeout else Outcome.FAILED, str(fault)
        elif self._is_there(gateway):
            outcome, reason = Outcome.UNKNOWN, "the gateway is on the bus, but told nothing of it"
        else:
            outcome, reason = Outcome.UNDELIVERED, "the gateway is not on the bus"
        command.settle(outcome=outcome, reason=reason, gateways=[gateway])

    def _end(self, command: Command) -> None:
        silent = [name for name, answer in command.answers.items() if answer.outcome is None]
        command.settle(outcome=Outcome.UNKNOWN, reason="the mapper was stopped", gateways=silent)
        command.is_closed = True
        if command.outcome in {Outcome.REFUSED, Outcome.UNDELIVERED}:
            self._commander.motion.forget(node=command.node, command_id=command.command_id)
        self.log.tell(command)
        _log.info("command.ended", id=command.command_id, biobot=command.node, outcome=str(command.outcome), reason=command.reason)


def _stop_for(request: StimulationRequest, gateway: str | None, *, nearest: str | None) -> StimulationRequest:
    """Return a stop as a gateway is asked for it: one gateway alone may give a train with it, for none knows of the others' trains."""
    if nearest is None or gateway == nearest:
        return request
    return msgspec.structs.replace(request, pulse=PulseRequest(duration_ms=0))
