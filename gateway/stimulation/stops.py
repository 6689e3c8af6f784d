"""Stops of one biobot: sent first, journaled after, and again until the biobot confirms.

Only the first frame of a stop has a train, and only where the ledger admits one: a backpack that forgot the command, because it started
anew in between, would give it twice. Without a train the backpack makes the insect stand all the same (WIRE_FORMAT.md §6.8).
"""

import asyncio
from collections.abc import Callable

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.journal_file import SENT_AGAIN
from gateway.nodes import NodeBook
from gateway.radio import Fate
from gateway.stimulation import frames
from gateway.stimulation.answers import AnswerKeeper
from gateway.stimulation.commands import Command, CommandBook
from gateway.stimulation.guards import Guards
from gateway.stimulation.ledger import TrainLedger
from gateway.stimulation.outside import CommandSender
from gateway.stimulation.pulses import Pulse, pulse_of, pulse_refusal
from gateway.stimulation.silence import no_answer
from gateway.stimulation.stimuli import Flight
from gateway.stimulation.telling import TAKEN_BACK, StageTeller

MAX_STOPS_OF_ONE = 8
"""Stops of one biobot that are under way; another one ends the oldest of them, whose place it takes."""

_BARE = "it is stopped without a train: "


class Stops:
    """Runs stops, and keeps others' frames back."""

    def __init__(
        self,
        *,
        table: StimulationTable,
        sender: CommandSender,
        nodes: NodeBook,
        book: CommandBook,
        ledger: TrainLedger,
        teller: StageTeller,
        answers: AnswerKeeper,
        guards: Guards,
        health: Health,
        now_ns: Callable[[], int],
        are_trains_allowed: Callable[[], bool],
    ) -> None:
        self._table = table
        self._sender = sender
        self._nodes = nodes
        self._book = book
        self._ledger = ledger
        self._teller = teller
        self._answers = answers
        self._guards = guards
        self._health = health
        self._now_ns = now_ns
        self._are_trains_allowed = are_trains_allowed
        self._unwritten: dict[NodeId, asyncio.Future[None]] = {}
        """Of each biobot the row of a stop's train that was given to the journal last."""
        self._flight = Flight(table=table)

    async def run(self, command: Command) -> None:
        """Take a stop to its last stage."""
        retry_ns = int(self._table.stop_retry_s * NS_PER_S)
        end_ns = self._now_ns() + self._table.stop_attempts * retry_ns
        reason = why_bare = ""
        try:
            for attempt in range(self._table.stop_attempts):
                n_before = len(command.sendings)
                if attempt == 0:
                    self.overtake(command)  # before it is sent: a port that takes it may take the next frame too
                pulse, why_bare = (None, why_bare) if n_before else self._fit_pulse(command)
                reason = self._send(command, pulse)
                if attempt == 0:
                    self._make_room(command)
                self._tell_sent(command, n_before=n_before, end_ns=end_ns, why_bare=why_bare)
                # From now, not from the begin: where this process was held up, each repetition has its time all the same.
                if await self._await_answer(command, until_ns=self._now_ns() + retry_ns, end_ns=end_ns):
                    return
                self._withdraw_train(command)
        finally:
            self._withdraw_train(command)
        reason = no_answer(n_sent=len(command.sendings), why_unsent=reason)
        self._teller.tell(command, Stage.UNKNOWN if command.sendings else Stage.FAILED, reason=reason)

    def may_give_train(self, node: NodeId) -> bool:
        """Whether a stop may have a train: at most one of each biobot is not on disk yet, for one is what a restart reckons with."""
        written = self._unwritten.get(node)
        if written is not None and written.done():
            del self._unwritten[node]
            written = None
        return self._are_trains_allowed() and written is None

    def overtake(self, stop: Command) -> None:
        """Keep starts and turns of its biobot, or of all, that were not written yet from being sent; those that were are watched."""
        is_for_all = stop.request.action is StimulationAction.STOP_ALL
        for other in self._book.running() if is_for_all else self._book.running_of(stop.request.node):
            if other.is_stop or other.is_final:
                continue
            if not other.sendings or (not other.sendings[0].done() and self._sender.withdraw(other.sendings[0])):
                other.overtake()
        self._guards.stopped(stop, None if is_for_all else [stop.request.node])

    def _send(self, command: Command, pulse: Pulse | None) -> str:
        """Send it over every radio that may reach the biobot, the first frame with a train where there is one; return why it was not."""
        node, reason = command.request.node, ""
        bare = frames.stop(command, pulse_of(command.request.pulse, self._table), has_train=False)
        try:
            first = self._sender.send(node, bare if pulse is None else frames.stop(command, pulse, has_train=True), is_urgent=True)
        except RadioUnavailableError as error:
            reason = str(error)
        else:
            command.sendings.append(first)
            if pulse is not None:
                now_ns = self._now_ns()
                latest_ns = self._flight.latest_ns(now_ns=now_ns, unwritten_s=self._table.stop_retry_s)
                command.train = self._ledger.reserve(node, train_ms=pulse.duration_ms, latest_ns=latest_ns, now_ns=now_ns)
        command.sendings += self._sender.send_elsewhere(node, bare)
        return reason

    def _tell_sent(self, command: Command, *, n_before: int, end_ns: int, why_bare: str) -> None:
        """Put on record what was sent just now; the frame with the train, if there is one, was the first of all; else why it had none."""
        train_ms = 0 if command.train is None or n_before else command.train.duration_ms
        n_again, written = len(command.sendings) - n_before, None
        if command.stages:
            self._health.count("command.stop_repeated")
        else:
            written = self._teller.tell(command, Stage.ACCEPTED, train_ms=train_ms, deadline_ns=end_ns, reason=why_bare)
            n_again -= 1
        for place in range(n_again):
            noted = self._teller.note(command, SENT_AGAIN, train_ms=0 if written or place else train_ms)
            written = written or noted
        if train_ms:
            self._unwritten[command.request.node] = written or asyncio.get_running_loop().create_future()

    def _fit_pulse(self, command: Command) -> tuple[Pulse | None, str]:
        """Return the train that a stop may give now; or None, and why where one was to be."""
        node = self._nodes.find(command.request.node)
        pulse = pulse_of(command.request.pulse, self._table)
        if node is None or pulse.duration_ms == 0:
            return None, ""
        if not self.may_give_train(node.node):
            return None, f"{_BARE}an earlier stop's train is not on disk yet, or the gateway ends"
        refused = pulse_refusal(pulse, table=self._table, limits=node.limits) or self._ledger.refusal(
            node.node, train_ms=pulse.duration_ms, now_ns=self._now_ns(), announced=node.limits
        )
        return (pulse, "") if refused is None else (None, f"{_BARE}{refused.reason}")

    async def _await_answer(self, command: Command, *, until_ns: int, end_ns: int) -> bool:
        """Wait for radios and biobot until an instant; True where the last stage is told."""
        under_way = list(command.sendings)
        while not command.reply.done() and not command.is_final:
            for sending in [one for one in under_way if one.done()]:
                under_way.remove(sending)
                if sending.result().fate is Fate.SENT and not command.is_radio_confirmed:
                    self._teller.tell(command, Stage.RADIO_CONFIRMED, deadline_ns=end_ns)
            if self._now_ns() >= until_ns:
                return False
            await self._answers.wait(command, [] if command.is_radio_confirmed else under_way, until_ns=until_ns)
        if not command.is_final:
            self._answers.settle(command)
        return True

    def _withdraw_train(self, command: Command) -> None:
        """Take the frame with the train back where it was not written yet: later than this it must not leave."""
        if command.train is None:
            return
        first = command.sendings[0]
        if (first.done() and first.result().fate is Fate.NOT_SENT) or (not first.done() and self._sender.withdraw(first)):
            self._ledger.take_back(command.request.node, command.train)
            command.train = None
            self._teller.note(command, TAKEN_BACK)

    def _make_room(self, command: Command) -> None:
        """End the oldest stops of a biobot where too many are under way; each was sent, and this one has been since."""
        stops = [one for one in self._book.running_of(command.request.node) if one.is_stop and one is not command and not one.is_final]
        for oldest in stops[: max(0, len(stops) + 1 - MAX_STOPS_OF_ONE)]:
            reason = f"{MAX_STOPS_OF_ONE} newer stops of this biobot are under way, the limit; theirs is the answer"
            self._teller.tell(oldest, Stage.UNKNOWN, reason=reason)
            oldest.overtake()
