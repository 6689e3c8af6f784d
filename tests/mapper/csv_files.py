"""Files of encounters as they are met with, well formed and damaged, and what a reader makes of one."""

from pathlib import Path

from hypothesis import strategies as st

from mapper.encounter_csv import read_encounters
from mapper.errors import InputFileError
from mapper.types import KernelsKind

COLUMNS = ("t_start_s", "t_end_s", "id1", "id2")

_digits = st.text("0123456789", min_size=1, max_size=12)
_nearly = st.sampled_from(
    [
        *("0.0000000005", "0.0000000015", "-2.0000000025", "7.00000000050000000001", "0.00000000049999999999", "1.0000000015000000"),
        *("4000000000", "4000000000.0000000000", "4000000000.0000000001", "3999999999.9999999999", "4e9", "4.0e+09", "40000000001e-1"),
        *("-300000000", "-300000000.0000000001", "-3E8", "-0", "-0.0000000001", "5e-10", "15e-10", "5e-11", "1e-999", "0e999", "1e999"),
        *("9999999999999999999e-19", "9999999999999999999e-29", "18446744073709551615e-10", "18446744073709551617e-10"),
        *("4000000000.000000000000000001", "4000000000.000000000000000000", "99999999999999999999e-11", "5000000000000000000e-28"),
        *("0.50000000050000000000000001", "1.234567890500000000000000000", "1.2345678905000000000000000001"),
        *("1.5e3", "1.5e0003", "1.5e", "1.5e+", "1e-", "e5", ".", "+.5", "5.", "-.e1", "++1", "+-1", "0x10", "1_0", "nan", "inf", "", "٣"),
        *("00000000000000000000000001.5", "0." + 30 * "0" + "1", "1" + 30 * "0", "1." + 30 * "0"),
    ]
)
_plain_times = st.builds(lambda whole, part: f"{whole % 10**9}.{part}", st.integers(0, 10**9), _digits)
times = st.one_of(
    _plain_times,
    _nearly,
    st.integers(-(10**9), 5 * 10**9).map(str),
    st.floats(-1e6, 1e6).map(repr),
    st.builds(
        lambda sign, whole, part, power: f"{sign}{whole}.{part}e{power}",
        st.sampled_from(["", "+", "-"]),
        _digits,
        _digits,
        st.integers(-40, 12),
    ),
)
_plain_ids = st.one_of(st.integers(0, 9), st.integers(0, 2**63 - 1)).map(str)
_ids = st.one_of(
    _plain_ids,
    st.sampled_from(
        ["9223372036854775807", "9223372036854775808", "18446744073709551617", "007", 40 * "0", 41 * "0", "-1", "+1", "1.0", "x", ""]
    ),
)
_blanks = st.sampled_from(["", "", "", " ", "  ", "\t", "\u00a0", "\v"])
_notes = st.one_of(
    st.text("ab ;'.-", max_size=5),
    st.sampled_from(["grüezi", '"a, b"', '"said ""so"""', '"two\nlines"', '"two\r\nlines"', 'in"side', '""']),
)
_ends = st.sampled_from(["\n", "\r\n"])


@st.composite
def plain_files(draw: st.DrawFn) -> str:
    """Files whose every row is good and plain: the columns in any order, further ones, either end of line, spaces and quotes."""
    names = draw(st.permutations([*COLUMNS, *draw(st.lists(st.sampled_from(["note", "rssi_dbm"]), max_size=2))]))
    end = draw(_ends)
    lines = [",".join(names)]
    for _ in range(draw(st.integers(0, 6))):
        start = draw(st.integers(-299_999_999, 10**9 - 1))
        values = {
            "t_start_s": f"{start}.{draw(_digits)}",
            "t_end_s": f"{start + draw(st.integers(1, 9))}{draw(st.sampled_from(['', '.', 'e0', '.25']))}",
            "id1": str(draw(st.integers(0, 99))),
            "id2": str(draw(st.integers(100, 2**63 - 1))),
        }
        shape = draw(st.sampled_from(['"{}"', "{}", " {}", "{}\t"]))
        cells = [shape.format(values[name]) if name in values else draw(_notes) for name in names]
        lines.append(",".join(cells))
        lines += [""] * draw(st.integers(0, 1))
    return end.join(lines) + draw(st.sampled_from(["", end, f"{end} \t{end}"])) if len(lines) > 1 else lines[0] + end


@st.composite
def odd_files(draw: st.DrawFn) -> bytes:
    """Files with anything in them that a row may have, wrong or right, and then some bytes damaged."""
    names = list(draw(st.permutations([*COLUMNS, *draw(st.lists(st.sampled_from(["note", "id1", " x "]), max_size=2))])))
    lines = [",".join(f"{draw(_blanks)}{name}" for name in names)]
    for _ in range(draw(st.integers(0, 5))):
        cells = [draw(times if name.startswith("t_") else _ids if name.startswith("id") else _notes) for name in names]
        if draw(st.booleans()):
            cells = [f'"{cell}"' for cell in cells]
        lines.append(",".join(f"{draw(_blanks)}{cell}{draw(_blanks)}" for cell in cells[: draw(st.sampled_from([9, 9, 9, 9, 3, 1, 0]))]))
    end = draw(st.sampled_from(["\n", "\n", "\r\n", "\r", "\n\n", "\n \n"]))
    data = bytearray(
        (draw(st.sampled_from(["", "", "\ufeff", "\ufeff\ufeff", "\n"])) + end.join(lines) + draw(st.sampled_from(["", end]))).encode()
    )
    for _ in range(draw(st.sampled_from([0, 0, 0, 1, 2]))):
        place = draw(st.integers(0, len(data)))
        data[place : place + draw(st.integers(0, 2))] = draw(
            st.sampled_from([b"", b",", b'"', b"\n", b"\r", b"\0", b"\xff", b"9", b"e", b".", b" "])
        )
    return bytes(data)


def outcome(path: Path, kernels: KernelsKind) -> tuple[object, ...]:
    """Return the columns of the table, or the error with everything it says."""
    try:
        table = read_encounters(path, kernels=kernels)
    except InputFileError as error:
        return error.faults, error.n_faults, str(error)
    return tuple(column.tolist() for column in (table.t_start_ns, table.t_end_ns, table.id1, table.id2, table.source_row))
