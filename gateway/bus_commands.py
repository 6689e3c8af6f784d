"""Commands and mission orders on their way from Zenoh's threads into the event loop, and the answers back.

Each kind waits in a queue of its own. Stops have theirs: they are handed over first, whatever else waits, and are refused only where so
many stops wait that nobody would hear of one more.
"""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

import msgspec
import zenoh

from firmware_protocol.contract.commands import CommandStage, StimulationAction, StimulationRequest
from firmware_protocol.contract.mission_orders import MissionAnswer, MissionOrder
from firmware_protocol.contract.records import Struct, decode_record, encode_record
from firmware_protocol.errors import RecordError
from gateway.bus_query import payload_of, refuse
from gateway.health import Health
from gateway.log import EventLog

_log = EventLog(__name__)

_MAX_COMMANDS = 256
_MAX_STOPS = 4096
"""Stops that may wait: sixteen times what any other command is granted."""

_MAX_ORDERS = 64
_MAX_NAME = 64
_AT_ONCE = 8
"""Commands that the loop takes at a time, so that a stop that comes meanwhile waits for no more than these."""

STOPS = frozenset({StimulationAction.STOP, StimulationAction.STOP_ALL})
_AskedT = TypeVar("_AskedT")
_AnswerT = TypeVar("_AnswerT")


class CommandAnswer:
    """Where the stages of one command go; may be called from the loop only. It is made when the command comes in."""

    def __init__(self, *, query: zenoh.Query, key: str, executor: ThreadPoolExecutor) -> None:
        self.came_ns = time.monotonic_ns()
        self._query = query
        self._key = key
        self._executor = executor

    def tell(self, stage: CommandStage) -> None:
        """Reply with a stage; the final one ends the query."""
        self._executor.submit(_reply, self._query, self._key, stage, is_last=stage.is_final)


class OrderAnswer:
    """Where the answer to one mission order goes; may be called from the loop only."""

    def __init__(self, *, query: zenoh.Query, key: str, executor: ThreadPoolExecutor) -> None:
        self._query = query
        self._key = key
        self._executor = executor

    def tell(self, answer: MissionAnswer) -> None:
        """Reply, and end the query."""
        self._executor.submit(_reply, self._query, self._key, answer, is_last=True)


CommandTaker = Callable[[StimulationRequest, CommandAnswer], None]
OrderTaker = Callable[[MissionOrder, OrderAnswer], None]
TurnedAwayListener = Callable[[bytes, str], None]
"""Hears, on a thread of Zenoh, the octets of a query that was no command and no order, or one too many, and why."""


class CommandDoor:
    """Takes commands on Zenoh's threads, and hands them to the loop: stops first, the others a few at a time."""

    def __init__(
        self,
        *,
        loop: asyncio.AbstractEventLoop,
        key: str,
        executor: ThreadPoolExecutor,
        health: Health,
        on_command: CommandTaker,
        on_turned_away: TurnedAwayListener | None = None,
    ) -> None:
        self._key = key
        self._on_turned_away = on_turned_away
        self._executor = executor
        self._health = health
        self._stops = _Lane(loop=loop, take=on_command, at_once=_MAX_STOPS, limit=_MAX_STOPS)
        self._others = _Lane(loop=loop, take=on_command, at_once=_AT_ONCE, limit=_MAX_COMMANDS, before=self._stops.hand_over)

    def __len__(self) -> int:
        """Return how many wait, stops among them."""
        return len(self._stops) + len(self._others)

    def take(self, query: zenoh.Query) -> None:
        """Runs on a thread of Zenoh."""
        octets = payload_of(query)
        try:
            request = read_command(octets)
        except RecordError as error:
            _turn_away(query, octets, str(error), health=self._health, listener=self._on_turned_away)
            return
        lane = self._stops if request.action in STOPS else self._others
        if not lane.append(request, CommandAnswer(query=query, key=self._key, executor=self._executor)):
            reason = f"{lane.limit} commands wait already; try again"
            _turn_away(query, octets, reason, health=self._health, listener=self._on_turned_away)

    def hand_over_stops(self) -> None:
        """Hand over the stops that wait, in the loop."""
        self._stops.hand_over()


