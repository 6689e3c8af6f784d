"""What is timed finds every record; speeds themselves are no test's business."""

from pathlib import Path

import pytest

from studies import bench_wire
from studies.bench_wire import main, make_rows, time_row

NOWHERE = str(Path("no") / "python")


@pytest.mark.parametrize("row", make_rows(), ids=lambda row: f"{row.framing}, {row.name}")
def test_every_way_of_decoding_finds_every_record(row: bench_wire.Row) -> None:
    ours, theirs = time_row(row, {}, n_frames=60, chunk=64, rounds=1)
    assert ours > 0
    assert theirs == {}


def test_bad_usage_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["--frames", "0", "--peers", NOWHERE])
    assert refused.value.code == 2
    assert "--frames 0" in capsys.readouterr().err
