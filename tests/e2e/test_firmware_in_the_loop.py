"""The reference coordinator firmware on an emulated Cortex-M3 behind a pty, and the gateway as a user starts it."""

import contextlib
import importlib.util
import json
import random
import re
import shutil
import sqlite3
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, ModeRecord
from gateway.journal_file import JournalReader
from studies.ports import free_port
from tests.e2e.bench_encounters import N_NODES, Meeting, all_meetings
from tests.e2e.emulated_board import EMULATOR, EmulatedBoard
from tests.e2e.troubled_line import TroubledLine

ROOT = Path(__file__).parents[2]
NS_PER_MS = 1_000_000
LOST_IN_RESET_NS = 250 * NS_PER_MS
"""A busy host may leave the emulator out that long; meetings of a pair are seconds apart."""


def _builder() -> ModuleType:
    spec = importlib.util.spec_from_file_location("build_firmware", ROOT / "scripts" / "build_firmware.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module


BUILDER = _builder()


class RunningGateway:
    """``biobot-gateway run`` on one port, and what it has on disk."""

    def __init__(self, folder: Path, port: str) -> None:
        self.folder = folder
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._port = port
        self._process = self._start()

    def _start(self) -> "subprocess.Popen[bytes]":
        arguments = ["run", "--port", f"serial:{self._port}", "--journal", str(self.folder / "journal.sqlite"), "--listen", self.endpoint]
        with (self.folder / "gateway.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "gateway", *arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=ROOT
            )

    def kill_and_start_again(self) -> None:
        self._process.kill()
        self._process.wait()
        self._process = self._start()

    def stop(self) -> int:
        self._process.terminate()
        return self._process.wait(60)

    def log(self) -> str:
        return (self.folder / "gateway.log").read_text()

    def events(self, name: str) -> list[dict[str, Any]]:
        whole = [line for line in self.log().splitlines(keepends=True) if line.startswith("{") and line.endswith("}\n")]
        return [event for event in map(json.loads, whole) if event["event"] == name]

    def n_entries(self) -> int:
        """Count what is in the journal: encounters and their revisions, and modes."""
        return self._read(from_offset=1, limit=1)[1]

    def records(self) -> list[Any]:
        """Return the newest revision of each record that counts."""
        newest = {record.identity: record for record in self._read(from_offset=1, limit=1_000_000)[0]}
        return list(newest.values())

    def encounters(self) -> list[EncounterRecord]:
        return [record for record in self.records() if isinstance(record, EncounterRecord) and not record.is_void]

    def wait_until(self, is_so: Callable[[], bool], *, what: str, timeout_s: float = 120.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not is_so():
            assert self._process.poll() is None, f"the gateway ended:\n{self.log()[-3000:]}"
            assert time.monotonic() < deadline, f"not within {timeout_s:g} s: {what}; {self.n_entries()} entries\n{self.log()[-3000:]}"
            time.sleep(0.05)

    def command(self, node: int, action: str) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._run("command", str(node), action).splitlines()]

    def command_once_admitted(self, node: int, action: str) -> list[dict[str, Any]]:
        """Give a command until it is not refused: after a kill nobody is given a train for a while (docs/stimulation.md)."""
        stages: list[dict[str, Any]] = []

        def is_admitted() -> bool:
            stages[:] = self.command(node, action)
            return bool(stages) and stages[0]["stage"] != "refused"

        self.wait_until(is_admitted, what=f"{action} of {node} is admitted")
        return stages

    def status(self) -> dict[str, Any]:
        status: dict[str, Any] = json.loads(self._run("status"))
        return status

    def _run(self, *arguments: str) -> str:
        command = [sys.executable, "-m", "gateway", *arguments, "--connect", self.endpoint]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False).stdout

    def _read(self, *, from_offset: int, limit: int) -> tuple[list[JournalRecord], int]:
        try:
            with contextlib.closing(JournalReader(self.folder / "journal.sqlite")) as reader:
                return reader.read_records(from_offset=from_offset, limit=limit)
        except sqlite3.OperationalError:  # not made yet
            return [], 0


def _check_times(meetings: list[Meeting], encounters: list[EncounterRecord]) -> None:
    """Bench time and the gateway's clock differ by one number, within the errors that records state: clocks of twelve backpacks were found.

    A reset costs the virtual backpacks' clocks the time from the last poll to the new start, which is no error of the gateway's.
    """
    ordered = sorted(encounters, key=lambda record: (record.node_a, record.node_b, record.t_start_ns))
    offsets = [record.t_start_ns - meeting.start_ms * NS_PER_MS for meeting, record in zip(meetings, ordered, strict=True)]
    offset = statistics.median(offsets)
    for meeting, record, its in zip(meetings, ordered, offsets, strict=True):
        assert (record.node_a, record.node_b) == (meeting.low, meeting.high)
        assert abs(its - offset) <= record.error_ns + LOST_IN_RESET_NS
        # A clock known to 100 ms when it is first believed, a drift of 100 ppm over 1000 s, and what a busy machine adds.
        assert record.error_ns <= 1000 * NS_PER_MS
        assert record.t_end_ns - record.t_start_ns == pytest.approx(meeting.duration_ms * NS_PER_MS, abs=2 * record.error_ns + NS_PER_MS)


