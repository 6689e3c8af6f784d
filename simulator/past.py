"""The past of a world: every leg of every insect, kept as it ends."""

from collections.abc import Sequence

import numpy as np

from simulator.engine.engine import Records
from simulator.errors import ParameterError, TimeError
from simulator.legs import Floats, Legs, in_order, join


class Past:
    """Legs that are over, in the order of their ends; 56 bytes each.

    Parameters
    ----------
    keeps
        False: they are forgotten at once, for worlds without end.
    completed
        Those of an earlier part of the run.
    """

    __slots__ = ("_known", "_parts", "keeps")

    def __init__(self, *, keeps: bool, completed: Legs | None = None) -> None:
        self.keeps = keeps
        self._parts = [] if completed is None else [completed]
        self._known: tuple[float, Legs] | None = None

    def add(self, records: Records) -> None:
        """Take in the legs that have just ended, if any; insects may have new ones, even at the same instant."""
        self._known = None
        if self.keeps and records.size:
            self._parts.append(to_legs(records))

    def completed(self) -> Legs | None:
        """Return all legs that are over, or None where there are none."""
        self._parts = [join(self._parts)] if self._parts else []
        return self._parts[0] if self._parts else None

    def legs(self, current: Records, *, now_s: float) -> Legs:
        """Return all legs by biobot, then start; the ``current`` ones, under way, end at ``now_s`` [s].

        Raises
        ------
        ParameterError
            They are not kept.
        """
        if not self.keeps:
            raise ParameterError(name="keeps_legs", got=False, wanted="True, for places in the past to be told")
        if self._known is None or self._known[0] != now_s:
            current["t_end_s"] = np.minimum(current["t_end_s"], now_s)
            completed = self.completed()
            self._known = now_s, in_order(join([*([] if completed is None else [completed]), to_legs(current)]))
        return self._known[1]


def to_legs(records: Records) -> Legs:
    """Make legs of the engine's records."""
    columns = {name: records[name].copy() for name in ("t_start_s", "t_end_s", "x", "y", "vx", "vy")}
    return Legs(biobot=records["row"].copy(), **columns)


def check_times(t_s: Sequence[float] | Floats, *, now_s: float) -> Floats:
    """Return instants [s] as an array. Raises TimeError where one lies before 0 or after ``now_s``."""
    times = np.asarray(t_s, dtype=np.float64)
    for wrong in times[~((times >= 0) & (times <= now_s))][:1]:
        raise TimeError(got_s=float(wrong), wanted=f"a time from 0 to the present, {now_s!r} s")
    return times
