"""A biobot of the histories: the simulator's own stimulator, and a log of all that its electrode and its insect got."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from firmware_protocol.messages import Action, Limits, Stimulate, StimulateReply, StimulationResult, WireMode
from firmware_protocol.units import NS_PER_MS, BootId, Milliseconds, NodeId
from simulator.backpacks.stimulator import Outcome, Stimulator
from studies.gate_histories.virtual_time import TrueTime


@dataclass(slots=True, kw_only=True)
class Actuation:
    """What was done to an insect at an instant of true time; ``train`` is what the electrode gave, None: nothing.

    ``end_ns`` is when the train was over; a restart of the backpack cuts it short.
    """

    node: NodeId
    boot: BootId
    begin_ns: int
    end_ns: int
    command: int | None
    action: Action | None
    mode: WireMode | None
    train: Stimulate | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a backpack says of a command, in the boot in which it says so."""

    node: NodeId
    boot: BootId
    reply: StimulateReply


class Biobot:
    """A backpack and its electrode. A restart takes no time, and all that the backpack knew.

    Parameters
    ----------
    limits
        What it announces; its stimulator keeps the simulator's own limits, and no account of trains.
    can_follow_walls
        It has the capability, and announces it.
    answer
        Is given each answer at the instant at which it is made.
    """

    def __init__(
        self, *, node: NodeId, limits: Limits, can_follow_walls: bool, true_time: TrueTime, answer: Callable[[Answer], None]
    ) -> None:
        self.node = node
        self.limits = limits
        self.can_follow_walls = can_follow_walls
        self.boot = BootId(1)
        self.mode = WireMode.CRW
        self.log: list[Actuation] = []
        self._true_time = true_time
        self._answer = answer
        self._stimulator = Stimulator(can_follow_walls=can_follow_walls)
        self._booted_ns = true_time.now_ns
        self._last: Actuation | None = None
        """Of a command."""

    def now_ms(self) -> Milliseconds:
        """Return the backpack's clock."""
        return Milliseconds((self._true_time.now_ns - self._booted_ns) // NS_PER_MS)

    def receive(self, message: Stimulate, *, is_broadcast: bool) -> None:
        """Take a frame that has just come over the air."""
        if is_broadcast and message.action is not Action.STOP:
            return  # WIRE_FORMAT.md §6.5
        self._settle(self._stimulator.submit(message, now_ms=self.now_ms()))

    def restart(self) -> None:
        """Lose power for a moment: a running train is cut, nothing is remembered, the insect walks or stands as it did."""
        self._cut()
        self.boot = BootId(self.boot + 1)
        self._booted_ns = self._true_time.now_ns
        self._stimulator = Stimulator(can_follow_walls=self.can_follow_walls)

    def _settle(self, outcomes: list[Outcome]) -> None:
        for outcome in outcomes:
            self._log(outcome)
            if outcome.command is not None:
                executed_ms = Milliseconds(outcome.decided_ms)
                reply = StimulateReply(command=outcome.command, result=outcome.result, executed_ms=executed_ms, mode=self.mode)
                self._answer(Answer(node=self.node, boot=self.boot, reply=reply))
        due_ms = self._stimulator.next_due_ms()
        if due_ms is not None:
            boot = self.boot
            self._true_time.at(self._booted_ns + due_ms * NS_PER_MS, lambda: self._poll(boot))

    def _poll(self, boot: BootId) -> None:
        if boot == self.boot and (due_ms := self._stimulator.next_due_ms()) is not None and due_ms <= self.now_ms():
            self._settle(self._stimulator.poll(now_ms=self.now_ms()))

    def _log(self, outcome: Outcome) -> None:
        done = outcome.actuation
        if done is None:
            return
        self.mode = self.mode if done.mode is None else done.mode
        now_ns = self._true_time.now_ns
        if done.action is not None:
            self._cut()  # a stop does not wait for the train that runs
        actuation = Actuation(
            node=self.node,
            boot=self.boot,
            begin_ns=now_ns,
            end_ns=now_ns + (0 if done.train is None else done.train.duration_ms * NS_PER_MS),
            command=done.command,
            action=done.action,
            mode=done.mode,
            train=done.train,
        )
        self.log.append(actuation)
        if done.action is not None:
            self._last = actuation

    def _cut(self) -> None:
        if self._last is not None:
            self._last.end_ns = min(self._last.end_ns, self._true_time.now_ns)


CONFIRMING = frozenset({StimulationResult.DONE, StimulationResult.ALREADY_DONE})
"""Answers by which a command was obeyed."""

Biobots = Mapping[NodeId, Biobot]
