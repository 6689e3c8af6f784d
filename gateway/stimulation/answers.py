"""What becomes of a command's frames: radios confirm, the biobot answers, or the time for it passes.

What is known of the train goes into the ledger here: an answer says that it is over, or never was; a frame that was not sent has none.
"""

import asyncio
from collections.abc import Callable
from typing import Any

from firmware_protocol.contract.commands import Stage
from firmware_protocol.messages import StimulateReply, StimulationResult
from firmware_protocol.units import NS_PER_S
from gateway.nodes import mode_of
from gateway.radio import Fate
from gateway.stimulation.commands import Command
from gateway.stimulation.ledger import TrainLedger
from gateway.stimulation.outside import Sending
from gateway.stimulation.telling import StageTeller

_DONE = frozenset({StimulationResult.DONE, StimulationResult.ALREADY_DONE})


class AnswerKeeper:
    """Waits for answers, and tells them."""

    def __init__(self, *, teller: StageTeller, ledger: TrainLedger, now_ns: Callable[[], int]) -> None:
        self._teller = teller
        self._ledger = ledger
        self._now_ns = now_ns

    async def wait(self, command: Command, sendings: list[Sending], *, until_ns: int) -> None:
        """Return when the biobot has answered, when one of the frames has a fate, or at an instant."""
        rest_s = (until_ns - self._now_ns()) / NS_PER_S
        if rest_s <= 0:
            await asyncio.sleep(0)  # an answer may be there that the loop had no time for
        elif not command.reply.done():
            ends: set[asyncio.Future[Any]] = {command.reply, *sendings}
            if command.is_stop:
                ends.add(command.overtaken)  # another stop has taken its place
            await asyncio.wait(ends, timeout=rest_s, return_when=asyncio.FIRST_COMPLETED)

    def settle(self, command: Command) -> None:
        """Tell the biobot's answer as the command's last stage."""
        reply = command.reply.result()
        self.learn(command, reply)
        if not command.is_radio_confirmed and not command.part_of:
            # The answer was quicker than the dongle's own word: what was answered had been sent.
            self._teller.tell(command, Stage.RADIO_CONFIRMED, deadline_ns=self._now_ns())
        if reply.result in _DONE:
            self._teller.tell(command, Stage.BIOBOT_CONFIRMED, mode=mode_of(reply.mode))
        else:
            reason = f"the backpack answers: {reply.result.name.lower()}"
            self._teller.tell(command, Stage.FAILED, reason=reason, mode=mode_of(reply.mode))

    def learn(self, command: Command, reply: StimulateReply) -> None:
        """Take from an answer, in time or late, what it says of the train.

        It speaks of the command, not of a frame. Where several frames of it are on their way, one that has the train may come after the
        backpack has forgotten the command, which it does when it starts anew: then nothing is known but that its radio has delivered it.
        """
        train = command.train
        if train is None:
            return
        is_delivered = _is_sent(command.sendings[0]) if command.sendings else False
        if len(command.sendings) > 1 and not is_delivered:
            return
        if reply.result in _DONE:
            train.latest_ns = min(train.latest_ns, self._now_ns())
        elif not command.is_stop:
            self._ledger.take_back(command.request.node, train)


def is_done(reply: StimulateReply) -> bool:
    """Whether a biobot has obeyed."""
    return reply.result in _DONE


def _is_sent(sending: Sending) -> bool:
    return sending.done() and not sending.cancelled() and sending.result().fate is Fate.SENT
