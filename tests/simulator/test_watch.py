"""Laws of watching: the run stays the same, the picture fits its window, the terminal is given back."""

import contextlib
import io
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from simulator.clock import SettableClock
from simulator.log import set_up_logging
from simulator.pictures.canvas import Ink, paint
from simulator.pictures.watch import Watch
from simulator.world import World
from tests.simulator.arenas import one_obstacle, world_in

ROOT = Path(__file__).parent.parent.parent
ENTER, LEAVE = b"\x1b[?1049h\x1b[?25l", b"\x1b[?25h\x1b[?1049l"
RUN = ("run", "--scenario", "one-obstacle", "--seed", "1", "--biobots", "50")


def watch_of(world: World, *, clock: SettableClock | None = None, environment: dict[str, str] | None = None) -> Watch:
    clock = SettableClock() if clock is None else clock
    return Watch(
        world,
        title="a room",
        end_s=20.0,
        stream=io.StringIO(),
        environment={} if environment is None else environment,
        clock=clock,
        sleep=lambda s: clock.move(round(s * 1e9)),
    )


def without_colours(line: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", line)


@pytest.mark.parametrize("speed", [None, 3.0])
def test_watching_changes_nothing(speed: float | None) -> None:
    watched, alone = world_in(one_obstacle()), world_in(one_obstacle())
    watch = watch_of(watched)
    made = watch.advance(5.0, speed=speed)
    watched.stop(3)
    alone_made = alone.advance(5.0)
    alone.stop(3)
    assert made + watch.advance(20.0, speed=speed) == alone_made + alone.advance(20.0)
    assert watched.now_s == alone.now_s == 20.0


def test_a_paced_run_takes_as_long_as_asked() -> None:
    clock = SettableClock()
    watch = watch_of(world_in(one_obstacle()), clock=clock)
    watch.advance(20.0, speed=4.0)
    assert clock.now_ns == pytest.approx(5e9, rel=1e-6)


def test_the_line_of_state_tells_time_speed_and_encounters() -> None:
    world = world_in(one_obstacle())
    watch = watch_of(world)
    events = watch.advance(20.0, speed=4.0)
    state = watch.picture(columns=100, rows=30, more="and more")[-2]
    began = sum(type(event).__name__ == "EncounterBegan" for event in events)
    told = re.fullmatch(r"20\.0 of 20 s  ([0-9.]+) x real time  ([0-9]+) encounters, [0-9.]+ a second  and more", state)
    assert told is not None, state
    assert float(told[1]) == pytest.approx(4.0, rel=0.05)  # to a frame in three seconds
    assert int(told[2]) == began


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (200, 60), (20, 8), (19, 8), (40, 7), (1, 1), (300, 9)])
@pytest.mark.parametrize("environment", [{}, {"NO_COLOR": "1"}])
def test_the_picture_fits_its_window(columns: int, rows: int, environment: dict[str, str]) -> None:
    world = world_in(one_obstacle())
    watch = watch_of(world, environment=environment)
    watch.advance(1.0)
    lines = watch.picture(columns=columns, rows=rows, more="x" * 500)
    assert 1 <= len(lines) <= rows
    assert all(len(without_colours(line)) <= columns for line in lines)
    assert ("\x1b" in "".join(lines)) == (not environment and columns >= 20 and rows >= 8)


def test_those_who_meet_walk_and_stand_have_their_colours() -> None:
    world = world_in(one_obstacle(), biobots=12, detection=1.0)
    world.stop(1)
    watch = watch_of(world)
    watch.advance(2.0)
    picture = "\n".join(watch.picture(columns=160, rows=80)[1:-3])
    styles = {ink: paint("", ink).removesuffix("\x1b[0m") for ink in Ink if ink is not Ink.NONE}
    met = {one for pair in world.open_encounters() for one in (pair.id1, pair.id2)}
    assert (styles[Ink.MEETING] in picture) == bool(met)
    assert (styles[Ink.LANDMARK] in picture) == (1 not in met)
    assert styles[Ink.WALL] in picture
    assert styles[Ink.WALKING] in picture
    assert styles[Ink.RESTING] not in picture


