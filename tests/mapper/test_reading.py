"""Logs from elsewhere: every form of one table is the same table, and what is wrong is told with its place."""

import gzip
import os
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.journal_export.rows import COLUMNS, Kind
from gateway.journal_export.tables import write_csv, write_parquet
from mapper.encounter_csv import read_encounters, read_modes
from mapper.errors import InputFileError
from mapper.reading import NodeNames, ProximityLog, ReadingOptions, Role, TimeUnit, parse_columns, read_ids, read_log, read_time
from mapper.reading.column_names import NAMES_OF_TIMES, find_layout
from mapper.types import EncounterTable, KernelsKind
from tests.mapper.csv_files import odd_files, plain_files
from tests.mapper.log_files import FORMS, ZERO_MS, Form, Row, contact_rows, write

S = 1_000_000_000


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs") / "log"


def _log(path: Path, content: str | bytes, options: ReadingOptions | None = None) -> ProximityLog:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_log(path, options)


def _fault(path: Path, content: str | bytes, options: ReadingOptions | None = None) -> str:
    with pytest.raises(InputFileError) as caught:
        _log(path, content, options)
    assert all(line.startswith(f"{path}: ") for line in str(caught.value).splitlines())
    return caught.value.faults[0]


def _rows(table: EncounterTable) -> list[tuple[int, ...]]:
    columns = (table.t_start_ns, table.t_end_ns, table.id1, table.id2)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _named_rows(log: ProximityLog) -> list[tuple[int, int, str, str]]:
    return [(start, end, log.names.name(one), log.names.name(other)) for start, end, one, other in _rows(log.table)]


@pytest.mark.parametrize("form", FORMS, ids=[form[0] for form in FORMS])
@given(rows=contact_rows())
@settings(max_examples=25)
def test_every_form_of_one_table_is_the_same_table(path: Path, form: Form, rows: Sequence[Row]) -> None:
    options = write(path, form, rows)
    log = read_log(path, options)
    wanted = sorted((start * 10**6, end * 10**6, min(one, other), max(one, other)) for start, end, one, other in rows)
    # Names are numbered in the order of the numbers in them: the names come back, and so does the order.
    names = {node: f"badge {node}" if log.names.text_of else str(node) for row in wanted for node in row[2:]}
    assert _named_rows(log) == [(start, end, names[one], names[other]) for start, end, one, other in wanted]


@given(plain_files())
@settings(max_examples=40)
def test_a_file_with_own_columns_is_read_as_its_own_reader_does(path: Path, text: str) -> None:
    path.write_bytes(text.encode())
    # A row that is there twice counts once in a log from elsewhere; the reader of own files takes all.
    assert _rows(read_log(path).table) == list(dict.fromkeys(_rows(read_encounters(path))))


