"""Times in a unit that is not the one meant: what can be seen of that, in words for whoever gave them. Pure.

Units are never guessed: a log is read as it was said, and who may have meant another one is told what to do.
"""

from collections.abc import Sequence
from math import log10
from typing import Final

import numpy as np

from firmware_protocol.units import NS_PER_S
from mapper.types import EncounterTable, IntArray, ModeSpell

_UNITS: Final = {3: ("milliseconds", "ms"), 6: ("microseconds", "us"), 9: ("nanoseconds", "ns")}
"""By how many powers of ten a second has of them."""
_NEAR: Final = 0.4
"""Spans of modes and encounters of one mission differ by less than this, in powers of ten, or by far more than a unit."""
_FEWEST_INSTANTS: Final = 3
_LONG_S: Final = 1_000.0
"""Of a median contact of whole numbers: insects pass each other within seconds; somebody's week of meetings has a median of minutes."""
_FEWEST_WITH_DECIMALS: Final = 10
"""Contacts; a clock that tells fractions of a second is seldom used for a few meetings of hours, but it may be."""
_ABSURD_S: Final = 1_000_000.0


def doubt_unit(table: EncounterTable, *, has_flag: bool = True) -> tuple[str, ...]:
    """Say that encounters may be in another unit than seconds: whole numbers, or many, and long beyond what contacts are."""
    if not len(table):
        return ()
    median_s = float(np.median(table.t_end_ns - table.t_start_ns)) / NS_PER_S
    is_whole = not ((table.t_start_ns % NS_PER_S).any() or (table.t_end_ns % NS_PER_S).any())
    if median_s < _LONG_S or not (is_whole or len(table) >= _FEWEST_WITH_DECIMALS):
        return ()
    unit, flag = _UNITS[6 if median_s >= _ABSURD_S else 3]
    how = "all times are whole numbers" if is_whole else f"begin within {_s(int(np.ptp(table.t_start_ns)))} s"
    told = f"half of the contacts last {median_s:,.0f} s or more, and {how}: are they {unit}?"
    remedy = f"give --time-unit {flag}, or write seconds" if has_flag else "write seconds"
    return (f"{told} If so, {remedy}; if not, all is well",)


def doubt_modes(table: EncounterTable, spells: Sequence[ModeSpell]) -> tuple[str, ...]:
    """Say that modes and encounters are not of one time: of units that differ, or wholly apart."""
    instants = np.array([t for spell in spells for t in (spell.t_start_ns, spell.t_end_ns) if t is not None], dtype=np.int64)
    if not len(table) or not len(instants):
        return ()
    begin, end = int(table.t_start_ns.min()), int(table.t_end_ns.max())
    spans = f"encounters are from {_s(begin)} to {_s(end)} s, modes from {_s(int(instants.min()))} to {_s(int(instants.max()))} s"
    told = _other_unit(instants, span_ns=end - begin)
    if told is not None:
        return (f"{spans}: {told}",)
    is_touched = any(spell.t_start_ns <= end and (spell.t_end_ns is None or spell.t_end_ns >= begin) for spell in spells)
    if is_touched:
        return ()
    return (f"no spell of --modes touches the time of the encounters: {spans}: write both in seconds of one clock",)


def _other_unit(instants: IntArray, *, span_ns: int) -> str | None:
    """Say which of both is in what unit, where their spans differ by just that."""
    modes_ns = int(instants.max()) - int(instants.min())
    if len(np.unique(instants)) < _FEWEST_INSTANTS or modes_ns <= 0 or span_ns <= 0:
        return None
    ratio = log10(modes_ns) - log10(span_ns)
    power = next((power for power in _UNITS if abs(abs(ratio) - power) <= _NEAR), None)
    if power is None:
        return None
    (unit, flag), times = _UNITS[power], f"{10**power:,}"
    if ratio > 0:
        return f"that is about {times} times as long; if --modes has {unit}, divide its times by {times}"
    return f"that is about {times} times shorter; if the encounters are in {unit}, give --time-unit {flag}"


def _s(t_ns: int) -> str:
    return f"{t_ns / NS_PER_S:,.15g}"
