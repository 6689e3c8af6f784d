"""What became of commands: those given here, and those that gateways tell of, whoever gave them. The newest are remembered."""

import asyncio
import time
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from firmware_protocol.contract.commands import CommandStage, Refusal, StimulationAction, StimulationRequest
from firmware_protocol.units import NodeId
from mapper.changes import Changes, Topic
from mapper.errors import CommandNotFoundError

KEPT: Final = 1000
"""Commands of each kind: given here, given elsewhere, and parts of a stop of all."""

# Of one command; a gateway tells at most three, and one for each end that it reconsidered.
_MAX_STAGES: Final = 32
_MAX_GATEWAYS: Final = 1024


class Outcome(StrEnum):
    """How a command ended; the first four are the gateway's words (CONTRACT.md), the last means that it was not there."""

    BIOBOT_CONFIRMED = "biobot_confirmed"
    REFUSED = "refused"
    FAILED = "failed"
    UNKNOWN = "unknown"
    UNDELIVERED = "undelivered"


# The outcome of what was given to several gateways is that of the one that is worst off.
_WORST_FIRST: Final = (Outcome.UNDELIVERED, Outcome.UNKNOWN, Outcome.FAILED, Outcome.REFUSED, Outcome.BIOBOT_CONFIRMED)


@dataclass(slots=True, kw_only=True)
class Answer:
    """What one gateway told of a command; ``outcome`` is None while more is to come."""

    stages: list[CommandStage] = field(default_factory=list)
    outcome: Outcome | None = None
    reason: str = ""
    refusal: Refusal | None = None
    is_final: bool = False
    """The gateway said so itself: it is not judged here any more."""


@dataclass(slots=True, kw_only=True)
class Command:
    """A command and what became of it so far.

    ``gateway`` is None for one given to all. ``request`` is None for one given elsewhere, of which only its stages are known.
    """

    command_id: str
    node: NodeId
    action: StimulationAction
    operator: str
    gateway: str | None
    began_wall_ns: int
    request: StimulationRequest | None = None
    part_of: str = ""
    answers: dict[str, Answer] = field(default_factory=dict)
    is_closed: bool = False
    """Nothing more is awaited."""
    is_unheard: bool = False
    """It was given to all, and nobody was there."""
    nearest: str | None = None
    """Of the gateways that were asked for one biobot, the one that heard it last."""

    @property
    def stages(self) -> list[CommandStage]:
        """All stages, those of one gateway together."""
        return [stage for answer in self.answers.values() for stage in answer.stages]

    @property
    def silent(self) -> list[str]:
        """The gateways that were asked and told nothing yet."""
        return [name for name, answer in self.answers.items() if not answer.stages]

    @property
    def unfinished(self) -> list[str]:
        """The gateways that have not said how it ended."""
        return [name for name, answer in self.answers.items() if not answer.is_final]

    @property
    def is_answered(self) -> bool:
        """Every gateway that was asked has said how it ended."""
        return bool(self.answers) and not self.unfinished

    @property
    def is_done(self) -> bool:
        """Nobody need be asked about this stop any more: all have answered and, where it is for one biobot, that biobot has it."""
        if not self.is_answered:
            return False
        return self.action is not StimulationAction.STOP or Outcome.BIOBOT_CONFIRMED in {answer.outcome for answer in self.answers.values()}

    @property
    def is_settled(self) -> bool:
        """Of no gateway that it concerns more is awaited."""
        answers = self._answers_that_count
        return all(answer.outcome is not None for answer in answers) if answers else self.is_closed or self.is_unheard

    @property
    def outcome(self) -> Outcome | None:
        """How it ended at the gateways that it concerns, the worst of it; None while it is under way.

        A stop of one biobot that several gateways were asked for is done when any of them has its word.
        """
        answers = self._answers_that_count
        if not answers:
            return Outcome.UNDELIVERED if self.is_closed or self.is_unheard else None
        outcomes = {answer.outcome for answer in answers}
        if self.action is StimulationAction.STOP and Outcome.BIOBOT_CONFIRMED in outcomes:
            return Outcome.BIOBOT_CONFIRMED
        if self.action is StimulationAction.STOP and None not in outcomes and Outcome.UNKNOWN in outcomes:
            return Outcome.UNKNOWN  # another gateway may have stopped it, so nobody can say that it was not delivered
        return None if None in outcomes else next(outcome for outcome in _WORST_FIRST if outcome in outcomes)

    @property
    def reason(self) -> str:
        """Why it ended so, by gateway where there are several."""
        if not self.answers:
            return "" if self.outcome is None else "no gateway is on the bus"
        outcome = self.outcome
        told = {name: answer.reason for name, answer in self.answers.items() if answer.outcome is outcome and answer.reason}
        if self.gateway is not None or len(self.answers) == 1:
            return next(iter(told.values()), "")
        return "; ".join(f"{name}: {reason}" for name, reason in told.items())

    @property
    def refusal(self) -> Refusal | None:
        """Why the gateway refused it, for programs."""
        return next((answer.refusal for answer in self._answers_that_count if answer.refusal is not None), None)

    @property
    def _answers_that_count(self) -> list[Answer]:
        # A stop given to all because nobody here knew whose the biobot is: those that do not know it have no part in it.
        concerned = [answer for answer in self.answers.values() if answer.refusal is not Refusal.UNKNOWN_BIOBOT]
        return concerned or list(self.answers.values())

    def take(self, stage: CommandStage) -> bool:
        """Take a stage in; False for one that was told before, or is of another command under the same id."""
        if (stage.node, stage.action) != (self.node, self.action):
            return False
        if stage.gateway not in self.answers and len(self.answers) >= _MAX_GATEWAYS:
            return False
        answer = self.answers.setdefault(stage.gateway, Answer())
        is_told = any(known.stage is stage.stage for known in answer.stages)
        if is_told or answer.is_final or len(answer.stages) >= _MAX_STAGES:
            return False
        answer.stages.append(stage)
        if stage.is_final:
            answer.outcome = Outcome(stage.stage.value)
        elif answer.outcome is not None or self.is_closed:
            answer.outcome = Outcome.UNKNOWN if self.is_closed else None
        answer.is_final = stage.is_final
        answer.reason, answer.refusal = stage.reason, stage.refusal
        return True

    def settle(self, *, outcome: Outcome, reason: str, gateways: Iterable[str]) -> None:
        """Say how it ended where no gateway says it; what a gateway says later counts all the same."""
        for name in gateways:
            answer = self.answers.setdefault(name, Answer())
            if answer.outcome is None:
                answer.outcome, answer.reason = outcome, reason

    def reopen(self) -> None:
        """Await the gateways again that gave it no end."""
        self.is_closed = self.is_unheard = False
        for answer in self.answers.values():
            if not answer.is_final:
                answer.outcome, answer.reason = None, ""


