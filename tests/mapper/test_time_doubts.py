"""Times of another unit than the one meant: who gave them is told, and who did not is left in peace."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.__main__ import main
from mapper.time_doubts import doubt_modes, doubt_unit
from mapper.types import ModeSpell
from tests.mapper.worlds import table_of, walk_track

_ROWS, _ = walk_track(n_landmarks=20, n_walkers=10, duration_s=600, seed=1, is_ring=True)
_TABLE = table_of(_ROWS)


def spells(times_s: Sequence[tuple[float, float | None]]) -> tuple[ModeSpell, ...]:
    return tuple(
        ModeSpell(
            node=NodeId(7),
            t_start_ns=round(begin * NS_PER_S),
            t_end_ns=None if end is None else round(end * NS_PER_S),
            mode=Mode.S,
            cause=Cause.COMMAND,
        )
        for begin, end in times_s
    )


@pytest.mark.parametrize(("per_s", "told"), [(1, None), (1_000, "milliseconds"), (1_000_000, "microseconds")])
def test_whole_numbers_of_long_contacts_are_doubted(per_s: int, told: str | None) -> None:
    if told is None:
        assert doubt_unit(_TABLE) == ()
        return
    lasting_ns = 3 * NS_PER_S
    whole = [[t * per_s // NS_PER_S * NS_PER_S for t in (begin, begin + lasting_ns)] for begin, *_ in _ROWS]
    (doubt,) = doubt_unit(table_of([(begin, end, *row[2:]) for (begin, end), row in zip(whole, _ROWS, strict=True)]))
    assert f"are they {told}?" in doubt


def test_milliseconds_with_decimals_are_doubted_too() -> None:
    late = [(begin * 1_000 + 500_000, begin * 1_000 + 3_000 * NS_PER_S + 250_000, one, other) for begin, _, one, other in _ROWS]
    (doubt,) = doubt_unit(table_of(late))
    assert "are they milliseconds?" in doubt
    (doubt,) = doubt_unit(table_of(late), has_flag=False)
    assert "--time-unit" not in doubt


def test_half_seconds_are_no_milliseconds_however_long_a_contact_lasts() -> None:
    assert doubt_unit(table_of([(NS_PER_S // 2, 9_000 * NS_PER_S, 1, 2)])) == ()
    assert doubt_unit(table_of([])) == ()


@pytest.mark.parametrize(
    ("times_s", "told"),
    [
        ([(0, None), (100, 300), (310, 600)], None),
        ([(0, None)], None),
        ([(0, 3), (4, 9)], None),
        ([(-1000, 5000), (5100, None)], None),
        ([(0, None), (100_000, 300_000), (310_000, 600_000)], "if --modes has milliseconds, divide its times by 1,000"),
        ([(0, None), (0.1, 0.3), (0.31, 0.6)], "1,000 times shorter; if the encounters are in milliseconds, give --time-unit ms"),
        ([(1.7e9, None), (1.7e9 + 300, 1.7e9 + 600)], "no spell of --modes touches the time of the encounters"),
        ([], None),
    ],
    ids=["alike", "landmarks alone", "of a short time", "of a long time", "milliseconds", "encounters in ms", "another zero", "none"],
)  # fmt: skip
def test_modes_of_another_time_than_the_encounters_are_named(times_s: list[tuple[float, float | None]], told: str | None) -> None:
    found = doubt_modes(_TABLE, spells(times_s))
    assert len(found) == (told is not None)
    assert told is None or told in found[0]
    assert doubt_modes(table_of([]), spells(times_s)) == ()


def test_run_tells_it_and_makes_the_map_all_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, modes = tmp_path / "log.csv", tmp_path / "modes.csv"
    rows = [f"{begin / NS_PER_S:.9f},{end / NS_PER_S:.9f},{one},{other}\n" for begin, end, one, other in _ROWS]
    log.write_text("t_start_s,t_end_s,id1,id2\n" + "".join(rows))
    modes.write_text("t_start_s,t_end_s,id,mode,cause\n0,,1000,S,command\n0,300000,1001,S,command\n310000,600000,1001,CRW,command\n")
    assert main(["run", str(log), "--modes", str(modes), "--json", str(tmp_path / "map.json")]) == 0
    told = capsys.readouterr().err
    assert "warning: encounters are from" in told
    assert "if --modes has milliseconds, divide its times by 1,000" in told


def _run(path: Path, rows: Sequence[tuple[float, float, int, int]], capsys: pytest.CaptureFixture[str], *flags: str) -> str:
    path.write_text("t_start_s,t_end_s,id1,id2\n" + "".join(f"{begin:.9f},{end:.9f},{one},{other}\n" for begin, end, one, other in rows))
    assert main(["run", str(path), *flags]) == 0
    told = capsys.readouterr()
    return told.out + told.err


_SECONDS = [(begin / NS_PER_S, end / NS_PER_S, one, other) for begin, end, one, other in _ROWS[:2000]]


def test_encounters_told_by_both_sides_are_named_as_such(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = _SECONDS + [(begin + 0.01, end + 0.05, other, one) for begin, end, one, other in _SECONDS]
    told = _run(tmp_path / "log.csv", both, capsys)
    assert "begin while another one of the same two lasts" in told
    assert "join them: --gap-s 0" in told
    assert "make the nodes cross" not in told
    assert "begin while another" not in _run(tmp_path / "log.csv", both, capsys, "--gap-s", "0")


def test_rooms_without_a_door_are_not_told_to_walk_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = _run(tmp_path / "log.csv", _SECONDS + [(begin, end, one + 5000, other + 5000) for begin, end, one, other in _SECONDS], capsys)
    assert "the parts have no meeting in common" in told
    assert "if not, they are separate rooms, which no walking joins" in told
    assert "make the nodes cross" not in told


def test_a_few_encounters_are_not_called_coarse_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = _run(tmp_path / "log.csv", [(0, 10, 1, 2), (20, 30, 3, 4), (40, 50, 5, 6)], capsys)
    assert "too coarsely" not in told
    assert "cannot be told from standing" not in told
    assert "too few to see how finely times are told" in told


def test_merge_doubts_units_as_run_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        rows = "".join(f"{begin * 1e3:.0f},{begin * 1e3 + 3000:.0f},{one},{other}\n" for begin, _, one, other in _SECONDS[:200])
        (tmp_path / f"{name}.csv").write_text("t_start_s,t_end_s,id1,id2\n" + rows)
    assert main(["merge", str(tmp_path / "a.csv"), str(tmp_path / "b.csv"), "--json", str(tmp_path / "map.json")]) == 0
    told = capsys.readouterr().err
    for name in ("a", "b"):
        assert f"{name}.csv: half of the contacts last 3,000 s or more" in told
    assert "--time-unit" not in told


def test_a_text_that_is_not_utf8_is_told_how_to_become_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log.csv").write_bytes(b"start,end,id1,id2\n1,2,Andr\xe9,Anna\n")
    assert main(["run", str(tmp_path / "log.csv")]) == 1
    assert "save it as UTF-8: iconv -f LATIN1 -t UTF-8" in capsys.readouterr().err
    (tmp_path / "log.csv").write_bytes("start,end,id1,id2\n1,2,André,Anna\n".encode("utf-16"))
    assert main(["run", str(tmp_path / "log.csv")]) == 1
    assert "iconv -f UTF-16 -t UTF-8" in capsys.readouterr().err
    (tmp_path / "log.csv").write_bytes(b"\x89PNG\r\n\x1a\n\0\0")
    assert main(["run", str(tmp_path / "log.csv")]) == 1
    assert "iconv" not in capsys.readouterr().err