@given(odd_files())
@settings(max_examples=60)
@example(b"t_start_s,t_end_s,id1,id2\r1,2,3,4\n5,6,7,8\n")
@example(b"t_start_s,t_end_s,id1,id2\r1,2,3,4\r")
@example(b'"t_start_s",t_end_s,id1,id2,"\n"\n1,2,3,4\n')
@example(b"\n \n\xef\xbb\xbft_start_s,t_end_s,id1,id2\n1,2,3,4\n")
def test_what_its_own_reader_takes_is_taken_alike(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    wanted: list[tuple[int, ...]] | None = None
    with suppress(InputFileError):
        wanted = _rows(read_encounters(path))
    if wanted is not None:
        assert _rows(read_log(path).table) == wanted


@given(rows=contact_rows(), form=st.sampled_from(FORMS))
@settings(max_examples=60)
def test_plain_kernels_read_the_same(path: Path, rows: Sequence[Row], form: Form) -> None:
    options = write(path, form, rows)
    quick, slow = (read_log(path, options, kernels=kind) for kind in (KernelsKind.COMPILED, KernelsKind.PLAIN))
    assert (_named_rows(quick), quick.form, quick.warnings) == (_named_rows(slow), slow.form, slow.warnings)


@given(st.lists(st.text(max_size=12), min_size=2, max_size=6, unique_by=str.strip))
def test_names_survive(path: Path, texts: list[str]) -> None:
    """Any text without line ends is a name, but for blanks around it; whole numbers alone stay numbers."""
    texts = [text.strip() for text in texts if text.strip() and text.isprintable()]
    if len(texts) < 2:
        return
    quoted = ['"' + text.replace('"', '""') + '"' for text in texts]
    log = _log(
        path, "start,end,id1,id2\n" + "".join(f"{k},{k},{quoted[0]},{name}\n" for k, name in enumerate(quoted[1:])) + "9,9,zzz,yyy\n"
    )
    assert {frozenset(row[2:]) for row in _named_rows(log)} == {
        *(frozenset((texts[0], text)) for text in texts[1:]),
        frozenset(("zzz", "yyy")),
    }
    assert all(log.names.name(number) == text and log.names.number_of(text) == number for number, text in log.names.text_of.items())


def test_names_are_numbered_in_the_order_of_the_numbers_in_them(path: Path) -> None:
    log = _log(path, "start,end,id1,id2\n0,1,b10,b2\n2,3,b2,a\n")
    assert log.names.text_of == {1: "a", 2: "b2", 3: "b10"}


@pytest.mark.parametrize("tick_s", [20, 300])
@given(rows=contact_rows())
@settings(max_examples=40)
def test_sightings_come_together_to_the_contacts_that_they_are_of(path: Path, tick_s: int, rows: Sequence[Row]) -> None:
    """Contacts begin on the tick and last for 9 ticks at least, so that the tick shows; pairs are apart by more than the gap."""
    contacts: list[tuple[int, int, int, int]] = []
    ends: dict[tuple[int, int], int] = {}
    for start, end, one, other in sorted(rows):
        pair = (min(one, other), max(one, other))
        begin = max((start - ZERO_MS) // 10**5, ends.get(pair, -(10**9)) + 4)
        ends[pair] = begin + 9 + (end - start) // 10**5
        contacts.append((begin * tick_s, ends[pair] * tick_s, *pair))
    seen = sorted((t, one, other) for begin, end, one, other in contacts for t in range(begin, end + 1, tick_s))
    header = "" if len({t for t, _, _ in seen}) > 1 and any(a[2] > b[2] for a, b in pairwise(seen)) else "t i j\n"
    log = _log(path, header + "".join(f"{t} {one} {other}\n" for t, one, other in seen))
    assert sorted(_rows(log.table)) == sorted((begin * S, end * S, one, other) for begin, end, one, other in contacts)
    assert log.tick_ns == tick_s * S
    assert log.warnings == ()


def test_a_gap_that_is_said_parts_and_joins_sightings(path: Path) -> None:
    text = "t,a,b\n" + "".join(f"{t},1,2\n" for t in (0, 10, 20, 60))
    assert [row[:2] for row in _rows(_log(path, text, ReadingOptions(gap_ns=40 * S)).table)] == [(0, 60 * S)]
    assert [row[:2] for row in _rows(_log(path, text, ReadingOptions(gap_ns=10 * S)).table)] == [(0, 20 * S), (60 * S, 60 * S)]
    assert len(_log(path, text, ReadingOptions(gap_ns=0)).table) == 4


def test_scans_by_bluetooth_count_pairs_once_and_nobody_never(path: Path) -> None:
    """As the Copenhagen Networks Study publishes them: -1 is an empty scan, -2 a device that takes no part; both sides may tell."""
    scans = "".join(f"{300 * k},7,9,-61\n{300 * k},9,7,-66\n{300 * k},7,-1,0\n{300 * k},-2,7,-70\n" for k in range(12))
    log = _log(path, "# timestamp,user_a,user_b,rssi\n" + scans)
    assert _rows(log.table) == [(0, 3300 * S, 7, 9)]
    assert log.tick_ns == 300 * S
    assert log.warnings == ("24 rows with an id below 0 are left out: such ids stand for nobody, or for a device that takes no part",)
    assert log.ignored_columns == ("rssi",)


def test_readers_are_places_and_their_numbers_are_not_those_of_tags(path: Path) -> None:
    log = _log(path, "reader,tag,time\n1,1,0\n1,1,5\n2,1,60\n1,2,61\n")
    assert log.place_column == "reader"
    assert [log.names.name(place) for place in log.places] == ["reader:1", "reader:2"]
    assert {row[2:] for row in _named_rows(log)} == {("1", "reader:1"), ("1", "reader:2"), ("2", "reader:1")}
    apart = _log(path, "animal_id,feeder,start,end\ncow 3,north,0,5\ncow 4,south,1,2\n")
    assert [apart.names.name(place) for place in apart.places] == ["north", "south"]


def test_rows_of_one_contact_are_one(path: Path) -> None:
    log = _log(path, "start,end,id1,id2\n0,5,1,2\n0,5,2,1\n3,9,1,2\n9,9,1,2\n4,4,1,2\n20,21,1,2\n0,9,1,3\n6,6,8,8\n")
    assert _rows(log.table) == [(0, 9 * S, 1, 2), (0, 9 * S, 1, 3), (20 * S, 21 * S, 1, 2)]
    assert log.warnings == (
        "1 row is of an id with itself, the first in line 9; left out",
        "1 row repeats another one of the same pair and times; each counts once",
        "3 rows overlap or touch another one of the same pair; each such group is one contact",
    )


def test_what_had_to_be_assumed_is_told(path: Path) -> None:
    log = _log(path, "start;end;id1;id2\n2026-03-29 01:59:59,5;2026-03-29 03:00;Anna;bob\n2026-03-30;2026-03-30;anna;Bob 1.0\n")
    assert _rows(log.table)[0][:2] == (1774749599_500_000_000, 1774753200 * S)
    assert [warning.split(";")[0].split(" and are")[0] for warning in log.warnings] == [
        "dates have no time zone",
        "ids differ only in case, blanks or zeros and count as different: 'Anna' and 'anna'",
    ]
    assert "dates by ISO 8601" in log.form


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("start,end,id1,id2\n1,2,a,b\n3,2,a,b\n", "line 3: end 2 is before start 3"),
        ("start,end,id1,id2\n1,x,a,b\n", "line 2: end is 'x'; wanted a finite number, as 12.5, or ISO 8601"),
        ("start,end,id1,id2\n1,,a,b\n", "line 2: end is empty; wanted a finite number"),
        ("start,end,id1,id2\n1,2,a,\n", "line 2: id2 is empty; wanted an id"),
        ("start,end,id1,id2\n1,2,a\n", "line 2: 3 fields, so id2 is missing; wanted start,end,id1,id2"),
        ("start,end,id1,id2\n1,2,a,b,c\n", "line 2: 5 fields, but the header names 4"),
        ("start,end,id1,id2\n1,2026-01-01,a,b\n2,3,a,b\n", "line 3: end is '3', but earlier rows have dates; write all its times alike"),
        ("start,end,id1,id2\n2026-02-30T00:00Z,2026-03-01,a,b\n", "line 2: start is '2026-02-30T00:00Z': day is out of range for month"),
        ("start,end,id1,id2\n29.03.2026 10:00,29.03.2026 10:05,a,b\n", "line 2: start is '29.03.2026 10:00'; wanted a finite number"),
        (
            "t,a,b\n1767225600000,1,2\n",
            "line 2: t is '1767225600000' s; wanted seconds from -300000000 to 4000000000; if the unit is another: --time-unit ms",
        ),
        ("t,duration,a,b\n5,-1,1,2\n", "line 2: duration is '-1'; wanted 0 or more"),
        ('start,end,id1,id2\n1,2,a,"b\n', "line 2: not a CSV row: unexpected end of data; is a quote not closed?"),
        ("start,end,id1,id2\n" + 12 * "x,1,a,b\n", "line 2: start is 'x'"),
        ("# nothing\n\n", "line 1: the file is empty"),
        ("a,b,c\n1,2,3\n", "line 1: the header 'a,b,c' lacks t_start_s, t_end_s, or other names"),
        ("start,end,foo,bar\n", "line 1: the header 'start,end,foo,bar' lacks id1, id2, or other names"),
        ("1,2,3,4\n", "line 1: the header '1,2,3,4' lacks t_start_s, t_end_s, id1, id2"),
        ("5 1 2\n3 1 9\n", "line 1: the header '5,1,2' lacks"),
        ("1 2 5\n2 3 6\n", "line 1: the header '1,2,5' lacks"),
        ("start,end,id1,id2,a,b\n1,2,3,4,5,6\n", "line 1: ids may be a, b and id1, id2; say which: --columns id1=…,id2=…"),
        ("time,date,a,b\n", "line 1: t may be time, date; say which: --columns t=…"),
        ("t_start_s,t_end_s,id1,id2\n1,2,5,5\n", "line 2: id1 and id2 are both 5; an encounter has two biobots"),
        ("t_start_s,t_end_s,id1,id2\n1,2,5,-1\n", "1 rows have an id below 0; wanted whole numbers"),
        ("start,end,id1,id2\n\xff".encode("latin-1"), "line 2: byte 0xff is not UTF-8 text; is this a CSV file?"),
        (gzip.compress(b"start,end,id1,id2\n", mtime=0)[:-9], "cannot be unpacked: compressed file ended"),
        (b"PAR1" + bytes(20), "not a Parquet file that can be read"),
    ],
)
def test_what_is_wrong_is_told_with_line_column_value_and_next_step(path: Path, content: str | bytes, reason: str) -> None:
    assert _fault(path, content).startswith(reason)


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        (
            "t_start=on,t_end=end,id1=a,id2=b",
            "line 1: column 'on' was named for t_start, but it is not there; the columns are 'start,end,a,b'",
        ),
        ("t_start=1,t_end=9,id1=2,id2=3", "line 1: column 9 was named for t_end, but there are 4; count from 1 to 4"),
        ("t_start=1,id1=2,id2=3", "line 1: where columns are given by number, all must be"),
    ],
)
def test_columns_that_are_not_there_are_told(path: Path, columns: str, reason: str) -> None:
    assert _fault(path, "start,end,a,b\n1,2,3,4\n", ReadingOptions(columns=parse_columns(columns))).startswith(reason)


