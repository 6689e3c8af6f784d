"""When backpacks say who they are: every period of their own clock, from a random phase on, each time a little late at random."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulator import chance, draws
from simulator.draws import Words
from simulator.errors import ParameterError
from simulator.legs import Indices

_PHASE_STREAM = 242
_JITTER_STREAM = 243

BEACON_OCTETS = 27
"""MAC frame of a beacon: header, check sequence, node number and counter, as in a ZigBee data frame without payload."""

SHORTEST_PERIOD_NS = 100_000_000
"""One attempt to send may take some 35 ms; a backpack is to be done with one beacon before the next [ns]."""

_NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class BeaconSchedule:
    """Instants of all beacons on their senders' clocks, which show 0 at the beginning of beacon 0's period.

    Parameters
    ----------
    period_ns
        Between beacons, by the sender's own clock [ns].
    jitter
        Each beacon comes late by a uniform draw up to this share of a period, so that two senders do not collide for ever. Below the
        slack of the gap that loggers tolerate, else beacons that are merely late end encounters.
    """

    seed: int
    period_ns: int
    jitter: float = 0.1

    def __post_init__(self) -> None:
        if self.period_ns < SHORTEST_PERIOD_NS:
            raise ParameterError(name="beacon period", got=f"{self.period_ns / 1e9:g} s", wanted=f"at least {SHORTEST_PERIOD_NS / 1e9:g} s")
        if not 0 <= self.jitter < 1:
            raise ParameterError(name="jitter", got=self.jitter, wanted="a share of a period from 0 up to, not including, 1")

    def due_ns(self, node: Words, number: Words) -> Indices:
        """Return when each node's beacon ``number`` is due on its clock, shape (k,) [ns]."""
        phase = draws.uniform(draws.words(seed=self.seed, biobot=node, stream=_PHASE_STREAM, index=np.zeros_like(node)))
        late = self.jitter * draws.uniform(draws.words(seed=self.seed, biobot=node, stream=_JITTER_STREAM, index=number))
        return number.astype(np.int64) * self.period_ns + (self.period_ns * (phase + late)).astype(np.int64)

    def due_ms(self, node: int, number: int) -> int:
        """Return when one node's beacon is due on its clock, rounded down [ms]."""
        phase = chance.uniform(seed=self.seed, biobot=node, stream=_PHASE_STREAM, index=0)
        late = self.jitter * chance.uniform(seed=self.seed, biobot=node, stream=_JITTER_STREAM, index=number)
        return (number * self.period_ns + int(self.period_ns * (phase + late))) // _NS_PER_MS

    def number_at(self, ms: int) -> int:
        """Return the number of the first beacon whose period begins at ``ms`` or later on the sender's clock."""
        return max(0, -(-ms * _NS_PER_MS // self.period_ns))

    def all_until(self, end_ns: int, *, ids: Sequence[int]) -> tuple[Words, Indices]:
        """List all beacons due before ``end_ns`` on clocks that begin at 0: identities and instants [ns], by node and number."""
        count = max(0, -(-end_ns // self.period_ns))
        node = np.repeat(np.array(ids, dtype=np.uint64), count)
        due_ns = self.due_ns(node, np.tile(np.arange(count, dtype=np.uint64), len(ids)))
        return node[due_ns < end_ns], due_ns[due_ns < end_ns]
