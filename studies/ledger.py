"""Whether the mapper has every encounter that the simulated backpacks reported, and none twice.

A report is known again by what it says on its backpack's own clock, which no gateway's clock can change; where a gateway does not tell
that, by its time.
"""

import csv
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

_NS_PER_S = 1e9

Interval: TypeAlias = tuple[float, float]
Pair: TypeAlias = tuple[int, int]
Place: TypeAlias = tuple[int, int, float]
"""Two nodes, and when [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """How reports and records agree; each thing that is wrong is said as (node a, node b, start [s])."""

    n_encounters: int
    """Encounters that happened, by the simulator's truth."""
    n_reports: int
    """Reports that backpacks made of them: up to two each, more where a report was provisional."""
    n_records: int
    """Encounters in the mapper's store that count, each once, however many records tell of it."""
    missing: tuple[Place, ...]
    """Reports that are in no encounter; of those that no gateway acknowledged before the swarm's end, with none at their time either."""
    doubled: tuple[Place, ...]
    """Encounters that more than one in the store stands for; not a number: one that nobody reported."""
    misdated: tuple[Place, ...] = ()
    """Reports that are in an encounter whose time, as wrong as it says that it may be, is another one."""

    @property
    def is_complete(self) -> bool:
        """Nothing is missing and nothing is there twice."""
        return not self.missing and not self.doubled


@dataclass(frozen=True, slots=True, kw_only=True)
class _Report:
    node: int
    life: int
    ticks: tuple[int, int] | None
    interval: Interval
    is_acknowledged: bool


@dataclass(slots=True, kw_only=True)
class _Stored:
    """What counts as one encounter in the store: its interval, how wrong that may be [s], and what of whose clock is in it."""

    interval: Interval
    error_s: float
    ticks: dict[tuple[int, int], list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    """By node and count of its starts."""

    def has(self, report: _Report) -> bool:
        """Whether the report is in it: by its ticks, or by its time where those of its backpack's start are not told."""
        if report.ticks is None or not self.ticks:
            return self.is_at(report)
        told = self.ticks.get((report.node, report.life))
        if told is None:  # of a side's reports of several starts, the ticks of one are told
            return any(node == report.node for node, _ in self.ticks) and self.is_at(report)
        first, last = report.ticks
        return any(begin <= first and last <= end for begin, end in told)

    def is_at(self, report: _Report) -> bool:
        return _overlap(report.interval, self.interval) >= -self.error_s


def check_ledger(truth_directory: Path, records: Iterable[Mapping[str, Any]]) -> Ledger:
    """Compare ``reported.csv`` and ``encounters.csv`` of ``biobot-sim serve`` with all that ``/api/v1/encounters`` lists.

    An encounter in the store stands for those that happened of which reports are in it; one of which none is, for the one that it
    overlaps most. Two of a pair that are closer together than the clocks can tell may have become one, but one must not have become two.
    """
    zero_ns = json.loads((truth_directory / "run.json").read_text())["t0_wall_ns"]
    stored = _read_store(records, zero_ns=zero_ns)
    truth = _read_truth(truth_directory / "encounters.csv")
    reports = _read_reports(truth_directory / "reported.csv")
    missing, misdated = [], []
    stands_for: dict[tuple[Pair, Interval | None], set[int]] = defaultdict(set)
    for pair, told in reports.items():
        here = stored.get(pair, [])
        for report in told:
            found = [place for place, one in enumerate(here) if one.has(report)]
            if not found and (report.is_acknowledged or not any(one.is_at(report) for one in here)):
                missing.append((*pair, report.interval[0]))
            elif found and not any(here[place].is_at(report) for place in found):
                misdated.append((*pair, report.interval[0]))
            if report.ticks is not None:
                stands_for[pair, _most_overlapped(truth.get(pair, []), report.interval)].update(
                    place for place in found if here[place].ticks
                )
    explained = {(pair, place) for (pair, _), places in stands_for.items() for place in places}
    for pair, ones in stored.items():
        for place, one in enumerate(ones):
            if (pair, place) not in explained:
                stands_for[pair, None if one.ticks else _most_overlapped(truth.get(pair, []), one.interval)].add(place)
    doubled = [
        (*pair, happened[0] if happened else float("nan"))
        for (pair, happened), places in stands_for.items()
        if len(places) > 1 or (places and happened is None)
    ]
    return Ledger(
        n_encounters=sum(map(len, truth.values())),
        n_reports=sum(map(len, reports.values())),
        n_records=sum(map(len, stored.values())),
        missing=tuple(missing),
        doubled=tuple(doubled),
        misdated=tuple(misdated),
    )


def _read_store(records: Iterable[Mapping[str, Any]], *, zero_ns: int) -> dict[Pair, list[_Stored]]:
    """Return what counts, with all of the records that it is made of."""
    found: dict[tuple[Any, ...], _Stored] = {}
    of_pair: dict[Pair, list[_Stored]] = defaultdict(list)
    for number, record in enumerate(records):
        if record["is_void"]:
            continue
        joint = record.get("joint") or record
        name = tuple(record["joint"]["records"][0].values()) if record.get("joint") else (number,)
        one = found.get(name)
        if one is None:
            interval = ((joint["t_start_wall_ns"] - zero_ns) / _NS_PER_S, (joint["t_end_wall_ns"] - zero_ns) / _NS_PER_S)
            one = found[name] = _Stored(interval=interval, error_s=0.0)
            of_pair[record["node_a"], record["node_b"]].append(one)
        one.error_s = max(one.error_s, record["error_ns"] / _NS_PER_S)
        for own in record.get("own_clocks", ()):
            one.ticks[own["node"], own["boot"]].append((own["start_ms"], own["end_ms"]))
    return of_pair


def _read_reports(path: Path) -> dict[Pair, list[_Report]]:
    reports: dict[Pair, list[_Report]] = defaultdict(list)
    with path.open(newline="") as lines:
        for row in csv.DictReader(lines):
            ticks = (int(row["start_ms"]), int(row["end_ms"])) if row.get("start_ms") else None
            interval = (float(row["t_start_s"]), float(row["t_end_s"]))
            is_acknowledged = row["is_acknowledged"] == "1"
            report = _Report(node=int(row["node"]), life=int(row["boot"]), ticks=ticks, interval=interval, is_acknowledged=is_acknowledged)
            reports[_pair(row["node"], row["peer"])].append(report)
    return reports


def _read_truth(path: Path) -> dict[Pair, list[Interval]]:
    intervals: dict[Pair, list[Interval]] = defaultdict(list)
    with path.open(newline="") as lines:
        for row in csv.DictReader(lines):
            intervals[_pair(row["id1"], row["id2"])].append((float(row["t_start_s"]), float(row["t_end_s"])))
    return intervals


def _pair(one: str, other: str) -> Pair:
    low, high = sorted((int(one), int(other)))
    return low, high


def _most_overlapped(intervals: Iterable[Interval], interval: Interval) -> Interval | None:
    """Return the interval that has most in common with another, or is nearest to it; None: there is none."""
    return max(intervals, key=lambda one: (_overlap(one, interval), one), default=None)


def _overlap(one: Interval, other: Interval) -> float:
    """Length of the common part [s]; negative: the gap between them."""
    return min(one[1], other[1]) - max(one[0], other[0])
