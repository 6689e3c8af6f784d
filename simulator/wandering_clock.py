"""A backpack's clock whose rate changes slowly, as a crystal's does with temperature: piecewise linear, monotone, exactly invertible."""

from bisect import bisect_left
from dataclasses import dataclass, field

from firmware_protocol.units import Milliseconds
from simulator import chance
from simulator.errors import ParameterError

_WANDER_STREAM = 244

_PPB = 1_000_000_000
_NS_PER_MS = 1_000_000
_PIECE_NS = 60 * 1_000_000_000
_LARGEST_STEP = 0.2
_MAX_RATE_PPB = _PPB // 2


@dataclass(slots=True, kw_only=True)
class WanderingClock:
    """A millisecond clock as a function of the time since the run began.

    Each minute its rate takes a uniform step of up to a fifth of ``wander_ppb``, and is reflected where it would stray further than
    ``wander_ppb`` from ``drift_ppb``: own choice, a room that warms and cools over ten minutes or more.

    Parameters
    ----------
    start_ms
        What it showed when the run began [ms since the backpack's boot].
    drift_ppb, wander_ppb
        How much faster than true time it runs at first, and how far its rate may stray from that [parts in 10^9].
    seed, node
        For the steps.
    """

    start_ms: int
    drift_ppb: int
    wander_ppb: int
    seed: int
    node: int
    _rates_ppb: list[int] = field(default_factory=list)
    _shown_ns: list[int] = field(default_factory=lambda: [0])
    """What it has gone on by at the beginning of each minute [ns]."""
    _stray: float = 0.0

    def __post_init__(self) -> None:
        if self.wander_ppb < 0 or abs(self.drift_ppb) + self.wander_ppb > _MAX_RATE_PPB:
            raise ParameterError(
                name="drift and wander",
                got=(self.drift_ppb, self.wander_ppb),
                wanted=f"at most {_MAX_RATE_PPB} ppb together, wander not negative",
            )

    def read_ms(self, elapsed_ns: int) -> Milliseconds:
        """Return what the clock shows ``elapsed_ns`` [ns] into the run, rounded down."""
        piece = max(0, elapsed_ns // _PIECE_NS)
        self._extend(piece)
        return Milliseconds(self.start_ms + self._shown_at(piece, elapsed_ns) // _NS_PER_MS)

    def elapsed_ns(self, ms: int) -> int:
        """Return the first instant of the run [ns] at which the clock shows at least ``ms``."""
        wanted_ns = (ms - self.start_ms) * _NS_PER_MS
        while self._shown_ns[-1] < wanted_ns:
            self._extend(len(self._rates_ppb))
        piece = max(0, bisect_left(self._shown_ns, wanted_ns) - 1)
        self._extend(piece)
        rest_ns = wanted_ns - self._shown_ns[piece]
        # The first instant at which the rounded-down reading has got there, in this minute or at the very beginning of the next.
        return piece * _PIECE_NS - (-rest_ns * _PPB // (_PPB + self._rates_ppb[piece]))

    def _shown_at(self, piece: int, elapsed_ns: int) -> int:
        return self._shown_ns[piece] + (elapsed_ns - piece * _PIECE_NS) * (_PPB + self._rates_ppb[piece]) // _PPB

    def _extend(self, piece: int) -> None:
        """Draw rates up to and with that of a minute."""
        while len(self._rates_ppb) <= piece:
            number = len(self._rates_ppb)
            if number:
                step = 2 * chance.uniform(seed=self.seed, biobot=self.node, stream=_WANDER_STREAM, index=number) - 1
                stray = self._stray + _LARGEST_STEP * step
                self._stray = max(-1.0, min(1.0, stray if abs(stray) <= 1 else (2.0 if stray > 0 else -2.0) - stray))
            self._rates_ppb.append(self.drift_ppb + round(self._stray * self.wander_ppb))
            self._shown_ns.append(self._shown_at(number, (number + 1) * _PIECE_NS))