class OrderDoor:
    """Takes mission orders on Zenoh's threads, and hands them to the loop, after the stops that wait."""

    def __init__(
        self,
        *,
        loop: asyncio.AbstractEventLoop,
        key: str,
        executor: ThreadPoolExecutor,
        health: Health,
        on_order: OrderTaker,
        before: Callable[[], None],
        on_turned_away: TurnedAwayListener | None = None,
    ) -> None:
        self._key = key
        self._on_turned_away = on_turned_away
        self._executor = executor
        self._health = health
        self._orders = _Lane(loop=loop, take=on_order, at_once=_AT_ONCE, limit=_MAX_ORDERS, before=before)

    def take(self, query: zenoh.Query) -> None:
        """Runs on a thread of Zenoh."""
        octets = payload_of(query)
        try:
            order = decode_record(octets, MissionOrder)
        except RecordError as error:
            _turn_away(query, octets, str(error), health=self._health, listener=self._on_turned_away)
            return
        if not self._orders.append(order, OrderAnswer(query=query, key=self._key, executor=self._executor)):
            reason = f"{self._orders.limit} mission orders wait already; try again"
            _turn_away(query, octets, reason, health=self._health, listener=self._on_turned_away)


class _Lane(Generic[_AskedT, _AnswerT]):
    """A bounded queue from any thread into the loop; each time it is looked at, ``before`` is called first."""

    def __init__(
        self,
        *,
        loop: asyncio.AbstractEventLoop,
        take: Callable[[_AskedT, _AnswerT], None],
        at_once: int,
        limit: int,
        before: Callable[[], None] | None = None,
    ) -> None:
        self._loop = loop
        self._take = take
        self._at_once = at_once
        self.limit = limit
        self._before = before
        self._lock = threading.Lock()
        self._waiting: deque[tuple[_AskedT, _AnswerT]] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def append(self, asked: _AskedT, answer: _AnswerT) -> bool:
        """Add one from any thread; False where it does not fit."""
        with self._lock:
            if len(self._waiting) >= self.limit:
                return False
            is_first = not self._waiting
            self._waiting.append((asked, answer))
        if is_first:
            self._loop.call_soon_threadsafe(self.hand_over)
        return True

    def hand_over(self) -> None:
        """Hand over what waits, in the loop; what is left waits for its next turn."""
        if self._before is not None:
            self._before()
        with self._lock:
            items = [self._waiting.popleft() for _ in range(min(self._at_once, len(self._waiting)))]
            has_more = bool(self._waiting)
        for asked, answer in items:
            self._take(asked, answer)
        if has_more:
            self._loop.call_soon(self.hand_over)


def read_command(octets: bytes) -> StimulationRequest:
    """Return a command. Who gives a stop is no reason to refuse it: a name that is none is "unknown", one that is too long is cut.

    Raises
    ------
    RecordError
        It is none.
    """
    try:
        return decode_record(octets, StimulationRequest)
    except RecordError:
        try:
            said = msgspec.msgpack.decode(octets)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            said = None
        if not isinstance(said, dict) or said.get("action") not in {action.value for action in STOPS}:
            raise
        name = said.get("operator")
        named = {**said, "operator": (name[:_MAX_NAME] if isinstance(name, str) else "") or "unknown"}
        return decode_record(msgspec.msgpack.encode(named), StimulationRequest)


def _turn_away(query: zenoh.Query, octets: bytes, reason: str, *, health: Health, listener: TurnedAwayListener | None) -> None:
    if listener is not None:
        listener(octets, reason)
    refuse(query, reason, health=health)


def _reply(query: zenoh.Query, key: str, answer: Struct, *, is_last: bool) -> None:
    try:
        query.reply(key, encode_record(answer))
        if is_last:
            query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation
    except zenoh.ZError as error:
        _log.warning("bus.reply_lost", key=key, reason=str(error))