@pytest.mark.e2e
@pytest.mark.timeout(280)
@pytest.mark.skipif(
    shutil.which(EMULATOR) is None or shutil.which(BUILDER.PORTS["mps2_an385"].compiler) is None,
    reason=f"no {EMULATOR} or no arm-none-eabi-gcc: run make system-packages",
)
def test_thousands_of_encounters_are_journaled_once_through_damage_noise_a_reset_and_a_killed_gateway(tmp_path: Path) -> None:
    image = BUILDER.build("mps2_an385", out=tmp_path)
    meetings = all_meetings()
    with EmulatedBoard(image=image, folder=tmp_path) as board, TroubledLine(device=board.port, seed=5) as line:
        gateway = RunningGateway(tmp_path, line.port)
        try:
            gateway.wait_until(lambda: bool(gateway.events("radio.identified")), what="the coordinator's hello")
            gateway.wait_until(lambda: gateway.n_entries() > 500, what="the first encounters")

            line.damage = 0.0005
            damaged = gateway.n_entries()
            gateway.wait_until(lambda: line.n_damaged > 40 and gateway.n_entries() > damaged + 500, what="encounters over a bad line")
            line.damage = 0.0
            line.inject(random.Random(7).randbytes(3000))

            stages = gateway.command(5, "stop")
            assert [stage["stage"] for stage in stages] == ["accepted", "radio_confirmed", "biobot_confirmed"], stages
            assert stages[-1]["mode"] == "S"

            board.reset()
            gateway.wait_until(lambda: bool(gateway.events("radio.restarted") or gateway.events("radio.down")), what="the reset is noticed")
            # A slow machine may have journaled nearly all before the reset: each meeting is an encounter and a revision, no more.
            wanted = min(gateway.n_entries() + 500, 2 * len(meetings))
            gateway.wait_until(lambda: gateway.n_entries() >= wanted, what="encounters after the reset")
            counters = gateway.status()["counters"]

            gateway.kill_and_start_again()
            gateway.wait_until(lambda: len(gateway.encounters()) >= len(meetings), what="all encounters")
            gateway.wait_until(lambda: all(record.is_reciprocal for record in gateway.encounters()), what="both sides of each")
            stages = gateway.command_once_admitted(5, "start")
            assert [stage["stage"] for stage in stages] == ["accepted", "radio_confirmed", "biobot_confirmed"], stages
            assert stages[-1]["mode"] == "CRW"
            gateway.wait_until(lambda: _last_mode(gateway, 5) == "CRW", what="the mode's record")
        finally:
            code = gateway.stop()
    assert code == 0, gateway.log()[-3000:]
    assert "Traceback" not in gateway.log()
    assert sum(count for name, count in counters.items() if name.startswith("frame.")) > 20, "the damage was real"
    assert counters["radio.sessions"] >= 2
    assert counters["message.hello"] >= N_NODES
    _check_times(meetings, gateway.encounters())


def _last_mode(gateway: RunningGateway, node: int) -> str:
    spells = [record for record in gateway.records() if isinstance(record, ModeRecord) and record.node == node]
    return max(spells, key=lambda spell: spell.t_start_ns).mode.value


@pytest.mark.skipif(shutil.which(BUILDER.PORTS["cc2530"].compiler) is None, reason="no sdcc: run make system-packages")
def test_the_firmware_links_for_a_cc2530_and_fits_its_memory(tmp_path: Path) -> None:
    """64 KiB of flash that code reaches without banks, of 256; 8 KiB of RAM. Linked, and not run on the chip."""
    image: Path = BUILDER.build("cc2530", out=tmp_path)
    rows = re.findall(r"^ +(EXTERNAL RAM|ROM/EPROM/FLASH) +\S+ +\S+ +(\d+) ", image.with_suffix(".mem").read_text(), re.MULTILINE)
    used = {name: int(size) for name, size in rows}
    assert 10_000 < used["ROM/EPROM/FLASH"] < 0x10000
    assert 3_000 < used["EXTERNAL RAM"] < 0x1F00
    assert image.read_text().splitlines()[-1] == ":00000001FF", "Intel HEX ends so"
