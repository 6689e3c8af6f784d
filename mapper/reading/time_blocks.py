"""Many times at once: plain decimals and ISO 8601 dates in columns of bytes; what is not plain is left to be read one by one.

What is read here is what `mapper.reading.values` reads of the same text; a test holds one against the other.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.units import NS_PER_S
from mapper.types import BoolArray, IntArray

ByteMatrix = NDArray[np.uint8]

_MOST_LENGTHS = 40  # with more, texts are not alike and nothing is gained
_LONGEST = 40
_MOST_DIGITS = 18
_DATE = re.compile(rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,](\d{1,9}))?)?(Z|[+-]\d\d:\d\d)?")
_ZERO, _NINE, _DOT, _COMMA, _MINUS = b"09.,-"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimeBlock:
    """Times [ns] of some texts, shape (n,), where ``is_read``; whether any of those read has a zone, or lacks one, or a decimal comma."""

    times_ns: IntArray
    is_read: BoolArray
    has_zone: bool = False
    lacks_zone: bool = False
    has_comma: bool = False


def read_decimals(texts: Sequence[str], *, unit_ns: int, takes_comma: bool) -> TimeBlock:
    """Read numbers of digits with at most one decimal sign, whose last decimal is a whole number of nanoseconds."""
    times, is_read = np.zeros(len(texts), dtype=np.int64), np.zeros(len(texts), dtype=np.bool_)
    has_comma = False
    for rows, matrix in _by_length(texts):
        is_digit = (matrix >= _ZERO) & (matrix <= _NINE)
        is_comma = matrix == _COMMA
        is_sign = (matrix == _DOT) | (is_comma if takes_comma else False)
        n_signs = is_sign.sum(axis=1)
        length = matrix.shape[1]
        place = np.where(n_signs > 0, is_sign.argmax(axis=1), length)
        is_plain = (n_signs <= 1) & (is_digit | is_sign).all(axis=1) & (n_signs < length) & (length - n_signs <= _MOST_DIGITS)
        for at in np.unique(place[is_plain]).tolist():
            chosen = np.flatnonzero(is_plain & (place == at))
            decimals = max(length - at - 1, 0)
            factor, rest = divmod(unit_ns, 10**decimals)
            if rest or not factor:
                continue
            digits = np.delete(matrix[chosen], at, axis=1) if at < length else matrix[chosen]
            numbers = _number(digits)
            fits = numbers <= (2**63 - 1) // factor
            times[rows[chosen[fits]]] = numbers[fits] * factor
            is_read[rows[chosen[fits]]] = True
            has_comma = has_comma or (at < length and bool(is_comma[chosen, at].any()))
    return TimeBlock(times_ns=times, is_read=is_read, has_comma=has_comma)


def read_dates(texts: Sequence[str]) -> TimeBlock:
    """Read dates with hours and minutes, and with seconds, their decimals, and a zone or without."""
    times, is_read = np.zeros(len(texts), dtype=np.int64), np.zeros(len(texts), dtype=np.bool_)
    has_zone = lacks_zone = False
    for rows, matrix in _by_length(texts):
        match = _DATE.fullmatch(matrix[0].tobytes())
        if match is None:
            continue
        zone, fraction = match[4], match[3] or b""
        # Digits where the first has digits, and the same sign elsewhere.
        is_digit = (matrix >= _ZERO) & (matrix <= _NINE)
        is_alike = np.where(is_digit[0], is_digit, matrix == matrix[0]).all(axis=1)
        times_ns, is_valid = _instants(matrix, n_decimals=len(fraction), has_seconds=match[1] is not None, zone=zone)
        good = is_alike & is_valid
        times[rows[good]] = times_ns[good]
        is_read[rows[good]] = True
        has_zone, lacks_zone = has_zone or (zone is not None and bool(good.any())), lacks_zone or (zone is None and bool(good.any()))
    return TimeBlock(times_ns=times, is_read=is_read, has_zone=has_zone, lacks_zone=lacks_zone)


def _instants(matrix: ByteMatrix, *, n_decimals: int, has_seconds: bool, zone: bytes | None) -> tuple[IntArray, BoolArray]:
    """Return instants since 1970 UTC [ns], and which are dates that there are; a date's columns hold digits."""
    columns = (slice(0, 4), slice(5, 7), slice(8, 10), slice(11, 13), slice(14, 16))
    year, month, day, hour, minute = (_number(matrix[:, part]) for part in columns)
    second = _number(matrix[:, 17:19]) if has_seconds else np.zeros(len(matrix), dtype=np.int64)
    fraction = _number(matrix[:, 20 : 20 + n_decimals]) * 10 ** (9 - n_decimals) if n_decimals else 0
    is_valid = (year > 0) & (month >= 1) & (month <= 12) & (day >= 1) & (hour < 24) & (minute < 60) & (second < 60)
    months = np.where(is_valid, (year - 1970) * 12 + month - 1, 0).astype("M8[M]")
    days = months.astype("M8[D]") + (day - 1).astype("m8[D]")
    is_valid &= days.astype("M8[M]") == months
    seconds = days.astype(np.int64) * 86_400 + hour * 3600 + minute * 60 + second
    if zone is not None and zone != b"Z":
        hours, minutes = _number(matrix[:, -5:-3]), _number(matrix[:, -2:])
        is_valid &= (hours < 24) & (minutes < 60)
        seconds = seconds + (1 if zone.startswith(b"-") else -1) * (hours * 3600 + minutes * 60)
    # Far beyond what a log may have; a product that does not fit is not made.
    is_valid &= np.abs(seconds) < 2**33
    return np.where(is_valid, seconds, 0) * NS_PER_S + fraction, is_valid


def _number(digits: ByteMatrix) -> IntArray:
    """Return the numbers that rows of at most 18 digits write."""
    number = np.zeros(len(digits), dtype=np.int64)
    for column in range(digits.shape[1]):
        number = number * 10 + (digits[:, column].astype(np.int64) - _ZERO)
    return number


def _by_length(texts: Sequence[str]) -> Iterator[tuple[IntArray, ByteMatrix]]:
    """Yield the rows of texts of one length, and their bytes, shape (rows, length); nothing where they are not ASCII or not alike."""
    lengths = np.fromiter(map(len, texts), dtype=np.int64, count=len(texts))
    kinds = np.unique(lengths)
    if len(kinds) > _MOST_LENGTHS or kinds[-1] > _LONGEST or not all(map(str.isascii, texts)):
        return
    whole = np.array(texts, dtype=np.bytes_)
    matrix = whole.view(np.uint8).reshape(len(texts), -1)
    for length in kinds[kinds > 0].tolist():
        rows = np.flatnonzero(lengths == length)
        yield rows, matrix[rows, :length]