class CommandLog:
    """Commands by id. Who waits for one is woken by what is told of that one: a stop of all tells of hundreds at once."""

    def __init__(self, *, changes: Changes, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self._changes = changes
        self._wall_ns = wall_ns
        self._listeners: list[Callable[[CommandStage], None]] = []
        self._own: OrderedDict[str, Command] = OrderedDict()
        self._foreign: OrderedDict[str, Command] = OrderedDict()
        self._parts: OrderedDict[str, Command] = OrderedDict()
        self._waiting: defaultdict[str, set[asyncio.Event]] = defaultdict(set)
        """Who waits for a command, by its id."""

    def listen(self, listener: Callable[[CommandStage], None]) -> None:
        """Have each stage told once, of whichever command it is."""
        self._listeners.append(listener)

    def add(self, request: StimulationRequest, *, gateway: str | None, asked: Iterable[str], nearest: str | None = None) -> Command:
        """Remember a command that is given here; ``asked`` are the gateways of which an answer is awaited."""
        command = Command(
            command_id=request.command_id,
            node=request.node,
            action=request.action,
            operator=request.operator,
            gateway=gateway,
            began_wall_ns=self._wall_ns(),
            request=request,
            answers={name: Answer() for name in asked},
            nearest=nearest,
        )
        _remember(self._own, command)
        self.tell(command)
        return command

    def take(self, stage: CommandStage) -> None:
        """Take in what a gateway tells of a command, as an answer or as a publication: the second of both changes nothing."""
        command = self.find(stage.command_id)
        if command is None:
            command = Command(
                command_id=stage.command_id,
                node=stage.node,
                action=stage.action,
                operator=stage.operator,
                gateway=None if stage.action is StimulationAction.STOP_ALL else stage.gateway,
                began_wall_ns=self._wall_ns(),
                part_of=stage.part_of,
            )
            _remember(self._parts if stage.part_of else self._foreign, command)
        if command.take(stage):
            for listener in self._listeners:
                listener(stage)
            self.tell(command)

    def tell(self, command: Command) -> None:
        """Wake those who wait for a command."""
        self._changes.bump(Topic.COMMANDS)
        for waiting in self._waiting.get(command.command_id, ()):
            waiting.set()

    def find(self, command_id: str) -> Command | None:
        """Return a command by its id, or None."""
        return self._own.get(command_id) or self._foreign.get(command_id) or self._parts.get(command_id)

    def get(self, command_id: str) -> Command:
        """Return a command by its id.

        Raises
        ------
        CommandNotFoundError
            Nobody has told of it since the start, or it is forgotten.
        """
        command = self.find(command_id)
        if command is None:
            raise CommandNotFoundError(command_id=command_id, kept=KEPT)
        return command

    def recent(self, *, limit: int, part_of: str | None = None) -> list[Command]:
        """List the newest commands, the newest first: those given on their own, or the parts of a stop of all."""
        if part_of is not None:
            chosen = [command for command in self._parts.values() if command.part_of == part_of]
        else:
            chosen = [*self._own.values(), *self._foreign.values()]
        # Of those that came at one instant the later shall come first, too.
        return sorted(chosen, key=lambda command: command.began_wall_ns)[::-1][:limit]

    async def wait(self, is_met: Callable[[], bool], *, of: Iterable[Command], timeout_s: float | None = None) -> bool:
        """Wait until something is as wanted that changes with some commands; return whether it is."""
        names, news = [command.command_id for command in of], asyncio.Event()
        for name in names:
            self._waiting[name].add(news)
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):
                    while not is_met():
                        news.clear()
                        await news.wait()
        finally:
            for name in names:
                self._waiting[name].discard(news)
                if not self._waiting[name]:
                    del self._waiting[name]
        return is_met()


def _remember(table: OrderedDict[str, Command], command: Command) -> None:
    table[command.command_id] = command
    while len(table) > KEPT:
        table.popitem(last=False)


def has_ended(command: Command) -> bool:
    """Say whether nothing more is awaited of a command."""
    return command.outcome is not None


def is_taken(command: Command) -> bool:
    """Say whether every gateway that was asked has told something, or nothing more is awaited."""
    return has_ended(command) or (bool(command.answers) and not command.silent)
