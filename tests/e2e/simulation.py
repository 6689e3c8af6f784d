"""The simulator as a process opposite the real gateway, and what the gateway made of it."""

import asyncio
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord, JournalRecord
from tests.gateway.fake_radio import until


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
    _, told = await asyncio.to_thread(process.communicate, None, 60)
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
