"""A backpack's outgoing messages: numbered, kept and repeated until the base station has them on disk (WIRE_FORMAT.md §5.1)."""

from collections import deque
from dataclasses import dataclass, field

from firmware_protocol.messages import Acknowledge, ConfigurationReport, Hello, Limits, StimulateReply, Uplink
from simulator import chance
from simulator.errors import ParameterError

MAX_WINDOW = 33
"""An Acknowledge covers this many sequence numbers beyond those it calls done (WIRE_FORMAT.md §5.1)."""

_FOR_COMMANDS = 1
_FOR_ANSWERS = 1
MAX_REPORT_WINDOW = MAX_WINDOW - _FOR_ANSWERS - _FOR_COMMANDS
"""Reports leave the last two numbers: one to Hello and ConfigurationReport, and the very last to StimulateReply alone."""

_MODULUS = 1 << 16
_JITTER_STREAM = 201


@dataclass(frozen=True, slots=True, kw_only=True)
class OutboxConfig:
    """When messages are repeated and how many may be under way; the times are those of WIRE_FORMAT.md §5.1.

    Parameters
    ----------
    first_retry_ms, max_retry_ms
        Wait before the first repetition, doubled for each further one up to the second value [ms]; each wait is then
        multiplied by a draw from 0.75 to 1.25, so that backpacks that began together do not collide for ever.
    window
        How far the oldest number outstanding and the newest one given to a report may be apart, both counted. Acknowledged numbers between
        them count too: a base station takes what lies further back for done. Answers have one number more, and answers to commands two.
    max_waiting
        Messages that may wait for a sequence number; half as many answers may besides.
    """

    first_retry_ms: int = 1_000
    max_retry_ms: int = 30_000
    window: int = MAX_REPORT_WINDOW
    max_waiting: int = 32

    def __post_init__(self) -> None:
        if not 1 <= self.window <= MAX_REPORT_WINDOW:
            raise ParameterError(name="window", got=self.window, wanted=f"1 to {MAX_REPORT_WINDOW}")
        if not 1 <= self.first_retry_ms <= self.max_retry_ms:
            raise ParameterError(name="first_retry_ms", got=self.first_retry_ms, wanted=f"1 to max_retry_ms = {self.max_retry_ms}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Copy:
    """One copy of a message, to be sent now."""

    sequence: int
    message: Uplink
    is_first: bool


@dataclass(slots=True, kw_only=True)
class _Outstanding:
    message: Uplink
    due_ms: int
    n_sent: int = 0


@dataclass(slots=True, kw_only=True)
class Outbox:
    """See the module. Numbers begin at 0; a number once given is owed until it is acknowledged, so nothing outstanding is ever dropped."""

    biobot: int
    seed: int
    config: OutboxConfig
    _next_sequence: int = 0
    _outstanding: dict[int, _Outstanding] = field(default_factory=dict)
    _waiting: deque[Uplink] = field(default_factory=deque)
    _later: list[tuple[int, Uplink]] = field(default_factory=list)
    """Answers to a broadcast, and when the random wait of each is over."""
    _n_drawn: int = 0

    @property
    def is_empty(self) -> bool:
        """Everything given to the outbox has been acknowledged."""
        return not self._outstanding and not self._waiting and not self._later

    @property
    def n_free(self) -> int:
        """How many more reports get a number at once."""
        return max(0, self.config.window - self._span - len(self._waiting))

    @property
    def _span(self) -> int:
        """How far the next number is ahead of the oldest one outstanding; 0 where none is."""
        oldest = next(iter(self._outstanding), self._next_sequence)  # numbers are given, and so kept, in order
        return (self._next_sequence - oldest) % _MODULUS

    def _next_waiting(self) -> int | None:
        """Return the place of the message that gets the next number: the oldest that may, so an answer overtakes what must wait."""
        span = self._span
        return next((at for at, one in enumerate(self._waiting) if span < self.config.window + _reserve(one)), None)

    def holds(self, kind: type[Uplink]) -> bool:
        """Tell whether a message of this kind is waiting or not yet acknowledged."""
        return any(isinstance(one, kind) for one in self._waiting) or any(
            isinstance(one.message, kind) for one in self._outstanding.values()
        )

    def put(self, message: Uplink) -> bool:
        """Take a message; return False, and take nothing, where ``max_waiting`` messages wait already, and half as many for an answer."""
        n_more = self.config.max_waiting // 2 if _reserve(message) else 0
        if len(self._waiting) >= self.config.max_waiting + n_more:
            return False
        self._waiting.append(message)
        return True

    def put_once(self, message: Uplink, *, now_ms: int, at_ms: int | None = None) -> bool:
        """Take an answer as ``put`` does, unless one that says the same is under way: that one is sent again.

        Either goes at ``at_ms`` at the earliest, where that is given; of those that wait so, ``max_waiting`` at most.
        """
        due_ms = now_ms if at_ms is None else at_ms
        same = [one for one in self._outstanding.values() if _says_the_same(one.message, message)]
        for one in same:
            one.due_ms = min(one.due_ms, due_ms)
        for at, (later_ms, one_later) in enumerate(self._later):
            if _says_the_same(one_later, message):
                self._later[at] = (min(later_ms, due_ms), one_later)
                return True
        if same or any(_says_the_same(one, message) for one in self._waiting):
            return True
        if due_ms <= now_ms or len(self._later) >= self.config.max_waiting:
            return self.put(message)
        self._later.append((due_ms, message))
        return True

    def take_due(self, now_ms: int) -> list[Copy]:
        """Return what is to be sent now, in order of sequence numbers; each copy's next repetition is planned at once."""
        self._later, over = [one for one in self._later if one[0] > now_ms], [one for one in self._later if one[0] <= now_ms]
        self._waiting.extend(message for _, message in over)
        while (at := self._next_waiting()) is not None:
            self._outstanding[self._next_sequence] = _Outstanding(message=self._waiting[at], due_ms=now_ms)
            del self._waiting[at]
            self._next_sequence = (self._next_sequence + 1) % _MODULUS
        copies = []
        for sequence, one in self._outstanding.items():
            if one.due_ms <= now_ms:
                copies.append(Copy(sequence=sequence, message=one.message, is_first=one.n_sent == 0))
                one.due_ms = now_ms + self._draw_wait_ms(one.n_sent)
                one.n_sent += 1
        return copies

    def next_due_ms(self) -> int | None:
        """Return when ``take_due`` has something to give; None where nothing is kept."""
        if self._next_waiting() is not None:
            return 0
        return min((*(one.due_ms for one in self._outstanding.values()), *(due_ms for due_ms, _ in self._later)), default=None)

    def is_of_given_numbers(self, message: Acknowledge) -> bool:
        """Tell whether an acknowledgement is not of numbers that were never given."""
        ahead = (message.next_sequence - self._next_sequence) % _MODULUS
        return not 0 < ahead < _MODULUS // 2

    def acknowledge(self, message: Acknowledge, *, now_ms: int) -> list[tuple[int, Uplink]]:
        """Forget what the base station has on disk; return it.

        An acknowledgement of numbers never given is ignored whole. One that brings progress shows that the base station
        hears us, so whatever waits for a distant repetition is repeated as if it had been sent only once so far.
        """
        if not self.is_of_given_numbers(message):
            return []
        done = [sequence for sequence in self._outstanding if _covers(message, sequence)]
        acknowledged = [(sequence, self._outstanding.pop(sequence).message) for sequence in done]
        if acknowledged:
            for one in self._outstanding.values():
                if one.n_sent > 1 and one.due_ms > now_ms + self.config.first_retry_ms:
                    one.due_ms = now_ms + self._draw_wait_ms(0)
                    one.n_sent = 1
        return acknowledged

    def hurry(self, *, at_ms: int) -> None:
        """Let no wait for a repetition last longer than until ``at_ms``."""
        for one in self._outstanding.values():
            one.due_ms = min(one.due_ms, at_ms)

    def _draw_wait_ms(self, n_sent: int) -> int:
        self._n_drawn += 1
        wait_ms = min(self.config.first_retry_ms << min(n_sent, 20), self.config.max_retry_ms)
        return max(
            1, int(wait_ms * (0.75 + 0.5 * chance.uniform(seed=self.seed, biobot=self.biobot, stream=_JITTER_STREAM, index=self._n_drawn)))
        )


def _reserve(message: Uplink) -> int:
    """Return how many numbers beyond those of reports a message may have."""
    match message:
        case StimulateReply():
            return _FOR_ANSWERS + _FOR_COMMANDS
        case Hello() | ConfigurationReport():
            return _FOR_ANSWERS
        case _:
            return 0


def _says_the_same(one: Uplink, other: Uplink) -> bool:
    if isinstance(one, StimulateReply) and isinstance(other, StimulateReply):
        return one.command == other.command
    return one == other or (isinstance(one, Limits) and isinstance(other, Limits))  # the voltage in them is no news


def _covers(message: Acknowledge, sequence: int) -> bool:
    ahead = (sequence - message.next_sequence) % _MODULUS
    if ahead >= _MODULUS // 2:
        return True
    return ahead >= 1 and bool(message.bitmap >> (ahead - 1) & 1)
