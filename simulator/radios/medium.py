"""One shared channel: who gets to send when, by unslotted CSMA/CA as IEEE 802.15.4 has it; and which packets overlap.

A sender waits a random number of backoff periods, looks whether the channel is free, and sends if it is; if not, it waits again, longer
on average, up to five looks in all. Between its look and its first symbol a radio turns around and is deaf: two that look within that
time collide, and so do two that cannot hear each other. No clock and no randomness but draws keyed by (seed, sender, packet, look).
"""

import heapq
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from simulator import chance
from simulator.legs import Indices

_BACKOFF_STREAM = 241

# IEEE 802.15.4, 2.4 GHz O-QPSK at 250 kbit/s: an octet is two symbols of 16 us; preamble, start of frame and length are six octets.
NS_PER_OCTET = 32_000
PHY_OCTETS = 6
_SYMBOL_NS = 16_000
_BACKOFF_NS = 20 * _SYMBOL_NS  # aUnitBackoffPeriod
_LOOK_NS = 8 * _SYMBOL_NS  # clear channel assessment
_TURNAROUND_NS = 12 * _SYMBOL_NS  # aTurnaroundTime
_MIN_EXPONENT = 3  # macMinBE
_MAX_EXPONENT = 5  # macMaxBE
_MAX_BACKOFFS = 4  # macMaxCSMABackoffs
_LOOKS = _MAX_BACKOFFS + 1


def airtime_ns(n_octets: int) -> int:
    """Return how long a packet with a MAC frame of so many octets is on the air [ns]."""
    return NS_PER_OCTET * (PHY_OCTETS + n_octets)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sending:
    """What became of a request to send.

    Parameters
    ----------
    ticket
        As ``request`` gave it.
    sender, number
        Who, and which of its packets, from 0.
    start_ns, end_ns
        On the air from, until [ns]; both the time of the last look where ``is_sent`` is False: the channel was never free.
    """

    ticket: int
    sender: int
    number: int
    start_ns: int
    end_ns: int
    is_sent: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class _Attempt:
    ticket: int
    sender: int
    number: int
    duration_ns: int

    def end(self, *, start_ns: int, end_ns: int, is_sent: bool) -> Sending:
        return Sending(ticket=self.ticket, sender=self.sender, number=self.number, start_ns=start_ns, end_ns=end_ns, is_sent=is_sent)


@dataclass(slots=True, kw_only=True)
class Medium:
    """Follows all senders in order of time, from look to look.

    Parameters
    ----------
    hears
        Called with listener, talker and time [ns]: does the listener's carrier sense notice the talker? None: all hear all.
    is_shared
        False: everybody sends at once and is alone on the air.
    """

    seed: int
    hears: Callable[[int, int, int], bool] | None = None
    is_shared: bool = True
    _looks: list[tuple[int, int, int, "_Attempt"]] = field(default_factory=list)
    """Heap of end of look [ns], ticket, looks done before."""
    _on_air: list[Sending] = field(default_factory=list)
    _finished: list[tuple[int, int, Sending]] = field(default_factory=list)
    _n_tickets: int = 0
    _n_packets: Counter[int] = field(default_factory=Counter)
    _now_ns: int = 0

    def request(self, sender: int, *, at_ns: int, n_octets: int) -> int:
        """Let ``sender`` begin to try at ``at_ns``, or now if that is past; return a ticket."""
        ticket, number = self._n_tickets, self._n_packets[sender]
        self._n_tickets += 1
        self._n_packets[sender] += 1
        at_ns = max(at_ns, self._now_ns)
        duration_ns = airtime_ns(n_octets)
        if self.is_shared:
            self._plan_look(_Attempt(ticket=ticket, sender=sender, number=number, duration_ns=duration_ns), from_ns=at_ns, n_looks=0)
        else:
            self._finish(Sending(ticket=ticket, sender=sender, number=number, start_ns=at_ns, end_ns=at_ns + duration_ns, is_sent=True))
        return ticket

    def run_until(self, now_ns: int) -> list[Sending]:
        """Return what has ended by ``now_ns``, in order of its end; all that overlaps it has been decided by then too."""
        while self._looks and self._looks[0][0] <= now_ns:
            look_ns, _, n_looks, attempt = heapq.heappop(self._looks)
            if not self._is_busy(attempt.sender, look_ns):
                start_ns = look_ns + _TURNAROUND_NS
                sending = attempt.end(start_ns=start_ns, end_ns=start_ns + attempt.duration_ns, is_sent=True)
                self._on_air.append(sending)
                self._finish(sending)
            elif n_looks + 1 < _LOOKS:
                self._plan_look(attempt, from_ns=look_ns, n_looks=n_looks + 1)
            else:
                self._finish(attempt.end(start_ns=look_ns, end_ns=look_ns, is_sent=False))
        self._now_ns = max(self._now_ns, now_ns)
        done = []
        while self._finished and self._finished[0][0] <= now_ns:
            done.append(heapq.heappop(self._finished)[2])
        return done

    def under_way(self) -> list[Sending]:
        """Return what is on the air, or decided to go there, and has not ended yet."""
        return [one for _, _, one in self._finished if one.is_sent]

    def _plan_look(self, attempt: "_Attempt", *, from_ns: int, n_looks: int) -> None:
        slots = 1 << min(_MIN_EXPONENT + n_looks, _MAX_EXPONENT)
        index = attempt.number * _LOOKS + n_looks
        waited = chance.word(seed=self.seed, biobot=attempt.sender, stream=_BACKOFF_STREAM, index=index) % slots
        heapq.heappush(self._looks, (from_ns + waited * _BACKOFF_NS + _LOOK_NS, attempt.ticket, n_looks, attempt))

    def _is_busy(self, listener: int, look_ns: int) -> bool:
        """Tell whether anything that the listener hears is on the air in the look that ends at ``look_ns``."""
        self._on_air = [one for one in self._on_air if one.end_ns > look_ns - _LOOK_NS]
        return any(
            one.sender == listener or self.hears is None or self.hears(listener, one.sender, look_ns)
            for one in self._on_air
            if one.start_ns < look_ns or one.sender == listener
        )

    def _finish(self, sending: Sending) -> None:
        heapq.heappush(self._finished, (sending.end_ns, sending.ticket, sending))


def find_overlaps(start_ns: Indices, end_ns: Indices, *, subject: Indices) -> tuple[Indices, Indices]:
    """Find all that overlap some packets in time.

    Parameters
    ----------
    start_ns, end_ns
        Of all packets, shape (n,) [ns], in order of start.
    subject
        Rows of the packets in question, shape (k,).

    Returns
    -------
    subject, other
        Shape (m,): place in ``subject``, ascending, and row of a packet that overlaps it.
    """
    longest_ns = int((end_ns - start_ns).max(initial=0))
    low = np.searchsorted(start_ns, start_ns[subject] - longest_ns, side="left")
    high = np.searchsorted(start_ns, end_ns[subject], side="left")
    owner, other = expand(low, high)
    overlaps = (other != subject[owner]) & (end_ns[other] > start_ns[subject[owner]])
    return owner[overlaps], other[overlaps]


def expand(low: Indices, high: Indices) -> tuple[Indices, Indices]:
    """List all numbers of some ranges: the row of the range, shape (m,), and the number; ``low`` and ``high`` have shape (k,)."""
    count = np.maximum(high - low, 0)
    owner = np.repeat(np.arange(low.size), count)
    first = np.cumsum(count) - count
    return owner, np.arange(owner.size) - first[owner] + low[owner]
