"""After a stop, what was on its way when it came may come after it: frames pass each other, and a dongle tries for seconds.

So each start and turn is watched for as long as it can be on its way. Where a stop came meanwhile, the biobot is stopped once more as soon
as the other has come, or can come no more: under another number, for of the first one it would take a repetition. Not where somebody has
moved it since.
"""

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from firmware_protocol.contract.commands import Stage
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.journal_file import SENT_AGAIN
from gateway.log import EventLog
from gateway.radio import Fate
from gateway.stimulation import frames
from gateway.stimulation.answers import AnswerKeeper, is_done
from gateway.stimulation.commands import Command, CommandBook
from gateway.stimulation.outside import CommandSender, Sending
from gateway.stimulation.parts import stop_of
from gateway.stimulation.pulses import pulse_of
from gateway.stimulation.silence import no_answer
from gateway.stimulation.telling import StageTeller

_log = EventLog(__name__)


@dataclass(slots=True, eq=False, kw_only=True)
class _OnItsWay:
    """A start or a turn that may yet reach its biobot."""

    command: Command
    until_ns: int
    stop: Command | None = None
    """The stop that came since."""
    timer: asyncio.TimerHandle | None = None


class Guards:
    """Watches what is on its way; see the module's description. Belongs to one event loop."""

    def __init__(
        self,
        *,
        table: StimulationTable,
        sender: CommandSender,
        book: CommandBook,
        teller: StageTeller,
        answers: AnswerKeeper,
        health: Health,
        now_ns: Callable[[], int],
        take_number: Callable[[], int],
    ) -> None:
        self._table = table
        self._sender = sender
        self._book = book
        self._teller = teller
        self._answers = answers
        self._health = health
        self._now_ns = now_ns
        self._take_number = take_number
        self._on_their_way: dict[NodeId, list[_OnItsWay]] = {}

    def sent(self, command: Command, *, until_ns: int) -> None:
        """Watch a start or a turn that was given to a radio, and can come until an instant. The biobot is meant to move again."""
        now_ns, node = self._now_ns(), command.request.node
        one = _OnItsWay(command=command, until_ns=until_ns)
        others = [other for other in self._on_their_way.get(node, []) if other.until_ns > now_ns]
        for other in others:
            self._disarm(other)
        self._on_their_way[node] = [*others, one]
        command.reply.add_done_callback(lambda _: self._on_reply(one))
        command.sendings[0].add_done_callback(lambda sending: self._on_fate(one, sending))

    def stopped(self, stop: Command, nodes: Iterable[NodeId] | None = None) -> None:
        """Take note that some biobots, or all, are being stopped."""
        now_ns = self._now_ns()
        for node in list(self._on_their_way) if nodes is None else nodes:
            for one in self._on_their_way.get(node, []):
                if one.until_ns > now_ns:
                    self._disarm(one)
                    one.stop = stop
                    one.timer = asyncio.get_running_loop().call_later((one.until_ns - now_ns) / NS_PER_S, self._has_come, one)

    def _on_reply(self, one: _OnItsWay) -> None:
        reply = one.command.reply
        if not reply.cancelled() and is_done(reply.result()):
            self._has_come(one)
        else:
            self._forget(one)

    def _on_fate(self, one: _OnItsWay, sending: Sending) -> None:
        if sending.cancelled():
            return
        fate = sending.result().fate
        if fate is Fate.SENT:
            self._has_come(one)
        elif fate is Fate.NOT_SENT:
            self._forget(one)

    def _has_come(self, one: _OnItsWay) -> None:
        """Stop a biobot once more where a command may have come after a stop; it comes no more."""
        stop, is_watched = one.stop, self._forget(one)
        if stop is not None and is_watched:
            self._stop_again(stop, one.command.request.node)

    def _forget(self, one: _OnItsWay) -> bool:
        self._disarm(one)
        node = one.command.request.node
        watched = self._on_their_way.get(node, [])
        if one not in watched:
            return False
        watched.remove(one)
        if not watched:
            del self._on_their_way[node]
        return True

    @staticmethod
    def _disarm(one: _OnItsWay) -> None:
        if one.timer is not None:
            one.timer.cancel()
        one.stop = one.timer = None

    def _stop_again(self, stop: Command, node: NodeId) -> None:
        self._health.count("command.stopped_again")
        _log.warning("command.stopped_again", command=stop.request.command_id, node=node)
        number = self._take_number()
        request = stop_of(stop.request, node, suffix=f"again-{number:x}")
        again = Command(request=request, key=request.command_id, part_of=stop.request.command_id)
        self._book.begin(again)
        self._book.number(again, number)
        again.reply.add_done_callback(lambda _: self._settle(again))
        self._send(again, n_left=self._table.stop_attempts, end_ns=self._now_ns() + self._rounds_ns())

    def _rounds_ns(self) -> int:
        return self._table.stop_attempts * int(self._table.stop_retry_s * NS_PER_S)

    def _send(self, again: Command, *, n_left: int, end_ns: int, why_unsent: str = "") -> None:
        if again.is_final:
            if not again.finished.is_set():
                self._book.finish(again)  # a newer stop has taken its place
            return
        if not n_left:
            reason = no_answer(n_sent=len(again.sendings), why_unsent=why_unsent)
            self._teller.tell(again, Stage.UNKNOWN if again.sendings else Stage.FAILED, reason=reason)
            self._book.finish(again)
            return
        bare = frames.stop(again, pulse_of(None, self._table), has_train=False)
        node, n_before, why_unsent = again.request.node, len(again.sendings), ""
        try:
            again.sendings.append(self._sender.send(node, bare, is_urgent=True))
        except RadioUnavailableError as error:
            why_unsent = str(error)
            _log.debug("command.unsent_stop", node=node, reason=why_unsent)
        again.sendings += self._sender.send_elsewhere(node, bare)
        n_again = len(again.sendings) - n_before
        if not again.stages:
            self._teller.tell(again, Stage.ACCEPTED, deadline_ns=end_ns, reason="what was sent before the stop may have come after it")
            n_again -= 1
        for _ in range(n_again):
            self._teller.note(again, SENT_AGAIN)

        def send_again() -> None:
            self._send(again, n_left=n_left - 1, end_ns=end_ns, why_unsent=why_unsent)

        asyncio.get_running_loop().call_later(self._table.stop_retry_s, send_again)

    def _settle(self, again: Command) -> None:
        if not again.is_final and not again.reply.cancelled():
            self._answers.settle(again)
            self._book.finish(again)
