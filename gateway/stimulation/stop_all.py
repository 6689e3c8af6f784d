"""The stop of everybody: by broadcast over every radio at once, then biobot by biobot, until those within reach have confirmed.

Within reach is who was heard in the last minutes, by an earlier process too: whoever an earlier one left walking walks on (docs/stop.md).

All of it has one number on the wire, so that a biobot that heard several of its frames obeys once. None has a train: the stimulation of a
whole swarm is no way to end one. Those under controlled motion come first, and each radio gets a next frame when it has sent one of those
before: the broadcast of another stop waits for few of them. Of several stops of everybody the newest alone goes on from biobot to biobot.
Those before it, which have told everybody too, end.
"""

import asyncio
import contextlib
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from firmware_protocol.contract.commands import Stage, StimulationRequest
from firmware_protocol.messages import Stimulate
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.errors import RadioUnavailableError
from gateway.journal_file import SENT_AGAIN
from gateway.nodes import NodeBook
from gateway.radio import Fate
from gateway.stimulation import frames
from gateway.stimulation.answers import AnswerKeeper
from gateway.stimulation.commands import Command, CommandBook
from gateway.stimulation.outside import CommandSender, Sending
from gateway.stimulation.parts import stop_of
from gateway.stimulation.pulses import pulse_of
from gateway.stimulation.silence import name_some, no_answer
from gateway.stimulation.stops import Stops
from gateway.stimulation.telling import StageTeller
from gateway.stimulation.turns import Turns

REACHABLE_NS = 300 * NS_PER_S
"""A biobot heard no longer ago than this is within reach: its confirmation is waited for."""

FRAME_S = 0.005
"""What a frame is granted of a round's time: 200 a second, about what a ZigBee channel carries of unicasts with their acknowledgements."""

_MADE_TOGETHER = 32
_TOLD_TOGETHER = 4
_GIVEN_WAY = "a newer stop of all has taken its place; that one's is the answer"
_SPARE_S = 1.0
"""Beside what the rounds take, until the last stage is told."""


class StopAll:
    """Runs stops of everybody."""

    def __init__(
        self,
        *,
        table: StimulationTable,
        sender: CommandSender,
        nodes: NodeBook,
        book: CommandBook,
        stops: Stops,
        teller: StageTeller,
        answers: AnswerKeeper,
        now_ns: Callable[[], int],
        controlled: Callable[[], Iterable[NodeId]],
    ) -> None:
        self._table = table
        self._sender = sender
        self._nodes = nodes
        self._book = book
        self._stops = stops
        self._teller = teller
        self._answers = answers
        self._now_ns = now_ns
        self._controlled = controlled
        self._newest: _Sweep | None = None
        self._turns = Turns()

    async def run(self, whole: Command) -> None:
        """Take a stop of everybody to its last stage."""
        sweep = _Sweep(
            whole=whole,
            table=self._table,
            sender=self._sender,
            turns=self._turns,
            teller=self._teller,
            answers=self._answers,
            now_ns=self._now_ns,
        )
        self._stops.overtake(whole)  # before it is sent: a port that takes it may take the next frame too
        sweep.broadcast()
        sweep.begin(n_known=len(self._nodes))
        if self._newest is not None:
            self._newest.give_way()
        self._newest = sweep
        await asyncio.sleep(0)  # where many came at once, only the last of them goes on
        try:
            for n_before, (is_near, request) in enumerate(self._requests(whole)):
                assert whole.wire_command is not None
                if n_before and n_before % _MADE_TOGETHER == 0:
                    await asyncio.sleep(0)  # others have their turn
                if sweep.has_given_way:
                    break
                part = Command(request=request, key=self._free_key(request.command_id), part_of=whole.request.command_id)
                self._book.begin(part)
                self._book.number(part, whole.wire_command)
                sweep.add(part, is_near=is_near)
            await sweep.run()
        finally:
            if self._newest is sweep:
                self._newest = None
            for part in sweep.parts:
                sweep.let_go(part)
                self._book.finish(part)

    def _requests(self, whole: Command) -> Iterator[tuple[bool, StimulationRequest]]:
        """Yield a stop of each biobot that is known, and whether it is within reach; those under controlled motion first."""
        controlled = dict.fromkeys(self._controlled())
        now_ns = self._now_ns()
        for name in [*controlled, *(node.node for node in self._nodes.all() if node.node not in controlled)]:
            node = self._nodes.find(name)
            if node is not None:
                is_near = (node.last_heard_ns or node.heard_before_ns) >= now_ns - REACHABLE_NS
                yield is_near or name in controlled, stop_of(whole.request, name, suffix=str(name))

    def _free_key(self, command_id: str) -> str:
        key = command_id
        while self._book.find(key) is not None:
            key += " again"
        return key


