"""How used to trains an insect is: each train takes a share of what is left of its freshness, and rest gives it back. Pure; an estimate.

The form and its numbers are those of the simulator's insects (docs/stimulation.md). About half of the hissing cockroaches that Erickson et
al. stimulated with 2 V, 50 Hz and half a second did not get used to it at all: of these the estimate is too high.
"""

import math
from dataclasses import dataclass

from firmware_protocol.units import NS_PER_S

PER_TRAIN = 0.05
"""Share of what is left of its freshness that a train takes. Own assumption: no published value."""

RECOVERY_S = 600.0
"""Without trains, habituation falls to 1/e in this time [s]. Own assumption: no published value."""


@dataclass(frozen=True, slots=True)
class Habituation:
    """A level, 0 fresh to 1 fully used to it, and when it was so (UTC)."""

    level: float = 0.0
    wall_ns: int = 0

    def at(self, wall_ns: int) -> float:
        """Return the level at an instant; a clock that was set back gives no rest, and takes none."""
        return self.level * math.exp(-max(0, wall_ns - self.wall_ns) / NS_PER_S / RECOVERY_S)

    def after_train(self, wall_ns: int) -> "Habituation":
        """Return what it is after a train at an instant."""
        before = self.at(wall_ns)
        return Habituation(before + PER_TRAIN * (1.0 - before), wall_ns)
