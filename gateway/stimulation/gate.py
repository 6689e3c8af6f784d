"""The one gate for commands to living animals: takes each once, admits or refuses it, and answers for it.

A start or a turn is journaled before it is sent, and refused where the disk does not take it; it is never sent twice: without an answer
its outcome is unknown, and says so. A stop is sent first and journaled after, whatever its age and whatever the limits say, ahead of all
that waits, and again until it is confirmed.
"""

import contextlib
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator

import msgspec

from firmware_protocol.contract.commands import CommandStage, Refusal, Stage, StimulationAccount, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import Mode, decode_record
from firmware_protocol.errors import RecordError
from firmware_protocol.messages import StimulateReply
from firmware_protocol.units import EVERYBODY, NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.health import Health
from gateway.journal_file import STAGE, AuditEntry
from gateway.log import EventLog
from gateway.nodes import NodeBook
from gateway.stimulation.accounts import Accounts
from gateway.stimulation.admission import Circumstances, admit, unknown_biobot, why_unattended
from gateway.stimulation.answers import AnswerKeeper, is_done
from gateway.stimulation.commands import Command, CommandBook, is_same
from gateway.stimulation.effects import Effects
from gateway.stimulation.guards import Guards
from gateway.stimulation.ledger import Train, TrainLedger
from gateway.stimulation.numbers import GATE, WireNumbers, last_number, was_killed
from gateway.stimulation.outside import AccountListener, AuditReader, CommandJournal, CommandListener, CommandSender, StageListener
from gateway.stimulation.precedence import Precedence
from gateway.stimulation.restoring import restore_stops, restore_trains
from gateway.stimulation.stimuli import Flight, Stimuli
from gateway.stimulation.stop_all import StopAll
from gateway.stimulation.stops import Stops
from gateway.stimulation.telling import LATE_REPLY, NOT_OBEYED, OBEYED, STRAYED, StageTeller
from gateway.stimulation.verdict import Refused

_log = EventLog(__name__)

_RESTORED_ROWS = 100_000
"""Newest rows of the audit log that accounts are made of after a restart."""

_WAS_STOPPED = "the gateway was stopped before the answer came; it may have been obeyed"


