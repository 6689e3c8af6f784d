"""The one gate for commands to living animals: admits, limits, expires, confirms, and journals all of it.

A command is journaled before it is sent; where the disk does not take it, it is refused. STOP alone is sent first and journaled
after, whatever its age and whatever the limits say, ahead of all that waits, and again until the biobot confirms it. No other
command is ever sent twice: without an answer its outcome is unknown, and says so.
"""

import asyncio
import contextlib
import secrets
import sqlite3
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import Mode, decode_record, encode_record
from firmware_protocol.errors import RecordError
from firmware_protocol.messages import Action, Capability, Stimulate, StimulateReply, StimulationResult
from firmware_protocol.units import NS_PER_MS, NS_PER_S, Nanoseconds, NodeId
from gateway.config import StimulationTable
from gateway.downlink import DownlinkSender
from gateway.errors import JournalFullError, RadioUnavailableError
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import AuditEntry, JournalReader, JournalWrite
from gateway.log import EventLog
from gateway.nodes import Node, NodeBook, mode_of
from gateway.pulse_limits import WAVEFORMS, pulse_refusal
from gateway.radio import Fate, RadioOutcome
from gateway.train_ledger import TrainLedger

_log = EventLog(__name__)

_MAX_RUNNING = 256
_MAX_REMEMBERED = 1024
_COMMIT_TIMEOUT_S = 1.0
"""A command that is not on disk after this is refused: the disk is full or broken."""

_MAX_TTL_MS = 0xFFFF
_MAX_NODE = 0xFFFE  # WIRE_FORMAT.md §1; 0xFFFF is everybody
_SENT_AGAIN = "sent_again"
"""Audit row of a STOP that was sent once more: a train that counts, and no stage that anybody is told."""

_ACTIONS = {
    StimulationAction.START: Action.START,
    StimulationAction.STOP: Action.STOP,
    StimulationAction.TURN_LEFT: Action.TURN_LEFT,
    StimulationAction.TURN_RIGHT: Action.TURN_RIGHT,
}

StageListener = Callable[[CommandStage], None]


@dataclass(slots=True, kw_only=True)
class _Command:
    """A command under way, or finished and remembered."""

    request: StimulationRequest
    wire_command: int | None = None
    stages: list[CommandStage] = field(default_factory=list)
    listeners: list[StageListener] = field(default_factory=list)
    reply: "asyncio.Future[StimulateReply]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    finished: asyncio.Event = field(default_factory=asyncio.Event)


