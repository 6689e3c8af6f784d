"""CSV files, good and bad."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from gateway.journal_export.rows import COLUMNS, Kind
from mapper.encounter_csv import JOURNAL_MODE_COLUMNS, read_encounters, read_modes
from mapper.errors import InputFileError
from mapper.types import EncounterTable

HEADER = "t_start_s,t_end_s,id1,id2\n"
GOOD = "1.5,2.5,1,2\n"


def _faults(tmp_path: Path, content: str | bytes) -> tuple[str, ...]:
    path = tmp_path / "encounters.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputFileError) as caught:
        read_encounters(path)
    assert all(line.startswith(str(path)) for line in str(caught.value).splitlines())
    return caught.value.faults


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("abc,2,1,2", "line 3: t_start_s is 'abc'; wanted a finite number of seconds, as 12.5"),
        ("1,NaN,1,2", "line 3: t_end_s is 'NaN'; wanted a finite number of seconds, as 12.5"),
        ("-inf,2,1,2", "line 3: t_start_s is '-inf'; wanted a finite number of seconds, as 12.5"),
        ("1,Infinity,1,2", "line 3: t_end_s is 'Infinity'; wanted a finite number of seconds, as 12.5"),
        ("1_0,20,1,2", "line 3: t_start_s is '1_0'; wanted a finite number of seconds, as 12.5"),
        ("٣,20,1,2", "line 3: t_start_s is '٣'; wanted a finite number of seconds, as 12.5"),
        ("1,,1,2", "line 3: t_end_s is empty; wanted seconds, as 12.5"),
        ("1,1e300,1,2", "line 3: t_end_s is '1e300'; wanted seconds from -300000000 to 4000000000; is the unit milliseconds?"),
        ("3,2,1,2", "line 3: t_end_s 2 is before t_start_s 3"),
        ("1,2,7,7", "line 3: id1 and id2 are both 7; an encounter has two biobots"),
        ("1,2,x,7", "line 3: id1 is 'x'; wanted a whole number from 0 to 2^63-1"),
        ("1,2,1.0,7", "line 3: id1 is '1.0'; wanted a whole number from 0 to 2^63-1"),
        ("1,2,-1,7", "line 3: id1 is '-1'; wanted a whole number from 0 to 2^63-1"),
        ("1,2,7,9223372036854775808", "line 3: id2 is '9223372036854775808'; wanted a whole number from 0 to 2^63-1"),
        ("0,000,0,002,20,54", "line 3: 6 fields, but the header names 4; is the decimal sign a comma?"),
        ("1,2,3,4,", "line 3: 5 fields, but the header names 4; is the decimal sign a comma?"),
        ("1,2,7", "line 3: 3 fields, so id2 is missing; wanted t_start_s,t_end_s,id1,id2"),
        ("1", "line 3: 1 fields, so t_end_s, id1, id2 is missing; wanted t_start_s,t_end_s,id1,id2"),
        ('1,2,1,"2', "line 3: not a CSV row: unexpected end of data; is a quote not closed?"),
        ('1,2,"1,3\n' + 20_000 * GOOD, "line 3: not a CSV row: field larger than field limit (131072); is a quote not closed?"),
        ("1,2,1," + 200_000 * "2", "line 3: not a CSV row: field larger than field limit (131072); is a quote not closed?"),
        ("1,2,1," + 99 * "2", f"line 3: id2 is '{37 * '2'}...'; wanted a whole number from 0 to 2^63-1"),
    ],
)
def test_a_bad_row_is_named_with_its_line_and_reason(tmp_path: Path, row: str, reason: str) -> None:
    assert _faults(tmp_path, HEADER + GOOD + row + "\n") == (reason,)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "line 1: the file is empty; wanted the header t_start_s,t_end_s,id1,id2"),
        ("\n\n", "line 1: the file is empty; wanted the header t_start_s,t_end_s,id1,id2"),
        ("1,2,3,4\n", "line 1: the header '1,2,3,4' lacks t_start_s, t_end_s, id1, id2; wanted t_start_s,t_end_s,id1,id2"),
        (HEADER.replace(",", ";"), "line 1: the header 't_start_s;t_end_s;id1;id2' lacks t_start_s, t_end_s, id1, id2"),
        ("t_start_s,t_end_s,id1,id2,id1\n", "line 1: the header names id1 twice; wanted t_start_s,t_end_s,id1,id2"),
        (HEADER.encode() + b"1,2,3,4\n\xff\xfe", "line 3: byte 0xff is not UTF-8 text; is this a CSV file?"),
        (b"\x7fELF\x02\x01\x01\x00\x00", "line 1: a NUL byte; is this a CSV file?"),
        ('"t_start_s\n', "line 1: not a CSV row: unexpected end of data; is a quote not closed?"),
    ],
)
def test_a_file_that_is_no_such_csv_is_refused_with_its_reason(tmp_path: Path, content: str | bytes, reason: str) -> None:
    assert _faults(tmp_path, content)[0].startswith(reason)


def test_ten_bad_rows_are_listed_and_the_others_counted(tmp_path: Path) -> None:
    path = tmp_path / "encounters.csv"
    path.write_text(HEADER + 25 * "x,2,1,2\n")
    with pytest.raises(InputFileError) as caught:
        read_encounters(path)
    lines = str(caught.value).splitlines()
    assert len(lines) == 11
    assert lines[0].startswith(f"{path}: line 2: ")
    assert lines[-1] == f"{path}: and 15 more"


@pytest.mark.parametrize("name", ["nowhere.csv", ".", "a\0b"])
def test_a_path_that_cannot_be_read_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputFileError, match="cannot be read"):
        read_encounters(tmp_path / name)


def test_a_file_longer_than_the_limit_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "encounters.csv"
    with path.open("wb") as file:
        file.truncate(2**30 + 1)
    with pytest.raises(InputFileError, match="is longer than 1073741824 bytes; split it by time"):
        read_encounters(path)


def test_a_pipe_is_read_to_its_end() -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as file:
        file.write(HEADER + GOOD)
    try:
        assert len(read_encounters(Path(f"/dev/fd/{reading}"))) == 1
    finally:
        os.close(reading)


@pytest.mark.parametrize(
    "content",
    [
        "\ufeff" + HEADER + GOOD,
        HEADER.replace("\n", "\r\n") + "1.5,2.5,1,2\r\n\r\n",
        HEADER + "\n" + GOOD + "\n  \n\n",
        '"t_start_s","t_end_s","id1","id2"\n"1.5","2.5","1","2"\n',
        " t_start_s , t_end_s , id1 , id2 \n 1.5 , 2.5\t, 1 , 2 \n",
        'rssi_dbm,id2,id1,t_end_s,t_start_s,note\n-70,2,1,2.5,1.5,"grüezi, all"\n',
        HEADER + "1.5,2.5,2,1\n",
        HEADER + "1.5,2.5,1,2",
        HEADER.replace("\n", ",,,\n") + "15e-1,+2.50000000000,1,2,,,\n",
    ],
)
def test_common_dialects_mean_the_same(tmp_path: Path, content: str) -> None:
    path = tmp_path / "encounters.csv"
    path.write_bytes(content.encode())
    table = read_encounters(path)
    assert (table.t_start_ns.tolist(), table.t_end_ns.tolist(), table.id1.tolist(), table.id2.tolist()) == (
        [1_500_000_000],
        [2_500_000_000],
        [1],
        [2],
    )


@given(st.integers(-(3 * 10**17), 4 * 10**18), st.integers(0, 2**63 - 2))
def test_every_nanosecond_and_every_id_survives(tmp_path_factory: pytest.TempPathFactory, instant_ns: int, node: int) -> None:
    path = tmp_path_factory.mktemp("exact") / "encounters.csv"
    sign, size = ("-", -instant_ns) if instant_ns < 0 else ("", instant_ns)
    text = f"{sign}{size // 10**9}.{size % 10**9:09}"
    path.write_text(f"{HEADER}{text},{text},{node},{node + 1}\n")
    table = read_encounters(path)
    assert (int(table.t_start_ns[0]), int(table.id1[0]), int(table.id2[0])) == (instant_ns, node, node + 1)


@given(st.binary(max_size=200))
def test_no_bytes_crash_the_reader(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("noise") / "encounters.csv"
    for body in (content, HEADER.encode() + content):
        path.write_bytes(body)
        table: EncounterTable | None = None
        faults: tuple[str, ...] = ()
        try:
            table = read_encounters(path)
        except InputFileError as error:
            faults = error.faults
        assert faults if table is None else _is_canonical(table)


def _is_canonical(table: EncounterTable) -> bool:
    order = np.lexsort((table.source_row, table.id2, table.id1, table.t_end_ns, table.t_start_ns))
    are_rows = (table.t_start_ns <= table.t_end_ns) & (table.id1 < table.id2)
    return bool(are_rows.all()) and order.tolist() == list(range(len(table)))


def test_rows_come_in_canonical_order_and_remember_where_they_stood(tmp_path: Path) -> None:
    path = tmp_path / "encounters.csv"
    path.write_text(HEADER + "5,6,1,2\n1,9,4,3\n1,2,9,8\n1,2,3,2\n")
    table = read_encounters(path)
    assert list(zip(table.id1.tolist(), table.id2.tolist(), strict=True)) == [(2, 3), (8, 9), (3, 4), (1, 2)]
    assert table.source_row.tolist() == [3, 2, 1, 0]


def test_modes_are_read_with_open_ends(tmp_path: Path) -> None:
    path = tmp_path / "modes.csv"
    path.write_text("t_start_s,t_end_s,id,mode,cause\n0,,7,S,command\n1,2.5,8,CRW,natural\n")
    first, second = read_modes(path)
    assert (first.node, first.t_start_ns, first.t_end_ns, first.mode, first.cause) == (7, 0, None, Mode.S, Cause.COMMAND)
    assert (second.t_end_ns, second.mode, second.cause) == (2_500_000_000, Mode.CRW, Cause.NATURAL)


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("0,1,7,FLYING,command", "line 2: mode is 'FLYING'; wanted CRW or S"),
        ("0,1,7,s,command", "line 2: mode is 's'; wanted CRW or S"),
        ("0,1,7,S,whim", "line 2: cause is 'whim'; wanted command or natural"),
        ("2,1,7,S,command", "line 2: t_end_s 1 is before t_start_s 2"),
        (",1,7,S,command", "line 2: t_start_s is empty; wanted seconds, as 12.5"),
    ],
)
def test_a_bad_mode_row_is_named_with_its_line_and_reason(tmp_path: Path, row: str, reason: str) -> None:
    path = tmp_path / "modes.csv"
    path.write_text(f"t_start_s,t_end_s,id,mode,cause\n{row}\n")
    with pytest.raises(InputFileError) as caught:
        read_modes(path)
    assert caught.value.faults == (reason,)


def test_modes_that_a_journal_was_exported_to_are_read_to_the_nanosecond(tmp_path: Path) -> None:
    columns = list(COLUMNS[Kind.MODES])
    assert set(JOURNAL_MODE_COLUMNS) <= set(columns)
    path = tmp_path / "out.modes.csv"
    rows = [
        "g1,ac6a5ef9,178,1,6,1,7,CRW,natural,1795726958046574232,1795726982605343597,17574787,false",
        "g1,ac6a5ef9,248,1,119,1,7,S,command,1795726982605343597,,18033752,false",
    ]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    first, second = read_modes(path)
    assert (first.node, first.t_start_ns, first.t_end_ns, first.mode) == (7, 1795726958046574232, 1795726982605343597, Mode.CRW)
    assert (second.t_start_ns, second.t_end_ns, second.mode, second.cause) == (1795726982605343597, None, Mode.S, Cause.COMMAND)
    path.write_text("\n".join([",".join(columns), rows[1].replace("false", "true")]) + "\n")
    assert [spell.cause for spell in read_modes(path)] == [Cause.NATURAL], "who stands because all were stopped is no landmark"
    path.write_text("\n".join([",".join(columns[:-1]), rows[1].removesuffix(",false")]) + "\n")
    assert [spell.cause for spell in read_modes(path)] == [Cause.COMMAND], "older gateways do not say it"
    path.write_text("\n".join([",".join(columns), rows[1].replace("false", "no")]) + "\n")
    with pytest.raises(InputFileError, match=r"is_halted is 'no'; wanted true or false"):
        read_modes(path)
    path.write_text("\n".join([",".join(columns), rows[0].replace("1795726982605343597", "12.5")]) + "\n")
    with pytest.raises(InputFileError, match=r"line 2: end_wall_ns is '12\.5'; wanted nanoseconds since 1970"):
        read_modes(path)
