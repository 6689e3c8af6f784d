"""One table of encounters, written in every form that a log may have."""

import gzip
import io
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import strategies as st

from mapper.reading import ReadingOptions, Role, TimeUnit

Row = tuple[int, int, int, int]
"""Begin and end [ms], and two ids."""

Form = tuple[str, Callable[[Sequence[Row]], bytes], ReadingOptions]

# 2026-01-01 00:00 UTC: dates and numbers are then the same instants.
ZERO_MS = 1_767_225_600_000


@st.composite
def contact_rows(draw: st.DrawFn) -> list[Row]:
    """Contacts between a few nodes, those of one pair apart in time, in any order of rows."""
    ends: dict[tuple[int, int], int] = {}
    rows: list[Row] = []
    for _ in range(draw(st.integers(1, 8))):
        one, other = draw(st.lists(st.integers(1, 12), min_size=2, max_size=2, unique=True))
        pair = (min(one, other), max(one, other))
        start = ends.get(pair, ZERO_MS - 1) + draw(st.integers(1, 10**7))
        ends[pair] = start + draw(st.integers(0, 10**6))
        rows.append((start, ends[pair], one, other))
    return draw(st.permutations(rows))


def _seconds(time_ms: int, *, point: str = ".") -> str:
    return f"{time_ms // 1000}{point}{time_ms % 1000:03}"


def _date(time_ms: int, *, hours: int | None = 0, gap: str = "T") -> str:
    zone = UTC if not hours else timezone(timedelta(hours=hours))
    instant = datetime.fromtimestamp(time_ms // 1000, tz=zone) + timedelta(milliseconds=time_ms % 1000)
    text = instant.replace(tzinfo=None).isoformat(sep=gap)
    return text if hours is None else text + ("Z" if not hours else f"{hours:+03}:00")


def _table(header: str, rows: Sequence[Sequence[object]], *, delimiter: str = ",", end: str = "\n") -> bytes:
    return end.join([*([header] if header else []), *(delimiter.join(map(str, row)) for row in rows), ""]).encode()


def _parquet(columns: dict[str, pa.Array]) -> bytes:
    file = io.BytesIO()
    pq.write_table(pa.table(columns), file)
    return file.getvalue()


def _named(node: int) -> str:
    return f"badge {node}"


NUMBERED = ReadingOptions(columns={Role.START: "3", Role.END: "4", Role.ID1: "1", Role.ID2: "2"})
SAID = ReadingOptions(columns={Role.START: "on", Role.END: "off", Role.ID1: "who", Role.ID2: "whom"}, time_unit=TimeUnit.MILLISECONDS)
PLAIN = ReadingOptions()

FORMS: list[Form] = [
    ("own", lambda rows: _table("t_start_s,t_end_s,id1,id2", [(_seconds(a), _seconds(b), i, j) for a, b, i, j in rows]), PLAIN),
    (
        "semicolons",
        lambda rows: _table("begin;finish;a;b", [(_seconds(a), _seconds(b), j, i) for a, b, i, j in rows], delimiter=";"),
        PLAIN,
    ),
    (
        "commas as decimal signs",
        lambda rows: _table(
            "id_1;id_2;Start;End", [(i, j, _seconds(a, point=","), _seconds(b, point=",")) for a, b, i, j in rows], delimiter=";"
        ),
        PLAIN,
    ),
    ("tabs, ms", lambda rows: _table("node1\tnode2\tt_start_ms\tt_end_ms", [(i, j, a, b) for a, b, i, j in rows], delimiter="\t"), PLAIN),
    ("ms, said", lambda rows: _table("on,off,who,whom,rssi", [(a, b, i, j, -60) for a, b, i, j in rows]), SAID),
    (
        "durations in other units",
        lambda rows: _table("source,target,timestamp,duration_ms", [(i, j, _seconds(a), b - a) for a, b, i, j in rows], end="\r\n"),
        PLAIN,
    ),
    ("dates", lambda rows: _table("user_a,user_b,start_time,end_time", [(i, j, _date(a), _date(b)) for a, b, i, j in rows]), PLAIN),
    (
        "dates of other zones",
        lambda rows: _table(
            "tagA,tagB,startTime,stopTime", [(i, j, _date(a, hours=2), _date(b, hours=-5, gap=" ")) for a, b, i, j in rows]
        ),
        PLAIN,
    ),
    (
        "dates without zone",
        lambda rows: _table("i|j|t1|t2", [(i, j, _date(a, hours=None), _date(b, hours=None)) for a, b, i, j in rows], delimiter="|"),
        PLAIN,
    ),
    (
        "blanks",
        lambda rows: _table("id1  id2   start end", [(i, j, _seconds(a), _seconds(b)) for a, b, i, j in rows], delimiter="  "),
        PLAIN,
    ),
    ("no header", lambda rows: _table("", [(i, j, _seconds(a), _seconds(b), "x") for a, b, i, j in rows]), NUMBERED),
    (
        "comments",
        lambda rows: b"% made by hand\n\n# start,end,id1,id2\n" + _table("", [(_seconds(a), _seconds(b), i, j) for a, b, i, j in rows]),
        PLAIN,
    ),
    (
        "names",
        lambda rows: _table("t_start_s,t_end_s,id1,id2", [(_seconds(a), _seconds(b), _named(i), f" {_named(j)} ") for a, b, i, j in rows]),
        PLAIN,
    ),
    (
        "quotes",
        lambda rows: _table('"start","end","ID1","ID2"', [(f'"{_date(a)}"', f'"{_date(b)}"', f'"{i}"', f'"{j}"') for a, b, i, j in rows]),
        PLAIN,
    ),
    (
        "packed",
        lambda rows: gzip.compress(_table("start,end,id1,id2", [(_seconds(a), _seconds(b), i, j) for a, b, i, j in rows]), mtime=0),
        PLAIN,
    ),
    (
        "Parquet, as the gateway writes it",
        lambda rows: _parquet(
            {
                "node_a": pa.array([row[2] for row in rows]),
                "node_b": pa.array([row[3] for row in rows]),
                "start_wall_ns": pa.array([row[0] * 10**6 for row in rows]),
                "end_wall_ns": pa.array([row[1] * 10**6 for row in rows]),
            }
        ),
        PLAIN,
    ),
    (
        "Parquet, timestamps and names",
        lambda rows: _parquet(
            {
                "start": pa.array([row[0] for row in rows], pa.timestamp("ms", tz="Europe/Zurich")),
                "duration": pa.array([row[1] - row[0] for row in rows], pa.duration("ms")),
                "badge1": pa.array([_named(row[2]) for row in rows]),
                "badge2": pa.array([_named(row[3]) for row in rows]).dictionary_encode(),
            }
        ),
        PLAIN,
    ),
]


def write(path: Path, form: Form, rows: Sequence[Row]) -> ReadingOptions:
    """Write the rows in a form, and return what is to be said when it is read."""
    _, encode, options = form
    path.write_bytes(encode(rows))
    return options