def test_a_unit_that_contradicts_its_column_is_refused(path: Path) -> None:
    fault = _fault(path, "t_ms,a,b\n1,2,3\n", ReadingOptions(time_unit=TimeUnit.SECONDS))
    assert fault == "line 1: column t_ms states ms, but --time-unit s was given; leave it out"


@pytest.mark.parametrize("text", ["", "x", "id1=", "who=a", "id1=a", "id1=a,id1=b", "t=a,t_start=b", "t_end=a,duration=b", "id2=a,t=b"])
def test_columns_that_make_no_encounter_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"wanted|name|given"):
        parse_columns(text)


def test_columns_are_read_as_they_are_said() -> None:
    assert parse_columns("t=when, id1 = who,id2=whom") == {Role.INSTANT: "when", Role.ID1: "who", Role.ID2: "whom"}


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"start": [1.0, 3.0], "end": [2.0, 2.0], "id1": ["a", "a"], "id2": ["b", "b"]}, "row 2: end is before start"),
        ({"start": [1.0, None], "end": [2.0, 2.0], "id1": ["a", "a"], "id2": ["b", "b"]}, "row 2: start is empty; wanted seconds"),
        (
            {"start": [1.0, float("nan")], "end": [2.0, 2.0], "id1": ["a", "a"], "id2": ["b", "b"]},
            "row 2: start is 'nan' s; wanted seconds",
        ),
        (
            {"start": [1, 10**12], "end": [2, 10**12], "id1": ["a", "a"], "id2": ["b", "b"]},
            "row 2: start is '1000000000000' s; wanted seconds",
        ),
        ({"start": [1.0], "end": [2.0], "id1": [None], "id2": ["b"]}, "row 1: id1 is empty; wanted an id"),
        ({"t": ["x"], "id1": [1], "id2": [2]}, "row 1: t is 'x'; wanted a finite number"),
        ({"t": [True], "id1": [1], "id2": [2]}, "schema: t is of type bool; wanted numbers, timestamps, or text"),
        ({"when_it_was": [1], "id1": [1], "id2": [2]}, "schema: the header 'when_it_was,id1,id2' lacks t_start_s, t_end_s"),
    ],
)
def test_what_is_wrong_in_parquet_is_told_with_its_row(path: Path, columns: dict[str, list[object]], reason: str) -> None:
    pq.write_table(pa.table(columns), path)
    with pytest.raises(InputFileError) as caught:
        read_log(path)
    assert caught.value.faults[0].startswith(reason)