class _Sweep:
    """One stop of everybody, under way."""

    def __init__(
        self,
        *,
        whole: Command,
        table: StimulationTable,
        sender: CommandSender,
        turns: Turns,
        teller: StageTeller,
        answers: AnswerKeeper,
        now_ns: Callable[[], int],
    ) -> None:
        self.parts: list[Command] = []
        self.has_given_way = False
        self._whole = whole
        self._table = table
        self._sender = sender
        self._turns = turns
        self._teller = teller
        self._answers = answers
        self._now_ns = now_ns
        self._within_reach: list[Command] = []
        self._beyond: dict[NodeId, Command] = {}
        self._hears: dict[NodeId, Callable[[object], None]] = {}
        self._n_silent = 0
        """Those within reach that have not answered."""
        self._n_asked_beyond = 0
        """Others that were sent to and have not answered."""
        self._retry_ns = int(table.stop_retry_s * NS_PER_S)
        self._asked_until_ns = 0
        """By then whoever was sent to for the first time has had the time of an answer."""
        self._news = asyncio.Event()
        self._end_ns = self._sending_ns = 0
        self._why_unsent = "no radio is up"
        self._why_unsent_to: dict[NodeId, str] = {}

    def broadcast(self) -> None:
        """Send to everybody over every radio."""
        for radio, sending in self._sender.send_to_all(self._message(self._whole)).items():
            self._whole.sendings.append(sending)
            sending.add_done_callback(partial(self._on_broadcast, radio))

    def begin(self, *, n_known: int) -> None:
        """Tell that the broadcast is out; the deadline reckons with rounds of so many frames."""
        self._sending_ns = int(n_known * FRAME_S * NS_PER_S)
        round_s = self._table.stop_retry_s + n_known * FRAME_S
        self._end_ns = self._now_ns() + int((self._table.stop_attempts * round_s + _SPARE_S) * NS_PER_S) + self._retry_ns
        self._teller.tell(self._whole, Stage.ACCEPTED, deadline_ns=self._end_ns)

    def add(self, part: Command, *, is_near: bool) -> None:
        """Take the stop of one biobot; one that is not within reach is sent to once, and not waited for."""
        self.parts.append(part)
        if is_near:
            self._within_reach.append(part)
        else:
            self._beyond[part.request.node] = part
        self._n_silent += is_near
        hear = self._hears[part.request.node] = partial(self._on_reply, part, is_near)
        part.reply.add_done_callback(hear)

    def let_go(self, part: Command) -> None:
        """Hear of a part no more: it is remembered for long, and all the others are not to be with it."""
        part.reply.remove_done_callback(self._hears.pop(part.request.node))

    def give_way(self) -> None:
        """Send nothing more: a newer stop of everybody has come."""
        self.has_given_way = True
        self._news.set()

    async def run(self) -> None:
        """Send and wait, round after round, until all within reach have confirmed."""
        for attempt in range(self._table.stop_attempts):
            if attempt and not self.has_given_way:
                self.broadcast()
            # Those first to whom nothing was sent yet: a radio that is slow may have come to an end before them.
            await self._send_round(sorted([*self._silent(), *self._unsent()], key=_n_sent))
            if self._is_over:
                break
        await self._wait(lambda: self._has_all_answers, until_ns=self._asked_until_ns)
        await self._end()

    async def _send_round(self, parts: list[Command]) -> None:
        """Send stops over all their radios at once, and wait for the answers; a radio that is slow goes on until the round ends."""
        lanes = [asyncio.create_task(self._send_by(radio, its)) for radio, its in self._by_radio(parts).items()]
        for lane in lanes:
            lane.add_done_callback(lambda _: self._news.set())

        def has_sent() -> bool:
            return self.has_given_way or all(lane.done() for lane in lanes) or (self._is_over and not self._unsent())

        try:
            await self._wait(has_sent, until_ns=self._now_ns() + self._sending_ns)
            await self._wait(lambda: self._is_over, until_ns=self._now_ns() + self._retry_ns)
        finally:
            for lane in lanes:
                lane.cancel()
            await asyncio.gather(*lanes, return_exceptions=True)

    @property
    def _is_over(self) -> bool:
        """There is nothing more to wait for."""
        if self.has_given_way:
            return True
        has_asked = not self._n_asked_beyond or self._now_ns() >= self._asked_until_ns
        return has_asked and not self._n_silent and self._whole.is_radio_confirmed

    @property
    def _has_all_answers(self) -> bool:
        return self.has_given_way or not (self._n_silent or self._n_asked_beyond)

    def _by_radio(self, parts: list[Command]) -> dict[str, list[Command]]:
        lanes: dict[str, list[Command]] = {}
        for part in parts:
            for radio in self._sender.ways_to(part.request.node):
                lanes.setdefault(radio, []).append(part)
        return lanes

    async def _send_by(self, radio: str, parts: list[Command]) -> None:
        """Send stops over one radio, as it takes them."""
        for part in parts:
            if part.is_final:
                continue
            await self._turns.wait_for(radio)
            if self.has_given_way:
                return
            if not part.is_final:
                self._stop(part, radio)

    def _silent(self) -> list[Command]:
        return [part for part in self._within_reach if not part.is_final]

    def _unsent(self) -> list[Command]:
        """Return those out of reach that nothing was sent to yet."""
        return [part for part in self._beyond.values() if not part.is_final and not part.sendings]

    def _message(self, command: Command) -> Stimulate:
        return frames.stop(command, pulse_of(command.request.pulse, self._table), has_train=False)

    def _stop(self, part: Command, radio: str) -> None:
        sending: Sending | None = None
        try:
            sending = self._sender.send_over(radio, part.request.node, self._message(part))
        except RadioUnavailableError as error:
            self._why_unsent = self._why_unsent_to[part.request.node] = str(error)
        else:
            self._why_unsent_to.pop(part.request.node, None)
            if not part.sendings:
                self._asked_until_ns = self._now_ns() + self._retry_ns
                self._n_asked_beyond += part.request.node in self._beyond
            part.sendings.append(sending)
            self._turns.begin(radio, sending)
        if not part.stages:
            self._teller.tell(part, Stage.ACCEPTED, deadline_ns=self._end_ns)
        elif sending is not None:
            self._teller.note(part, SENT_AGAIN)
        if sending is not None:
            sending.add_done_callback(partial(self._on_sent, part))

    async def _wait(self, is_over: Callable[[], bool], *, until_ns: int) -> None:
        """Wait until something is so, or until an instant."""
        while not is_over() and (rest_s := (until_ns - self._now_ns()) / NS_PER_S) > 0:
            self._news.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(rest_s):
                    await self._news.wait()

    def _on_broadcast(self, radio: str, sending: Sending) -> None:
        if _is_sent(sending) and not self._whole.is_final and not self._whole.is_radio_confirmed:
            self._teller.tell(self._whole, Stage.RADIO_CONFIRMED, reason=f"radio {radio} has told everybody", deadline_ns=self._end_ns)
            self._news.set()

    def _on_sent(self, part: Command, sending: Sending) -> None:
        if _is_sent(sending) and not part.is_final and not part.is_radio_confirmed:
            self._teller.tell(part, Stage.RADIO_CONFIRMED, deadline_ns=self._end_ns)

    def _on_reply(self, part: Command, is_near: bool, _reply: object) -> None:  # noqa: FBT001  # given in order, by partial and future
        if part.is_final or part.reply.cancelled():
            return
        if not part.stages:
            self._teller.tell(part, Stage.ACCEPTED, deadline_ns=self._end_ns)
        self._answers.settle(part)
        self._n_silent -= is_near
        self._n_asked_beyond -= not is_near and bool(part.sendings)
        self._news.set()

    async def _end(self) -> None:
        """Tell the last stages, of the parts and then of the whole."""
        for place, part in enumerate(self.parts):
            if place and place % _TOLD_TOGETHER == 0:
                await asyncio.sleep(0)  # others have their turn
            if part.is_final or (self.has_given_way and not part.stages):
                continue  # of what was told nothing there is no end
            if self.has_given_way:
                self._teller.tell(part, Stage.UNKNOWN, reason=_GIVEN_WAY)
                continue
            n_sent, n_broadcasts = len(part.sendings), len(self._whole.sendings)
            why_unsent = self._why_unsent_to.get(part.request.node, "")
            reason = no_answer(n_sent=n_sent, n_broadcasts=n_broadcasts, why_unsent=why_unsent)
            self._teller.tell(part, Stage.UNKNOWN if n_sent or n_broadcasts else Stage.FAILED, reason=reason)
        if not self._whole.is_final:  # else the gateway ends
            stage, reason = self._outcome()
            self._teller.tell(self._whole, stage, reason=reason)

    def _outcome(self) -> tuple[Stage, str]:
        """Return the last stage of the whole, when its parts have ended, and the reason.

        Who did not confirm was silent, unwilling, or left to newer stops. That nobody did says nothing of those who are known.
        """
        if not any(one.sendings for one in (self._whole, *self.parts)):
            return Stage.FAILED, f"nothing could be sent: {self._why_unsent}; look at the animals and the radios"
        if self.has_given_way:
            return Stage.UNKNOWN, _GIVEN_WAY
        silent = [part.request.node for part in self._within_reach if not _has_confirmed(part)]
        beyond = [part.request.node for part in self._beyond.values() if not _has_confirmed(part)]
        others = f"{len(beyond)} others were not heard of late, and did not confirm either: {name_some(beyond)}" if beyond else ""
        n_confirmed = len(self.parts) - len(silent) - len(beyond)
        if silent:
            reason = f"{len(silent)} of {len(self._within_reach)} biobots within reach did not confirm: {name_some(silent)}; look at them"
            return Stage.UNKNOWN, "; ".join(filter(None, (reason, others)))
        if beyond and not n_confirmed:
            return Stage.UNKNOWN, f"nobody has confirmed: none of {name_some(beyond)} was heard of late; look at them"
        if self.parts:
            return Stage.BIOBOT_CONFIRMED, "; ".join(filter(None, (f"all {n_confirmed} biobots within reach have confirmed", others)))
        if self._whole.is_radio_confirmed:
            return Stage.BIOBOT_CONFIRMED, "no biobot is known here; whoever heard the broadcast stands"
        return Stage.UNKNOWN, "no radio says that it has told everybody; look at the animals"


def _has_confirmed(part: Command) -> bool:
    return bool(part.stages) and part.stages[-1].stage is Stage.BIOBOT_CONFIRMED


def _n_sent(part: Command) -> int:
    return len(part.sendings)


def _is_sent(sending: Sending) -> bool:
    return not sending.cancelled() and sending.done() and sending.result().fate is Fate.SENT
