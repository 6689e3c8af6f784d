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
