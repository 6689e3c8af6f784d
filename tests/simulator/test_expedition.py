"""Laws of runs that are interrupted and taken up again."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.arenas.geojson import dump_arena
from simulator.config import MotionConfig, RunConfig
from simulator.errors import SnapshotError
from simulator.expedition import Expedition
from tests.simulator.arenas import square

pytestmark = pytest.mark.xdist_group("expedition")
"""What they share is made once, by one worker."""

BUSY = RunConfig(
    scenario="closing-door",
    seed=4,
    biobots=40,
    duration_s=40.0,
    motion=MotionConfig(stop_hazard=0.05, short_rest_s=3.0, loss_hazard=0.005, contact_radius=0.3, contact_turns=True),
)


def finished(expedition: Expedition) -> dict[str, bytes]:
    expedition.advance(expedition.total_s)
    assert expedition.is_over
    return expedition.files()


@settings(max_examples=10)
@given(st.floats(0.0, 49.9))
def test_a_resumed_run_has_the_files_of_one_never_interrupted(at_s: float) -> None:
    """Dispersion ends at 10 s: before it, no landmark is set; at 30 s the door closes."""
    expected = finished(Expedition(BUSY))
    halves = Expedition(BUSY)
    halves.advance(at_s)
    assert finished(Expedition.resume(halves.save(), source="half")) == expected


def test_a_snapshot_with_a_byte_changed_or_missing_is_refused() -> None:
    content = Expedition(BUSY).save()
    for broken in (content[:-1], content[:40], b"", content[:100] + b"?" + content[101:]):
        with pytest.raises(SnapshotError, match=r"half: .*wanted a whole snapshot"):
            Expedition.resume(broken, source="half")


def test_an_arena_file_that_has_changed_since_is_refused(tmp_path: Path) -> None:
    arena = tmp_path / "room.geojson"
    arena.write_text(dump_arena(square(50.0)))
    halves = Expedition(RunConfig(arena=str(arena), seed=4, biobots=20, duration_s=10.0))
    halves.advance(5.0)
    content = halves.save()
    arena.write_text(dump_arena(square(40.0)))
    with pytest.raises(SnapshotError, match="is not the arena any more"):
        Expedition.resume(content, source="half")


def start_run(tmp_path: Path, *more: str) -> subprocess.Popen[str]:
    """Begin a run of some seconds."""
    command = [sys.executable, "-m", "simulator", "run", "--scenario", "one-obstacle", "--seed", "2", "--biobots", "500",
               "--duration", "300", "--out", str(tmp_path / "out"), "--snapshot", str(tmp_path / "run.snapshot"), *more]  # fmt: skip
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def resume(tmp_path: Path) -> Path:
    command = [sys.executable, "-m", "simulator", "resume", str(tmp_path / "run.snapshot"), "--out", str(tmp_path / "out")]
    subprocess.run(command, check=True, capture_output=True, timeout=200)
    return tmp_path / "out"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("whole")
    start_run(place).communicate(timeout=200)
    return place / "out"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_run_goes_on_from_its_snapshot(tmp_path: Path, whole: Path, number: signal.Signals) -> None:
    process = start_run(tmp_path, "--snapshot-every", "10")
    deadline = time.monotonic() + 100
    while not (tmp_path / "run.snapshot").exists() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)
    _, told = process.communicate(timeout=100)
    assert process.returncode == (130 if number is signal.SIGTERM else -signal.SIGKILL)
    assert number is signal.SIGKILL or f"go on with: biobot-sim resume {tmp_path / 'run.snapshot'}" in told
    assert not (tmp_path / "out").exists()
    out = resume(tmp_path)
    for name in ("encounters.csv", "modes.csv", "truth.npz", "arena.geojson"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()
    assert json.loads((out / "run.json").read_text())["landmark_ids"]


def test_what_is_no_snapshot_is_told_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "old").write_bytes(b"something else")
    for name, problem in (("old", "does not begin as a snapshot does"), ("none", "cannot be read: No such file")):
        done = subprocess.run(
            [sys.executable, "-m", "simulator", "resume", str(tmp_path / name)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 1
        assert problem in done.stderr
        assert "Traceback" not in done.stderr


def test_a_place_that_takes_no_snapshot_is_told_before_anybody_walks(tmp_path: Path) -> None:
    process = start_run(tmp_path, "--snapshot", str(tmp_path / "none" / "run.snapshot"))
    _, told = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "cannot be written: No such file" in told
    assert not (tmp_path / "out").exists()
