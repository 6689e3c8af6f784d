"""Whether the mapper has every encounter that the simulated backpacks reported, and none twice."""

import csv
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_NS_PER_S = 1e9

Interval = tuple[float, float]
Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """How reports and records agree; each missing or doubled thing is said as (node a, node b, start [s])."""

    n_encounters: int
    """Encounters that happened, by the simulator's truth."""
    n_reports: int
    """Reports that backpacks made of them: up to two each, more where a report was provisional."""
    n_records: int
    """Records in the mapper's store that count."""
    missing: tuple[tuple[int, int, float], ...]
    """Reports that no record of the pair covers."""
    doubled: tuple[tuple[int, int, float], ...]
    """Encounters that more than one record stands for."""

    @property
    def is_complete(self) -> bool:
        """Nothing is missing and nothing is there twice."""
        return not self.missing and not self.doubled


def check_ledger(truth_directory: Path, records: Iterable[Mapping[str, Any]]) -> Ledger:
    """Compare ``reported.csv`` and ``encounters.csv`` of ``biobot-sim serve`` with records of ``/api/v1/encounters``.

    A record covers a report where their intervals meet within the record's own error bound. A record stands for the
    encounter of its pair that it overlaps most; two encounters of a pair that are closer together than the clocks can tell
    may have become one record, but one encounter must not have become two.
    """
    zero_ns = json.loads((truth_directory / "run.json").read_text())["t0_wall_ns"]
    stored: dict[Pair, list[tuple[Interval, float]]] = defaultdict(list)
    for record in records:
        if not record["is_void"]:
            interval = ((record["t_start_wall_ns"] - zero_ns) / _NS_PER_S, (record["t_end_wall_ns"] - zero_ns) / _NS_PER_S)
            stored[record["node_a"], record["node_b"]].append((interval, record["error_ns"] / _NS_PER_S))
    truth = _read_intervals(truth_directory / "encounters.csv", "id1", "id2")
    reports = _read_intervals(truth_directory / "reported.csv", "node", "peer")
    missing = [
        (*pair, report[0])
        for pair, intervals in reports.items()
        for report in intervals
        if not any(_overlap(report, interval) >= -slack for interval, slack in stored[pair])
    ]
    return Ledger(
        n_encounters=sum(map(len, truth.values())),
        n_reports=sum(map(len, reports.values())),
        n_records=sum(map(len, stored.values())),
        missing=tuple(missing),
        doubled=tuple(_find_doubled(truth, stored)),
    )


def _find_doubled(
    truth: Mapping[Pair, list[Interval]], stored: Mapping[Pair, list[tuple[Interval, float]]]
) -> list[tuple[int, int, float]]:
    doubled = []
    for pair, records in stored.items():
        stands_for: dict[Interval | None, int] = defaultdict(int)
        for interval, _ in records:
            overlaps = [(_overlap(one, interval), one) for one in truth.get(pair, [])]
            stands_for[max(overlaps)[1] if overlaps else None] += 1
        doubled += [(*pair, one[0] if one else float("nan")) for one, count in stands_for.items() if count > 1 or one is None]
    return doubled


def _read_intervals(path: Path, first: str, second: str) -> dict[Pair, list[Interval]]:
    intervals: dict[Pair, list[Interval]] = defaultdict(list)
    with path.open(newline="") as lines:
        for row in csv.DictReader(lines):
            a, b = sorted((int(row[first]), int(row[second])))
            intervals[a, b].append((float(row["t_start_s"]), float(row["t_end_s"])))
    return intervals


def _overlap(one: Interval, other: Interval) -> float:
    """Length of the common part [s]; negative: the gap between them."""
    return min(one[1], other[1]) - max(one[0], other[0])
