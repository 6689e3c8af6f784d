"""The part of a backpack's firmware that obeys commands: once each, in time, within limits, no longer than asked (WIRE_FORMAT.md §6.5)."""

from collections import OrderedDict, deque
from dataclasses import dataclass, field

from firmware_protocol.messages import OWN_CHANNEL, Action, Stimulate, StimulationResult, Waveform, WireCause, WireMode

# Pulse limits of this model. Frequency and duration: the RoboRoach firmware's maxima (github.com/BackyardBrains/RoboRoach,
# StimulusGenerator.c). Amplitude: the largest tried on hissing cockroaches by Erickson et al., PLoS ONE 2015. Pulse width, of one phase:
# somewhat above the 9 ms of the RoboRoach.
MAX_FREQUENCY_HZ = 150
MAX_AMPLITUDE_MV = 4_000
MAX_DURATION_MS = 1_000
MAX_PULSE_WIDTH_US = 10_000

CHANNELS = 0b111
"""Both antennae and the cerci."""

WAVEFORMS = 1 << Waveform.SYMMETRIC_BIPHASIC | 1 << Waveform.ASYMMETRIC_BIPHASIC

_MAX_QUEUED = 4
_MAX_REMEMBERED = 32
_US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Actuation:
    """What is done to the insect: by a command, or (None) because a hold is over.

    Parameters
    ----------
    mode
        S: it is made to stand still. CRW: it is let go. None: it is left in the mode it is in, as after a turn.
    action
        What the command asked for.
    train
        The command whose pulse train reaches it; None where there is none.
    """

    mode: WireMode | None
    cause: WireCause
    command: int | None
    action: Action | None = None
    train: Stimulate | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a command; ``actuation`` is None where the insect was left alone, ``command`` where a hold ended."""

    command: int | None
    result: StimulationResult
    decided_ms: int
    actuation: Actuation | None = None


@dataclass(slots=True, kw_only=True)
class Stimulator:
    """Decides on commands.

    ``can_follow_walls``: the backpack has that capability; without it, that action is answered BAD_PARAMETER.

    A stop is executed at once, whatever runs or waits and whatever its pulse parameters (unfit ones stop the insect without a
    train): what waits behind it is answered EXPIRED. Any other command waits while a pulse train runs, at most four of them, and is
    refused if it waits longer than its time to live. DONE says that the train was delivered, not that the insect responded to it. A
    turn without a train, and a pulse that does not fit into its period, is answered BAD_PARAMETER; a train beyond the limits that the
    backpack announces, REFUSED_LIMIT. When the hold of a stop is over, the insect is let go. When that of a start or turn is, whoever
    controlled the motion has gone: the insect is stopped, without a train, and one that runs is cut off. The last 32 commands are
    remembered, so that a repetition is answered and not obeyed.
    """

    can_follow_walls: bool = False
    _known: OrderedDict[int, Outcome] = field(default_factory=OrderedDict)
    _queue: deque[tuple[Stimulate, int]] = field(default_factory=deque)
    _train_until_ms: int = 0
    _hold_until_ms: int | None = None
    _is_held_still: bool = False

    def submit(self, command: Stimulate, *, now_ms: int) -> list[Outcome]:
        """Take a command that has just arrived; return what is decided by now."""
        known = self._known.get(command.command)
        if known is not None:
            was_done = known.result is StimulationResult.DONE
            result = StimulationResult.ALREADY_DONE if was_done else known.result
            return [Outcome(command=command.command, result=result, decided_ms=known.decided_ms)]
        if command.action is Action.STOP:
            overtaken = [self._decide(one, StimulationResult.EXPIRED, now_ms=now_ms) for one, _ in self._queue]
            self._queue.clear()
            return [*overtaken, self._execute(command, now_ms=now_ms)]
        if any(one.command == command.command for one, _ in self._queue):
            return []  # its answer will come when it is decided
        if not self._is_possible(command):
            return [self._decide(command, StimulationResult.BAD_PARAMETER, now_ms=now_ms)]
        if not _is_within_limits(command) or len(self._queue) >= _MAX_QUEUED:
            return [self._decide(command, StimulationResult.REFUSED_LIMIT, now_ms=now_ms)]
        self._queue.append((command, now_ms))
        return self.poll(now_ms=now_ms)

    def poll(self, *, now_ms: int) -> list[Outcome]:
        """Do what is due: end a hold, execute or refuse what waited."""
        outcomes = []
        if self._hold_until_ms is not None and now_ms >= self._hold_until_ms:
            outcomes.append(Outcome(command=None, result=StimulationResult.DONE, decided_ms=now_ms, actuation=self._end_hold(now_ms)))
        kept: deque[tuple[Stimulate, int]] = deque()
        while self._queue:
            command, received_ms = self._queue.popleft()
            if now_ms - received_ms > command.ttl_ms:
                outcomes.append(self._decide(command, StimulationResult.EXPIRED, now_ms=now_ms))
            elif now_ms >= self._train_until_ms:
                outcomes.append(self._execute(command, now_ms=now_ms))
            else:
                kept.append((command, received_ms))
        self._queue = kept
        return outcomes

    def next_due_ms(self) -> int | None:
        """Return when ``poll`` has something to do, or None."""
        dues = [min(self._train_until_ms, received_ms + command.ttl_ms + 1) for command, received_ms in self._queue]
        if self._hold_until_ms is not None:
            dues.append(self._hold_until_ms)
        return min(dues, default=None)

    def _is_possible(self, command: Stimulate) -> bool:
        if command.action is Action.FOLLOW_WALLS and not self.can_follow_walls:
            return False
        is_turn = command.action in {Action.TURN_LEFT, Action.TURN_RIGHT}
        return _is_well_formed(command) and not (is_turn and command.duration_ms == 0)

    def _end_hold(self, now_ms: int) -> Actuation:
        was_held_still, self._is_held_still = self._is_held_still, not self._is_held_still
        self._hold_until_ms = None
        if was_held_still:
            return Actuation(mode=WireMode.CRW, cause=WireCause.NATURAL, command=None)
        self._train_until_ms = min(self._train_until_ms, now_ms)
        return Actuation(mode=WireMode.S, cause=WireCause.COMMAND, command=None)

    def _execute(self, command: Stimulate, *, now_ms: int) -> Outcome:
        has_train = _is_well_formed(command) and _is_within_limits(command) and command.duration_ms > 0
        self._train_until_ms = now_ms + (command.duration_ms if has_train else 0)
        mode: WireMode | None = None
        match command.action:
            case Action.STOP:
                mode, self._is_held_still = WireMode.S, True
            case Action.START | Action.FOLLOW_WALLS:
                mode, self._is_held_still = WireMode.CRW, False
            case Action.TURN_LEFT | Action.TURN_RIGHT:
                pass  # an insect that is held still stays so, whatever it feels
        if not (mode is None and self._is_held_still):
            self._hold_until_ms = now_ms + command.hold_ms if command.hold_ms else None
        train = command if has_train else None
        actuation = Actuation(mode=mode, cause=WireCause.COMMAND, command=command.command, action=command.action, train=train)
        return self._decide(command, StimulationResult.DONE, now_ms=now_ms, actuation=actuation)

    def _decide(self, command: Stimulate, result: StimulationResult, *, now_ms: int, actuation: Actuation | None = None) -> Outcome:
        outcome = Outcome(command=command.command, result=result, decided_ms=now_ms, actuation=actuation)
        self._known[command.command] = outcome
        if len(self._known) > _MAX_REMEMBERED:
            self._known.popitem(last=False)
        return outcome


def _is_well_formed(command: Stimulate) -> bool:
    if command.duration_ms == 0:
        return True  # no train at all
    # All phases of a pulse, each of the pulse width, must fit into one period (WIRE_FORMAT.md §6.5).
    n_phases = 1 if command.waveform is Waveform.MONOPHASIC else 2
    return 0 < n_phases * command.pulse_width_us * command.frequency_hz <= _US_PER_S


def _is_within_limits(command: Stimulate) -> bool:
    if command.duration_ms == 0:
        return True
    has_channel = command.channel == OWN_CHANNEL or bool(CHANNELS >> command.channel & 1)
    return (
        has_channel
        and bool(WAVEFORMS >> command.waveform & 1)
        and command.frequency_hz <= MAX_FREQUENCY_HZ
        and command.pulse_width_us <= MAX_PULSE_WIDTH_US
        and command.amplitude_mv <= MAX_AMPLITUDE_MV
        and command.duration_ms <= MAX_DURATION_MS
    )
