"""The simulator as a process opposite the real gateway, and what the gateway made of it."""

import asyncio
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord, JournalRecord
from tests.gateway.fake_radio import until

RECORDED = """t_start_s,t_end_s,id1,id2
100.280,100.300,3,5
100.980,101.080,4,5
104.000,109.140,3,100009
104.020,104.020,5,100010
106.500,111.900,4,3
112.340,118.000,100010,1
113.000,119.250,1,3
125.500,126.750,3,5
130.000,139.500,2,100009
131.000,131.040,1,2
139.980,140.000,4,100009
"""


@contextmanager
def simulating(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command_line = [sys.executable, "-m", "simulator", *arguments]
    with subprocess.Popen(command_line, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


async def ready(process: subprocess.Popen[str], file: Path) -> list[str]:
    await until(lambda: file.exists() or process.poll() is not None, what="the simulator is ready", timeout_s=60)
    assert process.poll() is None, process.stderr.read() if process.stderr else ""
    return file.read_text().split()  # noqa: ASYNC240  # a line of text on a local disk


async def end_of(process: subprocess.Popen[str]) -> str:
    _, told = await asyncio.to_thread(process.communicate, None, 150)
    assert process.returncode == 0, told
    return str(told)


def current(records: Iterable[JournalRecord]) -> list[EncounterRecord]:
    """The newest revision of each encounter that counts."""
    newest = {one.identity: one for one in sorted(records, key=lambda one: one.offset) if isinstance(one, EncounterRecord)}
    return [one for one in newest.values() if not one.is_void]


def as_rows(records: Iterable[EncounterRecord]) -> list[Mapping[str, object]]:
    return [
        {
            "node_a": one.node_a, "node_b": one.node_b, "error_ns": one.error_ns, "is_void": one.is_void,
            "t_start_wall_ns": one.t_start_ns + one.wall_anchor_ns, "t_end_wall_ns": one.t_end_ns + one.wall_anchor_ns,
        }
        for one in records
    ]  # fmt: skip