class StimulationGate:
    """Takes every command; see the module's description. Belongs to one event loop.

    Parameters
    ----------
    radio_timeout_s
        So long a radio's confirmation is waited for, ``link.radio_timeout_s``.
    now_ns, wall_clock
        The monotonic clock, by which everything is judged but a command's age, and UTC [ns]. Waits are by the loop's clock, which must go
        as the monotonic one does.
    instant_of
        Says when a row of an earlier process was written, by the monotonic clock, or later than it was: ``JournalIdentity.instant_of``.
    is_commander_there
        Whether a commander of that name has its liveliness token.
    controlled
        Biobots under controlled motion: whom a stop of all stops first.
    controller_of
        Who moves a biobot now, for its account.
    on_repeated
        Told of a request whose id is known: it is a repetition, or another command under the same id.
    """

    def __init__(
        self,
        *,
        gateway: str,
        config: StimulationTable,
        sender: CommandSender,
        nodes: NodeBook,
        journal: CommandJournal,
        reader: AuditReader,
        health: Health,
        instant_of: Callable[[AuditEntry], int],
        radio_timeout_s: float = 6.0,
        now_ns: Callable[[], int] = time.monotonic_ns,
        wall_clock: Callable[[], int] = time.time_ns,
        new_number: Callable[[], int] = lambda: secrets.randbits(31),
        is_commander_there: Callable[[str], bool] = lambda _: False,
        controlled: Callable[[], Iterable[NodeId]] = tuple,
        controller_of: Callable[[NodeId], str] = lambda _: "",
        on_repeated: Callable[[StimulationRequest], None] = lambda _: None,
    ) -> None:
        self._config = config
        self._nodes = nodes
        self._journal = journal
        self._reader = reader
        self._health = health
        self._now_ns = now_ns
        self._wall_clock = wall_clock
        self._is_commander_there = is_commander_there
        self._on_repeated = on_repeated
        self._account_listeners: list[AccountListener] = []
        self._is_stopping = False
        self._book = CommandBook()
        self._ledger = ledger = TrainLedger(limits=config)
        self._precedence = Precedence()
        self._effects = Effects(now_ns=now_ns)
        self._accounts = Accounts(gateway=gateway, table=config, ledger=ledger, nodes=nodes, controller_of=controller_of)
        self._teller = teller = StageTeller(gateway=gateway, journal=journal, health=health, now_ns=now_ns, wall_clock=wall_clock)
        teller.listen_to_rows(self._account_for)
        self._answers = answers = AnswerKeeper(teller=teller, ledger=ledger, now_ns=now_ns)
        self._restore(instant_of)
        last = last_number(reader)
        self._numbers = WireNumbers(journal=journal, last=last, draw=new_number, now_ns=now_ns, wall_clock=wall_clock)
        guards = Guards(
            table=config,
            sender=sender,
            book=self._book,
            teller=teller,
            answers=answers,
            health=health,
            now_ns=now_ns,
            take_number=self._numbers.take,
        )
        self._stimuli = Stimuli(
            table=config,
            radio_timeout_s=radio_timeout_s,
            sender=sender,
            nodes=nodes,
            ledger=ledger,
            teller=teller,
            answers=answers,
            guards=guards,
            now_ns=now_ns,
            wall_clock=wall_clock,
            journal_fault=lambda: journal.fault,
            why_unattended=self._why_unattended,
            on_sent=lambda command: self._precedence.moved(command.request.node, now_ns=now_ns()),
        )
        self._stops = Stops(
            table=config,
            sender=sender,
            nodes=nodes,
            book=self._book,
            ledger=ledger,
            teller=teller,
            answers=answers,
            guards=guards,
            health=health,
            now_ns=now_ns,
            are_trains_allowed=self._may_stops_give_trains,
        )
        self._stop_all = StopAll(
            table=config,
            sender=sender,
            nodes=nodes,
            book=self._book,
            stops=self._stops,
            teller=teller,
            answers=answers,
            now_ns=now_ns,
            controlled=controlled,
        )

    def listen(self, listener: CommandListener) -> None:
        """Have ``listener(request, stage)`` called in the loop with every stage of every command, whoever gave it."""
        self._teller.listen(listener)

    def listen_to_accounts(self, listener: AccountListener) -> None:
        """Have ``listener`` called in the loop with the account of a biobot whenever it has changed."""
        self._account_listeners.append(listener)

    def account_of(self, node: NodeId) -> StimulationAccount | None:
        """Return how a biobot was stimulated, or None where it never got a command."""
        return self._accounts.of(node, now_ns=self._now_ns(), wall_ns=self._wall_clock())

    def accounts(self) -> list[StimulationAccount]:
        """Return the accounts of all biobots that ever got a command."""
        return [account for node in self._accounts.nodes() if (account := self.account_of(node)) is not None]

    async def handle(self, request: StimulationRequest, listener: StageListener, *, came_ns: int | None = None) -> None:
        """Take a command; ``listener`` hears each stage, the last one final. A known id is answered again, not obeyed again.

        But a stop that is issued anew under its id is, where its biobot was moved since. ``came_ns`` is when the command came in, where it
        waited for something before it came here.
        """
        came_ns = self._now_ns() if came_ns is None else came_ns
        command = Command(request=request, key=request.command_id, listeners=[listener], came_ns=came_ns)
        try:
            await self._handle(command)
        except Exception as error:  # noqa: BLE001  # one command's fault must not end the gateway, which stops the other animals
            self._health.count("command.broken")
            reason = f"{type(error).__name__}: {error}"
            _log.error("command.broken", command=request.command_id, node=request.node, action=request.action.value, reason=reason)
            if not command.is_final:
                reason = f"the gateway failed at it ({reason}); it may have been obeyed"
                with contextlib.suppress(Exception):  # what is broken may be what puts it on record
                    self._teller.tell(command, Stage.UNKNOWN, reason=reason)
                self._teller.answer(listener, self._teller.stage(command, Stage.UNKNOWN, reason=reason))

    def on_answer(self, node: NodeId, reply: StimulateReply) -> None:
        """Take a biobot's answer that is not on disk yet: the end of a stop does not wait for a disk."""
        command = self._book.answered(node, reply.command)
        if command is not None and command.is_stop:
            self.on_reply(node, reply)

    def on_reply(self, node: NodeId, reply: StimulateReply) -> None:
        """Take a biobot's answer, now that it is on disk."""
        command = self._book.answered(node, reply.command)
        if command is None:
            self._take_stray(node, reply)
        elif not command.reply.done():
            command.reply.set_result(reply)
            if command.finished.is_set():
                self._take_late(command, reply)

    def on_mode(self, node: NodeId, mode: Mode) -> None:
        """Take the mode that a biobot reports by itself: whether it did as it was told."""
        judged = self._effects.judge(node, mode)
        if judged is not None:
            command, is_obeyed = judged
            self._teller.note(command, OBEYED if is_obeyed else NOT_OBEYED, reason=f"it reports mode {mode.value}")

    def begin_stopping(self) -> None:
        """Admit nothing but stops from now on."""
        self._is_stopping = True

    def abandon(self) -> None:
        """Give every command under way its last answer: the gateway stops, and what became of it will not be known."""
        self._is_stopping = True
        for command in self._book.running():
            if command.is_final:
                continue
            if command.is_stop or command.sendings:
                self._teller.tell(command, Stage.UNKNOWN, reason=_WAS_STOPPED)
            else:
                reason = "the gateway ends, and it was not sent; send it when it runs again"
                self._teller.tell(command, Stage.REFUSED, reason=reason, refusal=Refusal.STOPPING)
        self._numbers.close()

    async def _handle(self, command: Command) -> None:
        request = command.request
        known = self._book.find(command.key)
        if known is None and not command.is_stop:  # a stop does not wait for what is on disk, and to stop once more does no harm
            try:
                known = self._recall(command)
            except (sqlite3.Error, RecordError) as error:
                self._health.count("command.unread_journal")
                _log.error("command.unread_journal", command=request.command_id, action=request.action.value, reason=str(error))
                reason = f"the journal cannot be read ({error}), so it is not known whether this command was obeyed before; stop the animal"
                self._answer_refused(command, Refused(refusal=Refusal.JOURNAL, reason=reason))
                return
        if known is not None:
            self._health.count("command.repeated")
            self._on_repeated(request)
            if is_same(known.request, request) and not self._is_wanted_again(known, request):
                await self._answer_again(known, command.listeners[0])
                return
            if not command.is_stop:
                reason = "this command id was used for another command; give each command its own"
                self._answer_refused(command, Refused(refusal=Refusal.ID_REUSED, reason=reason))
                return
            command.key = self._free_key(command.key)
        self._book.begin(command)
        try:
            await self._run(command)
        finally:
            self._book.finish(command)
            if command.stages:
                self._effects.begin(command)

    async def _run(self, command: Command) -> None:
        request = command.request
        is_for_all = request.action is StimulationAction.STOP_ALL
        node = self._nodes.find(request.node) if request.node < EVERYBODY else None
        if is_for_all or (command.is_stop and node is not None):
            self._precedence.stopped(request, came_ns=command.came_ns, came_wall_ns=self._wall_clock())
            self._effects.forget(None if is_for_all else request.node)
            self._book.number(command, self._numbers.take())
            await (self._stop_all if is_for_all else self._stops).run(command)
            return
        if command.is_stop:
            await self._teller.refuse(command, unknown_biobot(request))
            return
        so = Circumstances(
            node=node,
            now_ns=self._now_ns(),
            now_wall_ns=self._wall_clock(),
            n_running=self._book.n_running - 1,
            n_running_of_node=sum(not other.is_stop for other in self._book.running_of(request.node)) - 1,
            is_overtaken=self._precedence.is_overtaken(request, came_ns=command.came_ns, now_ns=self._now_ns()),
            is_stopping=self._is_stopping,
            is_commander_there=self._has_commander(request),
            journal_fault=self._journal.fault,
        )
        pulse = admit(request, table=self._config, ledger=self._ledger, so=so)
        if isinstance(pulse, Refused):
            await self._teller.refuse(command, pulse)
            return
        self._effects.forget(request.node)
        self._book.number(command, self._numbers.take())
        await self._stimuli.run(command, pulse)

    def _has_commander(self, request: StimulationRequest) -> bool:
        return not request.commander or self._is_commander_there(request.commander)

    def _why_unattended(self, request: StimulationRequest) -> Refused | None:
        return why_unattended(request, is_stopping=self._is_stopping, is_commander_there=self._has_commander(request))

    def _is_wanted_again(self, known: Command, request: StimulationRequest) -> bool:
        """Whether a stop of a known id is no repetition of a message, but asked for anew since its biobot was moved."""
        is_anew = known.is_stop and request.issued_wall_ns != known.request.issued_wall_ns
        return is_anew and self._precedence.has_moved(request.node, since_ns=known.came_ns)

    async def _answer_again(self, known: Command, listener: StageListener) -> None:
        for stage in list(known.stages):
            self._teller.answer(listener, stage)
        if not known.finished.is_set():
            known.listeners.append(listener)
            await known.finished.wait()

    def _answer_refused(self, command: Command, refused: Refused) -> None:
        """Tell whoever asks now, and nobody else: the id is another command's."""
        stage = self._teller.stage(command, Stage.REFUSED, reason=refused.reason, refusal=refused.refusal)
        self._teller.answer(command.listeners[0], stage)

    def _take_late(self, command: Command, reply: StimulateReply) -> None:
        """Put an answer on record that came when the last stage had been told, which it does not change."""
        self._health.count("command.late_replies")
        self._answers.learn(command, reply)
        if command.stages:  # else it answers a broadcast that a newer one has taken the place of, before this biobot was sent to by itself
            self._teller.note(command, LATE_REPLY, reason=f"the backpack answers late: {reply.result.name.lower()}")

    def _take_stray(self, node: NodeId, reply: StimulateReply) -> None:
        """Take an answer to a command that this biobot was not given: one that has obeyed another's has got its train."""
        command = self._book.strayed(node, reply.command)
        if command is None or command.train is None or not is_done(reply) or self._nodes.find(node) is None:
            self._health.count("command.late_replies")
            return
        self._health.count("command.strayed")
        _log.error("command.strayed", command=command.request.command_id, meant=command.request.node, node=node)
        now_ns, train_ms = self._now_ns(), command.train.duration_ms
        self._ledger.reserve(node, train_ms=train_ms, latest_ns=now_ns, now_ns=now_ns)
        if command.stages:
            reason = f"biobot {node} obeyed what was meant for biobot {command.request.node}"
            self._teller.note(command, STRAYED, node=node, train_ms=train_ms, reason=reason)

    def _account_for(self, entry: AuditEntry) -> None:
        self._accounts.take(entry)
        if entry.node is not None and self._account_listeners and (account := self.account_of(entry.node)) is not None:
            for listener in self._account_listeners:
                listener(account)

    def _free_key(self, key: str) -> str:
        while self._book.find(key) is not None:
            key += " again"
        return key

    def _recall(self, asked: Command) -> Command | None:
        """Return a command of the journal, with a final stage even where the gateway stopped before one was known."""
        entries = [entry for entry in self._reader.read_audit(command_id=asked.request.command_id) if entry.kind == STAGE]
        if not entries:
            return None
        command = Command(request=decode_record(entries[0].request, StimulationRequest), key=asked.key)
        for entry in entries:
            command.stages.append(decode_record(entry.body, CommandStage))
            if command.is_final:
                break
        if not command.is_final:
            self._teller.tell(command, Stage.UNKNOWN, reason=_WAS_STOPPED)
        self._book.remember(command)
        return command

    def _restore(self, instant_of: Callable[[AuditEntry], int]) -> None:
        flight = Flight(table=self._config)
        now_ns = self._now_ns()
        try:
            rows = self._accounted(self._reader.read_newest_audit(limit=_RESTORED_ROWS))
            rows = restore_stops(self._precedence, rows, instant_of=instant_of, now_ns=now_ns)
            restore_trains(self._ledger, rows, instant_of=instant_of, latest_ns=lambda at_ns: flight.latest_ns(now_ns=at_ns), now_ns=now_ns)
            is_unknown = was_killed(self._reader.read_last_audit(kind=GATE))
        except (sqlite3.Error, RecordError, msgspec.ValidationError) as error:
            _log.error("command.unread_journal", reason=str(error))
            now_ns += int(self._config.window_s * NS_PER_S)  # nothing is known: no train before the window is over
            is_unknown = True
        if is_unknown:
            self._ledger.unknown = Train(latest_ns=flight.latest_ns(now_ns=now_ns), duration_ms=_LONGEST_TRAIN_MS)

    def _accounted(self, rows: Iterable[AuditEntry]) -> Iterator[AuditEntry]:
        for row in rows:
            self._accounts.take(row)
            yield row

    def _may_stops_give_trains(self) -> bool:
        """Whether a restart would reckon with a stop's train that does not come to disk any more."""
        return self._numbers.are_on_record and not self._is_stopping


_LONGEST_TRAIN_MS = 500
"""No configuration allows a longer one (``stimulation.max_duration_ms``)."""
