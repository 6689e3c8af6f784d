"""Starts and turns: on disk first, sent once, never again. Without an answer the outcome is unknown, and says so."""

from collections.abc import Callable
from dataclasses import dataclass

from firmware_protocol.contract.commands import Refusal, Stage, StimulationRequest
from firmware_protocol.messages import Limits
from firmware_protocol.units import NS_PER_MS, NS_PER_S
from gateway.config import StimulationTable
from gateway.errors import RadioUnavailableError
from gateway.nodes import NodeBook
from gateway.radio import Fate, RadioOutcome
from gateway.stimulation import frames
from gateway.stimulation.admission import remaining_ms, why_unable
from gateway.stimulation.answers import AnswerKeeper
from gateway.stimulation.commands import Command
from gateway.stimulation.guards import Guards
from gateway.stimulation.ledger import TrainLedger
from gateway.stimulation.outside import CommandSender, Sending
from gateway.stimulation.pulses import Pulse
from gateway.stimulation.telling import COMMIT_TIMEOUT_S, StageTeller
from gateway.stimulation.verdict import Refused

UNWRITTEN_S = 1.0
"""A frame that was not written to its dongle's line after this is taken back: what it asks for is too old for an animal."""

_QUEUE_NS = (frames.MAX_QUEUED_MS + 10) * NS_PER_MS
"""How long after its frame a train may begin: what the backpack may have it wait, in ticks of its own clock."""

_OTHER_LIMITS = Refused(refusal=Refusal.PULSE, reason="its backpack has just announced its limits; send it anew, to be judged by them")

_OVERTAKEN = Refused(refusal=Refusal.OVERTAKEN, reason="a stop of this biobot came before it was sent; send it anew if it is still wanted")


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """How long a frame may be on its way [ns], beside the time in which it can be taken back."""

    table: StimulationTable

    def latest_ns(self, *, now_ns: int, unwritten_s: float = UNWRITTEN_S) -> int:
        """Return the latest instant at which a train begins whose frame is given to a radio now, and taken back if unwritten."""
        return now_ns + int((unwritten_s + self.table.flight_s) * NS_PER_S) + _QUEUE_NS