def test_without_a_terminal_there_are_lines_of_log(capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging()
    with watch_of(world_in(one_obstacle())) as watch:
        watch.advance(20.0, speed=1.0)
    lines = capsys.readouterr().err.splitlines()
    assert all('"watch.progress"' in line and "\x1b" not in line for line in lines)
    assert len(lines) == 20 / 5 + 1


class Terminal:
    """A program in a terminal of its own, 80 by 24."""

    def __init__(self, program: subprocess.Popen[bytes], master: int) -> None:
        self.program = program
        self.shown = b""
        self._master = master

    def read(self, *, until: bytes | None) -> None:
        """Read until something was shown, or to the end."""
        deadline = time.monotonic() + 120
        while until is None or until not in self.shown:
            assert time.monotonic() < deadline, self.shown[-500:]
            if select.select([self._master], [], [], 0.1)[0]:
                try:
                    self.shown += os.read(self._master, 65536)
                except OSError:  # Linux: the other end is closed
                    return
            elif self.program.poll() is not None and until is None:
                return


@contextlib.contextmanager
def terminal(*arguments: str, **environment: str) -> Iterator[Terminal]:
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (24, 80))
    variables = {"PATH": os.environ["PATH"], "TERM": "xterm-256color", "PYTHONPATH": str(ROOT)} | environment
    program = subprocess.Popen(
        [sys.executable, "-m", "simulator", *arguments], stderr=slave, stdout=slave, stdin=slave, env=variables, start_new_session=True
    )
    os.close(slave)
    try:
        yield Terminal(program, master)
    finally:
        program.kill()
        program.wait(timeout=60)
        os.close(master)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 130)])
def test_a_signal_gives_the_terminal_back(tmp_path: Path, number: int, status: int) -> None:
    with terminal(*RUN, "--watch", "--watch-speed", "5", "--out", str(tmp_path / "out")) as watched:
        watched.read(until=b"x real time")
        watched.program.send_signal(number)
        watched.read(until=None)
        assert watched.program.wait(timeout=60) == status
    assert watched.shown.count(ENTER) == watched.shown.count(LEAVE) == 1
    assert watched.shown.index(ENTER) < watched.shown.index(LEAVE)
    assert b"\x1b[" not in watched.shown.split(LEAVE)[1]
    assert b"interrupted" in watched.shown.split(LEAVE)[1]
    assert list(tmp_path.iterdir()) == []


def test_a_watched_service_ends_as_others_do(tmp_path: Path) -> None:
    link = f"pty:{tmp_path / 'dongle'}"
    with terminal("serve", *RUN[1:], "--link", link, "--watch", "--drain-s", "0") as watched:
        watched.read(until=b"gateway absent")
        watched.program.send_signal(signal.SIGTERM)
        watched.read(until=None)
        assert watched.program.wait(timeout=60) == 0
    assert watched.shown.count(ENTER) == watched.shown.count(LEAVE) == 1
    assert b"serve.ended" in watched.shown.split(LEAVE)[1]


def test_a_watched_run_to_the_end_writes_what_any_run_writes(tmp_path: Path) -> None:
    with terminal(*RUN, "--duration", "20", "--watch", "--out", str(tmp_path / "out"), NO_COLOR="1") as watched:
        watched.read(until=None)
        assert watched.program.wait(timeout=60) == 0
    assert b"\x1b[38;5" not in watched.shown
    assert b"run.done" in watched.shown.split(LEAVE)[1]
    command = [sys.executable, "-m", "simulator", *RUN, "--duration", "20", "--out", str(tmp_path / "other")]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=60)
    for name in ("encounters.csv", "modes.csv", "truth.npz"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()


def test_a_dumb_terminal_gets_lines(tmp_path: Path) -> None:
    with terminal(*RUN, "--duration", "5", "--watch", "--out", str(tmp_path / "out"), TERM="dumb") as watched:
        watched.read(until=None)
        assert watched.program.wait(timeout=60) == 0
    assert b"watch.progress" in watched.shown
    assert b"\x1b" not in watched.shown
