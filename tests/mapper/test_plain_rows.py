"""Files of encounters read by the compiled library: the same table and the same words as without it."""

import csv
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mapper.encounter_csv import ENCOUNTER_COLUMNS
from mapper.kernels import find_library, read_rows
from mapper.types import KernelsKind
from tests.mapper.csv_files import COLUMNS, odd_files, outcome, plain_files

HEADER = b"t_start_s,t_end_s,id1,id2\n"
WITH_NOTE = b"t_start_s,t_end_s,id1,id2,note\n"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rows") / "encounters.csv"


def _is_read_plainly(rows: bytes, *, places: tuple[int, ...] = (0, 1, 2, 3), n_columns: int = 4, longest_field: int = 131_072) -> bool:
    library = find_library(KernelsKind.COMPILED)
    assert library is not None
    return read_rows(library, rows, begin=0, places=places, n_columns=n_columns, longest_field=longest_field) is not None


def test_the_library_is_there_and_can_be_left_alone() -> None:
    assert find_library(KernelsKind.COMPILED) is not None
    assert find_library(KernelsKind.PLAIN) is None


@given(plain_files())
def test_plain_files_are_read_by_the_library_and_mean_the_same(path: Path, text: str) -> None:
    data = text.encode()
    begin = data.index(b"\n") + 1
    names = data[:begin].decode().strip().split(",")
    places = tuple(names.index(name) for name in ENCOUNTER_COLUMNS)
    assert _is_read_plainly(data[begin:] or b"\n", places=places, n_columns=len(names))
    path.write_bytes(data)
    assert outcome(path, KernelsKind.COMPILED) == outcome(path, KernelsKind.PLAIN)


@given(odd_files())
@example(HEADER + b"1,2,3,4")
@example(HEADER + b"1,2,3,4,")
@example(HEADER + b"0,000,0,002,20,54\n1,000,1,002,20,54\n")
@example(WITH_NOTE + b'1,2,3,4,"')
@example(WITH_NOTE + b'1,2,3,4,""')
@example(HEADER + b"1,2,3,4\r")
@example(HEADER[:-1] + b"\r1,2,3,4\n5,6,7,8\n")
@example(b'"t_start_s",t_end_s,id1,id2,"\n"\n1,2,3,4\n')
@example(b"\xef\xbb\xbf" + HEADER + b"1,2,3,4\n")
@example(WITH_NOTE + b"1,2,3,4,\xc3\n")
@example(WITH_NOTE + b"1,2,3,4,\xed\xa0\x80\n")
@example(WITH_NOTE + b"1,2,3,4," + 131_072 * b"x" + b"\n")
@example(WITH_NOTE + b"1,2,3,4," + 131_073 * b"x" + b"\n")
@example(WITH_NOTE + b"1,2,3,4," + 131_072 * "ü".encode() + b"\n")
def test_any_file_is_read_or_refused_alike(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    assert outcome(path, KernelsKind.COMPILED) == outcome(path, KernelsKind.PLAIN)


@given(st.binary(max_size=60), st.permutations(COLUMNS))
def test_no_bytes_crash_the_library(path: Path, noise: bytes, names: list[str]) -> None:
    path.write_bytes(",".join(names).encode() + b"\n" + noise)
    assert outcome(path, KernelsKind.COMPILED) == outcome(path, KernelsKind.PLAIN)


@pytest.mark.parametrize(
    "row",
    [
        *(
            b"1,2,3",
            b"1,2,3,4,",
            b"0,000,0,002,20,54",
            b"x,2,3,4",
            b"1,2,3,x",
            b"2,1,3,4",
            b"1,2,3,3",
            b"1,,3,4",
            b"1,2,,4",
            b"1,2,-3,4",
            b"1,2,3,9223372036854775808",
        ),
        *(b"1e,2,3,4", b"1e0001,2,3,4", b"1,4000000000.0000000001,3,4", b"-300000000.0000000001,2,3,4", b"1,2,\v3,4", b"1,2,3,4\r\r"),
        *(b"1,12345678901234567890123456789e-28,3,4", b'1,2,"3"x,4', b'1,2,3,"4', b'1,2,"3""",4', b"word", b'""'),
    ],
)
def test_what_is_not_plain_is_left_to_the_reader_with_words(row: bytes) -> None:
    assert not _is_read_plainly(b"1,2,3,4\n" + row + b"\n")


def test_a_field_longer_than_csv_allows_is_not_plain(path: Path) -> None:
    rows = b"1,2,3,4," + 99 * b"x" + b"\n"
    assert _is_read_plainly(rows, n_columns=5, longest_field=99)
    assert not _is_read_plainly(rows, n_columns=5, longest_field=98)
    path.write_bytes(WITH_NOTE + rows)
    limit = csv.field_size_limit(98)
    try:
        assert (
            outcome(path, KernelsKind.COMPILED)
            == outcome(path, KernelsKind.PLAIN)
            == (
                ("line 2: not a CSV row: field larger than field limit (98); is a quote not closed?",),
                1,
                f"{path}: line 2: not a CSV row: field larger than field limit (98); is a quote not closed?",
            )
        )
    finally:
        csv.field_size_limit(limit)


def test_letters_of_many_bytes_are_known_to_be_text_across_pieces(path: Path) -> None:
    """The file is checked in pieces of 2^20 bytes; here every piece ends within a letter, and the last letter lacks its end."""
    note = 30_000 * "€"
    row = f"1,2,3,4,{note}\n".encode()
    path.write_bytes(WITH_NOTE + 40 * row)
    assert outcome(path, KernelsKind.COMPILED) == outcome(path, KernelsKind.PLAIN)
    path.write_bytes(WITH_NOTE + 40 * row + b"1,2,3,4,\xe2\x82")
    faults, *_ = outcome(path, KernelsKind.COMPILED)
    assert str(faults).startswith("('line 42: byte 0xe2 is not UTF-8 text; is this a CSV file? If so, save it as UTF-8")
