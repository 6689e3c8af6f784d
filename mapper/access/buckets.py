"""Token buckets: how often somebody may ask. Pure: the clock is an argument."""

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Final

_MAX_KEPT: Final = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """So many at once, and so many a second in the long run."""

    per_s: float
    burst: float


class Buckets:
    """A bucket for each of those who ask. 4,096 are kept; whoever has not asked for longest begins with a full one."""

    def __init__(self, rate: Rate) -> None:
        self.rate = rate
        self._levels: OrderedDict[Hashable, tuple[float, float]] = OrderedDict()

    def take(self, key: Hashable, *, now_s: float) -> float:
        """Take one; return 0, or how long to wait [s] until there is one again. What is refused costs nothing.

        Parameters
        ----------
        now_s
            A clock that never goes back.
        """
        level = self.level(key, now_s=now_s)
        wait_s = 0.0 if level >= 1.0 else (1.0 - level) / self.rate.per_s
        self._levels[key] = (level if wait_s else level - 1.0, now_s)
        self._levels.move_to_end(key)
        if len(self._levels) > _MAX_KEPT:
            self._levels.popitem(last=False)
        return wait_s

    def level(self, key: Hashable, *, now_s: float) -> float:
        """Return how many could be taken now."""
        level, then_s = self._levels.get(key, (self.rate.burst, now_s))
        return min(self.rate.burst, level + (now_s - then_s) * self.rate.per_s)
