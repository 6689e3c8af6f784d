"""Times as they are written: numbers of a stated unit, or ISO 8601; both become whole nanoseconds without passing through a float."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal

import numpy as np

from firmware_protocol.units import NS_PER_S
from mapper.reading.options import TimeUnit
from mapper.reading.time_blocks import TimeBlock, read_dates, read_decimals
from mapper.types import IntArray

# Sums of two instants, and a whole span in half nanoseconds, must fit 63 bits. Wall clocks since 1970 are near 1.8e9 s.
MIN_TIME_NS, MAX_TIME_NS = -300_000_000 * NS_PER_S, 4_000_000_000 * NS_PER_S
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?", re.ASCII)
_ISO = re.compile(
    r"(\d{4})-?(\d\d)-?(\d\d)(?:[T ](\d\d):?(\d\d)(?::?(\d\d)(?:[.,](\d{1,9})\d*)?)?)?\s*(Z|UTC|GMT|([+-])(\d\d):?(\d\d)?)?",
    re.ASCII | re.IGNORECASE,
)
_SHOWN_LENGTH = 40


class UnfitValueError(ValueError):
    """A value is not what its column wants; the words say which was wanted."""


class TimeReader:
    """Reads the times of one column and remembers what it met: numbers or dates, with zones or without, a decimal comma.

    Parameters
    ----------
    name
        The column, for messages.
    unit
        Of numbers.
    takes_comma
        Whether a comma is a decimal sign; not where it parts columns.
    is_duration
        Whether the column tells lengths of time: no dates then.
    """

    def __init__(self, name: str, *, unit: TimeUnit, takes_comma: bool, is_duration: bool = False) -> None:
        self._name, self._unit, self._takes_comma, self._is_duration = name, unit, takes_comma, is_duration
        self.has_numbers = self.has_dates = self.lacks_zone = self.has_zone = self.has_comma = False

    def read(self, texts: Sequence[str]) -> tuple[IntArray, dict[int, str]]:
        """Return the time of each text [ns; dates since 1970 UTC], shape (n,), and what is wrong by place: 0 stands there."""
        if not texts:
            return np.zeros(0, dtype=np.int64), {}
        block = self._read_block(texts)
        times, faults = block.times_ns, {}
        known: dict[str, int] = {}
        for place in np.flatnonzero(~block.is_read).tolist():
            text = texts[place]
            time_ns = known.get(text)
            if time_ns is None:
                try:
                    time_ns = self._parse(text.strip())
                except UnfitValueError as fault:
                    faults[place] = str(fault)
                    continue
                known[text] = time_ns
            times[place] = time_ns
        return times, faults

    def _read_block(self, texts: Sequence[str]) -> TimeBlock:
        """Read what is plain, and leave what is out of the limits or of another kind than before to be told one by one."""
        if _is_number(texts[0]):
            block = read_decimals(texts, unit_ns=self._unit.nanoseconds, takes_comma=self._takes_comma)
            is_other_kind = self.has_dates
        elif not self._is_duration:
            block = read_dates(texts)
            is_other_kind = self.has_numbers
        else:
            return TimeBlock(times_ns=np.zeros(len(texts), dtype=np.int64), is_read=np.zeros(len(texts), dtype=np.bool_))
        is_good = block.is_read & (block.times_ns >= MIN_TIME_NS) & (block.times_ns <= MAX_TIME_NS) & (not is_other_kind)
        if is_good.any():
            self.has_numbers = self.has_numbers or not (block.has_zone or block.lacks_zone)
            self.has_dates = self.has_dates or block.has_zone or block.lacks_zone
            self.has_zone, self.lacks_zone = self.has_zone or block.has_zone, self.lacks_zone or block.lacks_zone
            self.has_comma = self.has_comma or block.has_comma
        return TimeBlock(times_ns=np.where(is_good, block.times_ns, 0), is_read=is_good)

    def _parse(self, text: str) -> int:
        time_ns = (
            self._parse_number(text) if _is_number(text.replace(",", ".", 1) if self._takes_comma else text) else self._parse_date(text)
        )
        if not MIN_TIME_NS <= time_ns <= MAX_TIME_NS:
            limits = f"{MIN_TIME_NS // NS_PER_S} to {MAX_TIME_NS // NS_PER_S}"
            raise UnfitValueError(
                f"{self._name} is {shown(text)} {self._unit}; wanted seconds from {limits}; if the unit is another: --time-unit ms"
            )
        return time_ns

    def _parse_number(self, text: str) -> int:
        if self.has_dates:
            raise UnfitValueError(f"{self._name} is {shown(text)}, but earlier rows have dates; write all its times alike")
        self.has_numbers = True
        self.has_comma = self.has_comma or "," in text
        number = Decimal(text.replace(",", "."))
        if abs(number) > 2**63:  # far beyond any time: no need for all its digits
            return 2**63
        return round(number * self._unit.nanoseconds)

    def _parse_date(self, text: str) -> int:
        match = None if self._is_duration else _ISO.fullmatch(text)
        if match is None:
            wanted = "a finite number" if self._is_duration else "a finite number, as 12.5, or ISO 8601, as 2026-05-04T12:00:00.5Z"
            told = "is empty" if not text else f"is {shown(text)}"
            raise UnfitValueError(f"{self._name} {told}; wanted {wanted}")
        if self.has_numbers:
            raise UnfitValueError(f"{self._name} is {shown(text)}, but earlier rows have numbers; write all its times alike")
        year, month, day, hour, minute, second = (int(part or 0) for part in match.groups()[:6])
        fraction, zone, sign, zone_hours, zone_minutes = match.groups()[6:]
        ahead = timedelta(hours=int(zone_hours or 0), minutes=int(zone_minutes or 0))
        try:
            tz = timezone(-ahead if sign == "-" else ahead)
            instant = datetime(year, month, day, hour, minute, second, tzinfo=tz)
            since = instant - _EPOCH
        except (ValueError, OverflowError) as error:
            raise UnfitValueError(f"{self._name} is {shown(text)}: {error}; wanted a date that there is") from error
        self.has_dates = True
        self.has_zone, self.lacks_zone = self.has_zone or zone is not None, self.lacks_zone or zone is None
        return (since.days * 86_400 + since.seconds) * NS_PER_S + int((fraction or "0").ljust(9, "0"))


def read_time(name: str, text: str) -> int:
    """Read one time of a column, seconds or a date [ns].

    Raises
    ------
    UnfitValueError
        It is none.
    """
    times, faults = TimeReader(name, unit=TimeUnit.SECONDS, takes_comma=False).read([text])
    if faults:
        raise UnfitValueError(faults[0])
    return int(times[0])


def _is_number(text: str) -> bool:
    return _NUMBER.fullmatch(text) is not None


def shown(text: str) -> str:
    """Quote a value for a message, cut where it is long."""
    return repr(text if len(text) <= _SHOWN_LENGTH else text[: _SHOWN_LENGTH - 3] + "...")
