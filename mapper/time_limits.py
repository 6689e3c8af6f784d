"""Which part of a record a map is of: from an instant, until an instant, and no longer than a window before the newest encounter."""

from dataclasses import dataclass
from math import isfinite

from firmware_protocol.errors import ConfigurationError
from mapper.config import MAX_WINDOW_S
from mapper.types import EncounterTable
from mapper.window import clip_table, window_begin

_NS_PER_S = 1e9
_MIN_WINDOW_S = 0.001
_MAX_INSTANT_S = 4e9  # as of the files of encounters


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeLimits:
    """Instants and lengths [ns, of the record's clock]; None: no limit."""

    window_ns: int | None
    from_ns: int | None
    until_ns: int | None

    def clip(self, table: EncounterTable) -> tuple[EncounterTable, dict[str, float | int | None]]:
        """Return the encounters within the limits, cut there, and what a map's document says of it.

        Notes
        -----
        The window counts from the end of the newest encounter that is left, cut where ``until_ns`` cuts it.
        """
        begun = clip_table(table, until_ns=self.until_ns)
        since_ns = window_begin(begun, window_ns=self.window_ns, since_ns=self.from_ns)
        clipped = clip_table(begun, since_ns=since_ns)
        facts: dict[str, float | int | None] = {
            "window_s": _seconds(self.window_ns),
            "since_s": _seconds(since_ns),
            "until_s": _seconds(self.until_ns),
            "n_before": len(begun) - len(clipped),
            "n_after": len(table) - len(begun),
            "last_encounter_s": _seconds(int(clipped.t_end_ns.max())) if len(clipped) else None,
        }
        return clipped, facts

    def describe(self) -> str | None:
        """Name the limits that there are, for a person; None where there are none."""
        told = (("from", self.from_ns), ("until", self.until_ns), ("the newest", self.window_ns))
        return ", ".join(f"{name} {limit / _NS_PER_S:g} s" for name, limit in told if limit is not None) or None


def make_limits(*, window_s: float | None, from_s: float | None, until_s: float | None) -> TimeLimits:
    """Check limits [s] given on a command line.

    Raises
    ------
    ConfigurationError
        All that is wrong, a line for each.
    """
    faults = []
    if window_s is not None and not (isfinite(window_s) and _MIN_WINDOW_S <= window_s <= MAX_WINDOW_S):
        faults.append(
            f"--window-s is {window_s:g}; wanted {_MIN_WINDOW_S:g} to {MAX_WINDOW_S:g} seconds; leave it out to map all encounters"
        )
    for flag, instant_s in (("--from-s", from_s), ("--until-s", until_s)):
        if instant_s is not None and not (isfinite(instant_s) and abs(instant_s) <= _MAX_INSTANT_S):
            faults.append(f"{flag} is {instant_s:g}; wanted a time of the file in seconds, at most {_MAX_INSTANT_S:g} from zero")
    if not faults and from_s is not None and from_s == until_s:
        faults.append(f"--from-s and --until-s are both {from_s:g}, so nothing lies between; wanted the first before the second")
    if not faults and from_s is not None and until_s is not None and from_s > until_s:
        faults.append(f"--from-s is {from_s:g} and --until-s {until_s:g}; wanted the first before the second; swap them?")
    if faults:
        raise ConfigurationError(faults)
    return TimeLimits(window_ns=_nanoseconds(window_s), from_ns=_nanoseconds(from_s), until_ns=_nanoseconds(until_s))


def _nanoseconds(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * _NS_PER_S)


def _seconds(nanoseconds: int | None) -> float | None:
    return None if nanoseconds is None else nanoseconds / _NS_PER_S