class Stimuli:
    """Runs starts and turns that were admitted."""

    def __init__(
        self,
        *,
        table: StimulationTable,
        radio_timeout_s: float,
        sender: CommandSender,
        nodes: NodeBook,
        ledger: TrainLedger,
        teller: StageTeller,
        answers: AnswerKeeper,
        guards: Guards,
        now_ns: Callable[[], int],
        wall_clock: Callable[[], int],
        journal_fault: Callable[[], str | None],
        why_unattended: Callable[[StimulationRequest], Refused | None],
        on_sent: Callable[[Command], None],
    ) -> None:
        self._table = table
        self._radio_timeout_ns = int(radio_timeout_s * NS_PER_S)
        self._sender = sender
        self._nodes = nodes
        self._ledger = ledger
        self._teller = teller
        self._answers = answers
        self._guards = guards
        self._flight = Flight(table=table)
        self._now_ns = now_ns
        self._wall_clock = wall_clock
        self._journal_fault = journal_fault
        self._why_unattended = why_unattended
        self._on_sent = on_sent

    async def run(self, command: Command, pulse: Pulse) -> None:
        """Take an admitted command to its last stage."""
        began_ns, node = self._now_ns(), command.request.node
        announced = self._announced(command)
        until_ns = began_ns + int(COMMIT_TIMEOUT_S * NS_PER_S)
        if pulse.duration_ms:
            # From now on: no other one must be admitted while this one waits for the disk.
            latest_ns = self._flight.latest_ns(now_ns=until_ns)
            command.train = self._ledger.reserve(node, train_ms=pulse.duration_ms, latest_ns=latest_ns, now_ns=began_ns)
        accepted = self._teller.stage(command, Stage.ACCEPTED, deadline_ns=until_ns + self._radio_timeout_ns)
        left_ms = remaining_ms(command.request, now_wall_ns=self._wall_clock())
        is_on_disk = await self._teller.commit(command, accepted, train_ms=pulse.duration_ms)
        if command.is_final:  # the gateway ends
            self._take_back(command)
            return
        # By the monotonic clock: the other one may have been set meanwhile.
        ttl_ms = left_ms - (self._now_ns() - began_ns) // NS_PER_MS
        refused = self._why_not_now(command, is_on_disk=is_on_disk and self._now_ns() <= until_ns, ttl_ms=ttl_ms)
        if refused is None and announced != self._announced(command):
            refused = _OTHER_LIMITS  # it was admitted by those before
        if refused is None:
            try:
                sending = self._sender.send(node, frames.stimulus(command, pulse, ttl_ms=ttl_ms))
            except RadioUnavailableError as error:
                refused = Refused(refusal=Refusal.RADIO, reason=str(error))
        if refused is not None:
            self._take_back(command)
            await self._teller.refuse(command, refused)
            return
        sent_ns = self._now_ns()
        command.sendings.append(sending)
        latest_ns = self._flight.latest_ns(now_ns=sent_ns)
        if command.train is not None:
            command.train.latest_ns = latest_ns
        self._guards.sent(command, until_ns=latest_ns)
        self._on_sent(command)
        self._teller.announce(command, accepted)
        await self._follow(command, sending, sent_ns=sent_ns, unwritten_ns=sent_ns + min(int(UNWRITTEN_S * NS_PER_S), ttl_ms * NS_PER_MS))

    async def _follow(self, command: Command, sending: Sending, *, sent_ns: int, unwritten_ns: int) -> None:
        """Wait for radio and biobot, each until its deadline; a frame that is not written until ``unwritten_ns`` is taken back."""
        deadline_ns = sent_ns + self._radio_timeout_ns
        outcome: RadioOutcome | None = None
        is_withdrawn = False
        while not command.reply.done() and not command.is_final:
            now_ns = self._now_ns()
            if outcome is None and not sending.done() and now_ns >= unwritten_ns:
                is_withdrawn = self._sender.withdraw(sending)  # where it was not written, its fate is settled by that
                unwritten_ns = deadline_ns
            if outcome is None and sending.done():
                outcome = sending.result()
                if outcome.fate is Fate.NOT_SENT:
                    await self._end_unsent(command, outcome, is_withdrawn=is_withdrawn)
                    return
                deadline_ns = self._next_deadline_ns(outcome, deadline_ns=deadline_ns, now_ns=now_ns)
                if outcome.fate is Fate.SENT:
                    self._teller.tell(command, Stage.RADIO_CONFIRMED, deadline_ns=deadline_ns)
            if now_ns >= deadline_ns:
                self._teller.tell(command, Stage.UNKNOWN, reason=self._what_is_missing(outcome))
                return
            awaited, until_ns = ([sending], min(unwritten_ns, deadline_ns)) if outcome is None else ([], deadline_ns)
            await self._answers.wait(command, awaited, until_ns=until_ns)
        if not command.is_final:
            self._answers.settle(command)

    def _next_deadline_ns(self, outcome: RadioOutcome, *, deadline_ns: int, now_ns: int) -> int:
        """Return by when the biobot answers; without a radio's confirmation no later than that was due."""
        answer_ns = now_ns + int(self._table.reply_timeout_s * NS_PER_S)
        return answer_ns if outcome.fate is Fate.SENT else min(deadline_ns, answer_ns)

    async def _end_unsent(self, command: Command, outcome: RadioOutcome, *, is_withdrawn: bool) -> None:
        self._take_back(command)
        if command.is_overtaken:
            await self._teller.refuse(command, _OVERTAKEN)
        else:
            why = f"it was taken back: the radio's line did not take it in time (at most {UNWRITTEN_S:g} s, and its time to live)"
            if not is_withdrawn:
                why = f"the dongle did not send it ({outcome.reason or 'it does not say why'})"
            self._teller.tell(command, Stage.FAILED, reason=f"{why}; see how the radio is (`biobot-gateway status`), and give it anew")

    def _what_is_missing(self, outcome: RadioOutcome | None) -> str:
        reply_s, radio_s = self._table.reply_timeout_s, self._radio_timeout_ns / NS_PER_S
        if outcome is None:
            return f"no confirmation of the radio within {radio_s:g} s, and no answer of the biobot; it may have been obeyed"
        if outcome.fate is Fate.SENT:
            return f"the radio has sent it, but no answer of the biobot within {reply_s:g} s; it may have been obeyed"
        return f"no answer within {reply_s:g} s ({outcome.reason or 'the radio does not say what became of it'}); it may have been obeyed"

    def _why_not_now(self, command: Command, *, is_on_disk: bool, ttl_ms: int) -> Refused | None:
        """Return why a command that was admitted must not be sent after its wait for the disk, or None."""
        if command.is_overtaken:
            return _OVERTAKEN
        if not is_on_disk:
            reason = f"the journal takes nothing ({self._journal_fault() or 'slow disk'}); make room on its disk, or use a faster one"
            return Refused(refusal=Refusal.JOURNAL, reason=reason)
        if ttl_ms <= 0:
            return Refused(refusal=Refusal.STALE, reason="it expired before it could be sent; give it a longer time to live")
        node = self._nodes.find(command.request.node)
        unable = None if node is None else why_unable(node, command.request.action)  # its backpack may have started anew since
        return unable or self._why_unattended(command.request)

    def _announced(self, command: Command) -> Limits | None:
        node = self._nodes.find(command.request.node)
        return None if node is None else node.limits

    def _take_back(self, command: Command) -> None:
        if command.train is not None:
            self._ledger.take_back(command.request.node, command.train)
            command.train = None
