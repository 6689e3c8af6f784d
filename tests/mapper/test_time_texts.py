"""Times as they are written: read many at once and one by one alike."""

import re
from datetime import UTC, datetime, timedelta
from decimal import Decimal

from hypothesis import given, settings
from hypothesis import strategies as st

from mapper.reading.options import TimeUnit
from mapper.reading.time_blocks import read_dates, read_decimals
from mapper.reading.values import MAX_TIME_NS, MIN_TIME_NS, TimeReader
from tests.mapper.csv_files import times

_dates = st.builds(
    lambda instant, sep, cut, fraction, zone: f"{instant.isoformat(sep=sep)[:cut]}{fraction if cut == 19 else ''}{zone}",
    st.datetimes(datetime(1965, 1, 1), datetime(2090, 1, 1)).map(lambda instant: instant.replace(microsecond=0)),  # noqa: DTZ001  # zones follow
    st.sampled_from(["T", " "]),
    st.sampled_from([19, 19, 16, 10]),
    st.sampled_from(["", ".5", ",25", ".123456789", ".1234567891"]),
    st.sampled_from(["", "Z", "+00:00", "+05:30", "-11:00", " UTC", "+0200"]),
)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_odd = st.sampled_from(
    ["2026-02-30T00:00:00Z", "2026-13-01", "2026-01-01T24:00", "2026-01-01T10:00:60", "20260101T101010Z", "x", "", "12.5"]
)


def _one_by_one(texts: list[str], unit: TimeUnit, *, takes_comma: bool) -> list[object]:
    """Each text by a reader of its own: its time, or that there is none."""
    told: list[object] = []
    for text in texts:
        times, faults = TimeReader("t", unit=unit, takes_comma=takes_comma).read([text])
        told.append(None if faults else int(times[0]))
    return told


@given(st.lists(_dates | _odd, max_size=12))
def test_dates_are_read_at_once_as_one_by_one(texts: list[str]) -> None:
    block = read_dates(texts) if texts else None
    alone = _one_by_one(texts, TimeUnit.SECONDS, takes_comma=False)
    for k, wanted in enumerate(alone):
        assert block is not None
        if block.is_read[k] and MIN_TIME_NS <= block.times_ns[k] <= MAX_TIME_NS:
            assert int(block.times_ns[k]) == wanted


@given(st.lists(times, min_size=1, max_size=12), st.sampled_from(TimeUnit), st.booleans())
@settings(max_examples=60)
def test_numbers_are_read_at_once_as_decimals_are(texts: list[str], unit: TimeUnit, takes_comma: bool) -> None:
    texts = [text.replace(".", ",") for text in texts] if takes_comma else texts
    block = read_decimals(texts, unit_ns=unit.nanoseconds, takes_comma=takes_comma)
    for k in range(len(texts)):
        if block.is_read[k]:
            assert int(block.times_ns[k]) == Decimal(texts[k].replace(",", ".")) * unit.nanoseconds


@given(st.lists(st.integers(0, 9 * 10**12), min_size=1, max_size=9))
def test_plain_milliseconds_are_all_read_at_once(times_ms: list[int]) -> None:
    block = read_decimals([f"{t // 1000}.{t % 1000:03}" for t in times_ms], unit_ns=10**9, takes_comma=False)
    assert block.is_read.all()
    assert block.times_ns.tolist() == [t * 10**6 for t in times_ms]


@given(st.integers(-(10**14), 38 * 10**14).map(lambda us: _EPOCH + timedelta(microseconds=us)))
def test_every_microsecond_of_a_date_survives(instant: datetime) -> None:
    text = instant.isoformat(timespec="microseconds")
    wanted = (instant - _EPOCH) // timedelta(microseconds=1) * 1000
    for form in (text, text.replace("+00:00", "Z"), re.sub(r"[-:](?!\d\d$)", "", text.replace("+00:00", "")) + "Z"):
        times, faults = TimeReader("t", unit=TimeUnit.SECONDS, takes_comma=False).read([form])
        assert (faults, int(times[0])) == ({}, wanted)


def test_a_column_holds_numbers_or_dates_and_what_comes_first_decides() -> None:
    reader = TimeReader("t", unit=TimeUnit.SECONDS, takes_comma=False)
    _, faults = reader.read(["5", "2026-01-01"])
    assert faults == {1: "t is '2026-01-01', but earlier rows have numbers; write all its times alike"}
    _, faults = reader.read(["2026-01-01T00:00Z"])
    assert list(faults) == [0]