def test_floats_in_parquet_are_the_decimals_that_they_stand_for(path: Path) -> None:
    pq.write_table(pa.table({"t": [0.1, 1234567.3, 20.0], "id1": [1.0, 2.0, float("nan")], "id2": [4, 5, 6]}).slice(0, 2), path)
    assert [row[0] for row in _rows(read_log(path).table)] == [100_000_000, 1_234_567_300_000_000]


def test_what_the_gateway_exports_is_read(tmp_path: Path) -> None:
    columns = COLUMNS[Kind.ENCOUNTERS]
    values = {"node_a": 5, "node_b": 3, "start_wall_ns": 1_767_225_600_123_456_789, "end_wall_ns": 1_767_225_601_000_000_001}
    filler: dict[type, int | str | bool] = {int: 1, str: "g", bool: False}
    row = tuple(values.get(name, filler[kind]) for name, kind in columns.items())
    write_csv(tmp_path / "journal.csv", columns, [row])
    write_parquet(tmp_path / "journal.parquet", columns, [row])
    for name in ("journal.csv", "journal.parquet"):
        assert _rows(read_log(tmp_path / name).table) == [(values["start_wall_ns"], values["end_wall_ns"], 3, 5)]


def test_a_pipe_is_read_whatever_its_form() -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "wb") as file:
        file.write(gzip.compress(b"start,end,id1,id2\n1,2,a,b\n"))
    try:
        assert len(read_log(Path(f"/dev/fd/{reading}")).table) == 1
    finally:
        os.close(reading)


