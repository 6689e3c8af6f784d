"""A simulated site with two obstacles, as its gateway's journal: twenty landmarks and some two thousand encounters."""

import csv
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from firmware_protocol.contract.records import Cause, JournalRecord, Mode
from tests.mapper.fake_gateway import encounter, mode

_NS = 1_000_000_000
_RUN = ("run", "--scenario", "two-obstacles", "--preset", "paper-units", "--seed", "3")


def two_holes(directory: Path) -> list[JournalRecord]:
    """Walk the site (a second or two) and return what is journaled: modes of landmarks first, then encounters in their order."""
    subprocess.run([sys.executable, "-m", "simulator", *_RUN, "--out", str(directory)], check=True, capture_output=True)
    records: list[JournalRecord] = []
    for row in _rows(directory / "modes.csv"):
        if row["mode"] == "S" and row["cause"] == "command":
            records.append(
                mode(len(records) + 1, node=int(row["id"]), t_ns=(_ns(row["t_start_s"]), None), mode=Mode.S, cause=Cause.COMMAND)
            )
    for row in _rows(directory / "encounters.csv"):
        nodes = int(row["id1"]), int(row["id2"])
        records.append(encounter(len(records) + 1, nodes=nodes, t_ns=(_ns(row["t_start_s"]), _ns(row["t_end_s"]))))
    return records


def _rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        yield from csv.DictReader(file)


def _ns(text: str) -> int:
    return round(float(text) * _NS)