class StimulationGate:
    """Takes every command; see the module's description. Belongs to one event loop."""

    def __init__(
        self,
        *,
        gateway: str,
        config: StimulationTable,
        sender: DownlinkSender,
        nodes: NodeBook,
        journal: Journal,
        reader: JournalReader,
        health: Health,
        wall_clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._gateway = gateway
        self._config = config
        self._sender = sender
        self._nodes = nodes
        self._journal = journal
        self._reader = reader
        self._health = health
        self._wall_clock = wall_clock
        self._ledger = TrainLedger(limits=config)
        self._running: dict[str, _Command] = {}
        self._finished: OrderedDict[str, _Command] = OrderedDict()
        self._by_wire: dict[tuple[NodeId, int], _Command] = {}
        last = reader.read_last_wire_command()
        # A new journal must not begin at a number that a backpack remembers from an old one.
        self._next_wire = secrets.randbits(31) if last is None else last + 1
        self._heard_by: list[Callable[[StimulationRequest, CommandStage], None]] = []
        self._restore_ledger()

    def listen(self, listener: Callable[[StimulationRequest, CommandStage], None]) -> None:
        """Have every stage of every command told to ``listener``, in the loop."""
        self._heard_by.append(listener)

    async def handle(self, request: StimulationRequest, listener: StageListener) -> None:
        """Take a command; ``listener`` hears each stage, the last one final. A known id is answered again, not obeyed again."""
        try:
            await self._handle(request, listener)
        except Exception as error:  # noqa: BLE001  # one command's fault must not end the gateway, which stops the other animals
            self._health.count("command.broken")
            reason = f"{type(error).__name__}: {error}"
            _log.error("command.broken", command=request.command_id, node=request.node, action=request.action.value, reason=reason)
            with contextlib.suppress(Exception):  # the listener may be what is broken
                listener(self._stage(request, Stage.UNKNOWN, reason=f"the gateway failed at it ({reason}); it may have been obeyed"))

    async def _handle(self, request: StimulationRequest, listener: StageListener) -> None:
        try:
            known = self._running.get(request.command_id) or self._finished.get(request.command_id) or self._recall(request.command_id)
        except (sqlite3.Error, RecordError) as error:
            self._health.count("command.unread_journal")
            _log.error("command.unread_journal", command=request.command_id, action=request.action.value, reason=str(error))
            if request.action is not StimulationAction.STOP:
                reason = f"the journal cannot be read ({error}), so it is not known whether this command was obeyed before"
                listener(self._stage(request, Stage.REFUSED, reason=reason))
                return
            known = None  # to stop once more does no harm
        if known is not None:
            self._health.count("command.repeated")
            if not _is_same(known.request, request):
                reason = "this command id was used for another command; give each command its own"
                listener(self._stage(request, Stage.REFUSED, reason=reason))
                return
            for stage in list(known.stages):
                listener(stage)
            if not known.finished.is_set():
                known.listeners.append(listener)
                await known.finished.wait()
            return
        command = _Command(request=request, listeners=[listener])
        self._running[request.command_id] = command
        try:
            await self._run(command)
        finally:
            self._finish(command)

    def on_reply(self, node: NodeId, reply: StimulateReply) -> None:
        """Take a biobot's answer, after it is on disk."""
        command = self._by_wire.get((node, reply.command))
        if command is None:
            self._health.count("command.late_replies")
        elif not command.reply.done():
            command.reply.set_result(reply)

    def abandon(self) -> None:
        """Give every command under way its last answer: the gateway stops, and what became of it will not be known."""
        for command in list(self._running.values()):
            self._tell_now(command, Stage.UNKNOWN, reason="the gateway was stopped before the answer came; it may have been obeyed")

    async def _run(self, command: _Command) -> None:
        request = command.request
        refusal = self._refusal(request)
        if refusal is not None:
            await self._tell(command, Stage.REFUSED, reason=refusal)
            return
        command.wire_command = self._next_wire % (1 << 32)
        self._next_wire += 1
        self._by_wire[request.node, command.wire_command] = command
        if request.action is StimulationAction.STOP:
            await self._stop(command)
        else:
            await self._stimulate(command)

    async def _stop(self, command: _Command) -> None:
        """Send first, journal after, and send again until the biobot confirms."""
        message = self._message(command, ttl_ms=_MAX_TTL_MS)
        was_sent = False
        reason = ""
        for attempt in range(self._config.stop_attempts):
            sendings: list[asyncio.Future[RadioOutcome]] = []
            try:
                sendings = self._sender.send_everywhere(command.request.node, message)
                was_sent = True
            except RadioUnavailableError as error:
                reason = str(error)
            # Firmware that stops by a train gives one for each frame: it is never refused, but what follows it waits.
            train_ms = self._config.duration_ms
            for _ in sendings:
                self._ledger.admit(command.request.node, train_ms=train_ms, at_ns=time.monotonic_ns())
            if attempt == 0:
                self._tell_now(command, Stage.ACCEPTED, train_ms=train_ms if sendings else 0)
            else:
                self._health.count("command.stop_repeated")
            for _ in sendings[1:] if attempt == 0 else sendings:
                self._audit(command, command.stages[0], train_ms=train_ms, row=_SENT_AGAIN)
            if await self._await_answer(command, sendings, timeout_s=self._config.stop_retry_s, is_stop=True):
                return
        if was_sent:
            self._tell_now(command, Stage.UNKNOWN, reason=f"no answer to {self._config.stop_attempts} stops; look at the animal")
        else:
            self._tell_now(command, Stage.FAILED, reason=reason)

    async def _stimulate(self, command: _Command) -> None:
        """Journal first, send once."""
        request = command.request
        train_ms = self._config.duration_ms
        self._ledger.admit(request.node, train_ms=train_ms, at_ns=time.monotonic_ns())
        if not await self._tell(command, Stage.ACCEPTED, train_ms=train_ms):
            self._tell_now(command, Stage.REFUSED, reason=f"the journal takes nothing ({self._journal.fault or 'slow disk'})")
            return
        ttl_ms = self._remaining_ms(request)
        if ttl_ms <= 0:
            await self._tell(command, Stage.REFUSED, reason="it expired before it could be sent")
            return
        try:
            sending = self._sender.send(request.node, self._message(command, ttl_ms=ttl_ms))
        except RadioUnavailableError as error:
            await self._tell(command, Stage.REFUSED, reason=str(error))
            return
        if not await self._await_answer(command, [sending], timeout_s=self._config.reply_timeout_s, is_stop=False):
            radio = sending.result() if sending.done() else RadioOutcome(fate=Fate.UNKNOWN)
            reason = f"no answer within {self._config.reply_timeout_s:g} s; it may have been obeyed"
            await self._tell(command, Stage.UNKNOWN, reason=f"{reason} ({radio.reason})" if radio.reason else reason)

    async def _await_answer(
        self, command: _Command, sendings: "list[asyncio.Future[RadioOutcome]]", *, timeout_s: float, is_stop: bool
    ) -> bool:
        """Wait for radios and biobot; True where a final stage was told."""
        under_way = set(sendings)
        deadline_s = asyncio.get_running_loop().time() + timeout_s
        while not command.reply.done():
            rest_s = deadline_s - asyncio.get_running_loop().time()
            if rest_s <= 0:
                return False
            waited: set[asyncio.Future[Any]] = {command.reply, *under_way}
            await asyncio.wait(waited, timeout=rest_s, return_when=asyncio.FIRST_COMPLETED)
            for sending in [] if command.reply.done() else [one for one in under_way if one.done()]:
                under_way.remove(sending)
                outcome = sending.result()
                if outcome.fate is Fate.SENT and all(stage.stage is not Stage.RADIO_CONFIRMED for stage in command.stages):
                    self._tell_now(command, Stage.RADIO_CONFIRMED)
                elif outcome.fate is Fate.NOT_SENT and not is_stop:
                    self._tell_now(command, Stage.FAILED, reason=f"the dongle did not send it: {outcome.reason}")
                    return True
        reply = command.reply.result()
        if reply.result in {StimulationResult.DONE, StimulationResult.ALREADY_DONE}:
            self._tell_now(command, Stage.BIOBOT_CONFIRMED, mode=mode_of(reply.mode))
        else:
            reason = f"the backpack answers: {reply.result.name.lower()}"
            self._tell_now(command, Stage.FAILED, reason=reason, mode=mode_of(reply.mode))
        return True

    def _refusal(self, request: StimulationRequest) -> str | None:
        """Return why a command is not admitted, or None. Of a STOP nothing but an address is asked."""
        node = self._nodes.find(request.node) if request.node <= _MAX_NODE else None
        if node is None:
            why = "it was never heard by this gateway" if request.node <= _MAX_NODE else f"the largest number of a biobot is {_MAX_NODE}"
            return f"biobot {request.node} is not known here: {why}"
        if request.action is StimulationAction.STOP:
            return None
        if unfit := _why_unfit(node):
            return f"biobot {request.node} {unfit}"
        if len(self._running) > _MAX_RUNNING:
            return f"{_MAX_RUNNING} commands are under way, the limit; wait for their answers"
        ahead_ms = (request.issued_wall_ns - self._wall_clock()) // NS_PER_MS
        if ahead_ms > self._config.max_clock_ahead_s * 1000:
            return f"it was issued {ahead_ms} ms in the future; set the clocks"
        if self._remaining_ms(request) <= 0:
            return f"it is stale: issued {-ahead_ms} ms ago with a time to live of {request.ttl_ms} ms; send it anew"
        if self._journal.fault is not None:
            return f"the journal takes nothing ({self._journal.fault})"
        refusal = None if node.limits is None else pulse_refusal(self._config, node.limits)
        train_ms, now_ns = self._config.duration_ms, time.monotonic_ns()
        return refusal or self._ledger.refusal(request.node, train_ms=train_ms, now_ns=now_ns, announced=node.limits)

    def _remaining_ms(self, request: StimulationRequest) -> int:
        age_ms = (self._wall_clock() - request.issued_wall_ns) // NS_PER_MS
        return min(request.ttl_ms - max(0, age_ms), _MAX_TTL_MS)

    def _message(self, command: _Command, *, ttl_ms: int) -> Stimulate:
        assert command.wire_command is not None
        return Stimulate(
            command=command.wire_command,
            action=_ACTIONS[command.request.action],
            ttl_ms=ttl_ms,
            hold_ms=command.request.hold_ms,
            frequency_hz=self._config.frequency_hz,
            pulse_width_us=self._config.pulse_width_us,
            amplitude_mv=self._config.amplitude_mv,
            duration_ms=self._config.duration_ms,
            channel=self._config.channel,
            waveform=WAVEFORMS[self._config.waveform],
        )

    async def _tell(self, command: _Command, stage: Stage, *, reason: str = "", train_ms: int = 0) -> bool:
        """Journal a stage and tell it when it is on disk; False where the disk did not take it in time (then nobody was told)."""
        told = self._stage(command.request, stage, reason=reason)
        committed = self._audit(command, told, train_ms=train_ms)
        if committed is not None:
            await asyncio.wait({committed}, timeout=_COMMIT_TIMEOUT_S)
        if committed is None or not committed.done() or committed.exception() is not None:
            if not told.is_final:
                return False
            _log.error("command.not_journaled", command=told.command_id, stage=stage.value)
        self._announce(command, told)
        return True

    def _tell_now(self, command: _Command, stage: Stage, *, reason: str = "", mode: Mode | None = None, train_ms: int = 0) -> None:
        """Tell a stage and journal it, without waiting for the disk: the animal has been, or must be, acted on already."""
        told = self._stage(command.request, stage, reason=reason, mode=mode)
        self._audit(command, told, train_ms=train_ms)
        self._announce(command, told)

    def _announce(self, command: _Command, stage: CommandStage) -> None:
        command.stages.append(stage)
        self._health.count(f"command.{stage.stage.value}")
        if stage.is_final:
            _log.info("command.done", command=stage.command_id, node=stage.node, action=stage.action.value, outcome=stage.stage.value)
        for listener in command.listeners:
            listener(stage)
        for hear in self._heard_by:
            hear(command.request, stage)

    def _audit(self, command: _Command, stage: CommandStage, *, train_ms: int, row: str | None = None) -> "asyncio.Future[None] | None":
        entry = AuditEntry(
            wall_ns=self._wall_clock(),
            command_id=stage.command_id,
            wire_command=command.wire_command,
            stage=row or stage.stage.value,
            node=stage.node,
            operator=command.request.operator,
            mono_ns=time.monotonic_ns(),
            train_ms=train_ms,
            request=encode_record(command.request),
            body=encode_record(stage),
        )
        try:
            return self._journal.append(JournalWrite(audit=entry))
        except JournalFullError as error:
            _log.error("command.not_journaled", command=stage.command_id, stage=stage.stage.value, reason=str(error))
            return None

    def _stage(self, request: StimulationRequest, stage: Stage, *, reason: str = "", mode: Mode | None = None) -> CommandStage:
        return CommandStage(
            command_id=request.command_id,
            gateway=self._gateway,
            node=request.node,
            action=request.action,
            stage=stage,
            wall_ns=Nanoseconds(self._wall_clock()),
            reason=reason,
            mode=mode,
        )

    def _finish(self, command: _Command) -> None:
        command_id = command.request.command_id
        del self._running[command_id]
        if command.wire_command is not None:
            del self._by_wire[command.request.node, command.wire_command]
        command.listeners.clear()
        command.finished.set()
        self._finished[command_id] = command
        while len(self._finished) > _MAX_REMEMBERED:
            self._finished.popitem(last=False)

    def _recall(self, command_id: str) -> _Command | None:
        """Return a command of the journal, with a final stage even where the gateway stopped before one was known."""
        entries = [entry for entry in self._reader.read_audit(command_id=command_id) if entry.stage != _SENT_AGAIN]
        if not entries:
            return None
        request = decode_record(entries[0].request, StimulationRequest)
        command = _Command(request=request, stages=[decode_record(entry.body, CommandStage) for entry in entries])
        command.finished.set()
        if not command.stages[-1].is_final:
            self._tell_now(command, Stage.UNKNOWN, reason="the gateway stopped before the answer came; it may have been obeyed")
        self._finished[command_id] = command
        return command

    def _restore_ledger(self) -> None:
        now_wall_ns, now_ns = self._wall_clock(), time.monotonic_ns()
        since_wall_ns = now_wall_ns - int(self._config.window_s * NS_PER_S)
        for entry in self._reader.read_audit_since(since_wall_ns):
            if entry.train_ms and entry.node is not None:
                # A wall clock that was set back makes old trains look new, never the other way round: it errs to the safe side.
                at_ns = now_ns - max(0, now_wall_ns - entry.wall_ns)
                self._ledger.admit(entry.node, train_ms=entry.train_ms, at_ns=at_ns)


def _why_unfit(node: Node) -> str:
    """Return why nothing but a STOP is for this biobot, or nothing."""
    if node.is_introduced and not node.capabilities & Capability.STIMULATION:
        return "cannot be stimulated: its backpack says so"
    if not node.last_heard_ns:
        return "was not heard since the gateway started, and another may have its address by now; it is being asked: try again soon"
    return ""


def _is_same(one: StimulationRequest, other: StimulationRequest) -> bool:
    return (one.node, one.action, one.hold_ms) == (other.node, other.action, other.hold_ms)