def test_ids_come_from_a_command_line_and_from_files(tmp_path: Path) -> None:
    file = tmp_path / "ids.txt"
    file.write_text("north door\n 7, 8\n\nnorth door\n")
    assert read_ids(("1", f"@{file}")) == ("1", "north door", "7", "8")
    for name, reason in ((tmp_path / "none", "cannot be read"), (tmp_path, "cannot be read")):
        with pytest.raises(InputFileError, match=reason):
            read_ids((f"@{name}",))
    file.write_text("\n ,\n")
    with pytest.raises(InputFileError, match="names no id"):
        read_ids((f"@{file}",))


def test_modes_may_speak_of_names_and_dates(tmp_path: Path) -> None:
    path = tmp_path / "modes.csv"
    path.write_text("t_start_s,t_end_s,id,mode,cause\n1970-01-01T00:00:05Z,7.5,north door,S,command\n0,,nobody,S,command\n")
    (spell,) = read_modes(path, number_of=NodeNames(text_of={4: "north door"}).number_of, time_of=read_time)
    assert (spell.node, spell.t_start_ns, spell.t_end_ns) == (4, 5 * S, 7_500_000_000)
    path.write_text("t_start_s,t_end_s,id,mode,cause\nnoon,,north door,S,command\n")
    with pytest.raises(InputFileError, match="line 2: t_start_s is 'noon'; wanted a finite number"):
        read_modes(path, time_of=read_time)


@given(st.binary(max_size=80), st.sampled_from([b"", b"t,a,b\n", b"start;end;id1;id2\n", b"\x1f\x8b", b"PAR1", b"# t,a,b\n"]))
def test_no_bytes_crash_the_reader(path: Path, noise: bytes, head: bytes) -> None:
    path.write_bytes(head + noise)
    with suppress(InputFileError):
        table = read_log(path).table
        assert (table.t_start_ns <= table.t_end_ns).all()
        assert (table.id1 < table.id2).all()


def _listed(row: str) -> list[str]:
    document = (Path(__file__).parents[2] / "docs" / "your-own-data.md").read_text()
    (line,) = [line for line in document.splitlines() if line.startswith(f"| {row} |")]
    return line.split("|")[2].strip().split(", ")


@pytest.mark.parametrize("role", [Role.START, Role.END, Role.INSTANT, Role.DURATION])
def test_the_names_of_times_are_those_of_the_documentation(role: Role) -> None:
    others = {Role.START: ["end"], Role.END: ["start"], Role.DURATION: ["t"]}.get(role, [])
    listed = _listed(role)
    for name in listed:
        assert find_layout([name, *others, "id1", "id2"], ReadingOptions()).place[role] == 0
    assert {name.replace(" ", "") for name in listed} == NAMES_OF_TIMES[role]


def test_the_words_for_nodes_are_those_of_the_documentation() -> None:
    for word in _listed("the words"):
        for one, other in ((f"{word}1", f"{word}_2"), (f"{word}A", f"{word} b"), (f"source_{word}", f"target_{word}")):
            place = find_layout(["t", other, one], ReadingOptions()).place
            assert (place[Role.ID1], place[Role.ID2]) == (2, 1)
        assert find_layout(["t", f"{word}_id", "reader"], ReadingOptions()).is_place
