"""How fast maps are made, beside the plain ways to make them: ``python -m studies.bench_map``.

150 biobots, 20 of them landmarks, 150 points by the paper's method, and the default one. Every case runs in a process of its own, after a
small map that is not timed; the peers run on the same table right after it. Absolute figures are for a quiet machine; ratios decide.
"""

import argparse
import os
import platform
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from math import inf
from pathlib import Path

import msgspec
import numpy as np

from mapper.kernels import KERNELS_VARIABLE
from mapper.types import KernelsKind, Method
from studies.errors import BenchmarkError, StudyError
from studies.long_run import cut_run
from studies.map_measures import (
    Arrays,
    Bench,
    Comparison,
    MapTiming,
    PeerTiming,
    affordable_repeats,
    compare_with_all_pairs,
    compare_with_dijkstra,
    compare_with_plain,
    find_differences,
    judge,
    sum_distances,
)
from studies.map_report import to_markdown
from studies.map_timing import CASES

_SIZES = (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000)
_QUICK_SIZES = (2_000, 10_000)
_LEAST_SIZE = 2_000  # with fewer, not all biobots have met, and the map is of several pieces
_POINTS = 150
_START_CASE, _STARTS = "paper", 3
_MOST_ALL_PAIRS = 10_000  # 0.8 GB; at 100,000 it would be 80 GB
_MOST_SEARCHED = 300_000
_PLAIN_CASES = ("paper", "default")
_MOST_PLAIN = 100_000
_MOST_IN_FULL = 1_000_000
_REPEATS = 5
_PATIENCE_S = 300.0


class _Run(msgspec.Struct, frozen=True):
    """Seconds of one map by stage."""

    wall_s: dict[str, float]
    core_s: dict[str, float]


class _MapsTold(msgspec.Struct, frozen=True):
    """What `studies.map_timing` prints."""

    points: int
    peak_bytes: int
    runs: list[_Run]


class _PeerTold(msgspec.Struct, frozen=True):
    """What `studies.plain_paths` prints."""

    wall_s: float
    core_s: float
    peak_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How much is measured.

    Parameters
    ----------
    sizes
        Encounters of the tables, ascending.
    cases
        Of ``CASES``, those that are timed.
    repeats
        Maps of each case; medians count.
    sources
        Searches that are measured where all of them take too long.
    most_searched
        Encounters up to which the scipy peer makes all its searches.
    most_plain
        Encounters up to which the plain kernels make maps.
    patience_s
        What maps of one case and size may take, as reckoned by squares from the size before [s].
    """

    sizes: tuple[int, ...] = _SIZES
    cases: tuple[str, ...] = tuple(CASES)
    repeats: int = _REPEATS
    sources: int = 4
    most_searched: int = _MOST_SEARCHED
    most_plain: int = _MOST_PLAIN
    patience_s: float = _PATIENCE_S


@dataclass(frozen=True, slots=True, kw_only=True)
class _Records:
    """What has been measured so far, in order."""

    maps: list[MapTiming] = field(default_factory=list)
    peers: list[PeerTiming] = field(default_factory=list)
    comparisons: list[Comparison] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def repeats(self, case: str, kernels: KernelsKind, size: int, *, wanted: int, patience_s: float) -> int:
        """Say how many maps can be waited for after what was measured, and note what cannot."""
        before = next((timing for timing in reversed(self.maps) if (timing.case, timing.kernels) == (case, kernels)), None)
        repeats = wanted if before is None else affordable_repeats(before, size, wanted=wanted, patience_s=patience_s)
        if before is not None and not repeats:
            self.left_out.append(f"{case}, {kernels} kernels, {size:,} encounters ({before.total_s:.3g} s at {before.encounters:,})")
        return repeats


def measure(effort: Effort, *, seed: int, cache: Path) -> Bench:
    """Measure everything, telling each step on standard error.

    Parameters
    ----------
    cache
        Directory in which the tables are, or will be.

    Raises
    ------
    BenchmarkError
        A measured process failed.
    """
    load_before = os.getloadavg()[0]
    cuts = cut_run(effort.sizes, seed=seed, directory=cache, tell=_tell)
    start_size = effort.sizes[0]
    starts = [_time_start(cuts[start_size]) for _ in range(_STARTS + 1)][1:]  # the first one warms the caches
    _tell(f"start to first map: {statistics.median(wall_s for wall_s, _ in starts):.2f} s")
    records = _Records()
    with tempfile.TemporaryDirectory(prefix="biobot-bench-") as directory:
        for size in effort.sizes:
            _measure_size(size, cuts[size], effort, records, results=Path(directory))
    return Bench(
        machine=_describe_machine(),
        seed=seed,
        load=(load_before, os.getloadavg()[0]),
        start_s=tuple(wall_s for wall_s, _ in starts),
        start_core_s=tuple(core_s for _, core_s in starts),
        start_encounters=start_size,
        maps=tuple(records.maps),
        peers=tuple(records.peers),
        comparisons=tuple(records.comparisons),
        left_out=tuple(records.left_out),
    )


def _measure_size(size: int, cut: Path, effort: Effort, records: _Records, *, results: Path) -> None:
    found: dict[str, tuple[MapTiming, Arrays]] = {}
    for case in effort.cases:
        repeats = records.repeats(case, KernelsKind.COMPILED, size, wanted=effort.repeats, patience_s=effort.patience_s)
        if repeats:
            found[case] = _time_maps(cut, case, size=size, kernels=KernelsKind.COMPILED, repeats=repeats, results=results)
            records.maps.append(found[case][0])

    # Without the filter every encounter can be picked, as by the peer; the work that is timed is the same with it.
    if {"paper", "paper, all kept"} <= found.keys():
        searched = _POINTS if size <= effort.most_searched else effort.sources
        peer, sample = _time_peer(cut, "dijkstra", size=size, searched=searched, results=results)
        records.peers.append(peer)
        differences = find_differences(found["paper, all kept"][1], sample)
        records.comparisons.append(compare_with_dijkstra(found["paper"][0], peer, differences=differences))

    if size <= _MOST_ALL_PAIRS and "paper" in found:
        paper, paper_map = found["paper"]
        peer, sample = _time_peer(cut, "all-pairs", size=size, searched=_POINTS, results=results)
        records.peers.append(peer)
        records.comparisons.append(compare_with_all_pairs(paper, peer, differences=find_differences(paper_map, sample)))

    for case in (case for case in _PLAIN_CASES if case in found and size <= effort.most_plain):
        repeats = records.repeats(case, KernelsKind.PLAIN, size, wanted=1, patience_s=effort.patience_s)
        if repeats:
            plain, plain_map = _time_maps(cut, case, size=size, kernels=KernelsKind.PLAIN, repeats=repeats, results=results)
            records.maps.append(plain)
            compiled, compiled_map = found[case]
            records.comparisons.append(compare_with_plain(compiled, plain, differences=find_differences(compiled_map, plain_map)))


def _time_maps(cut: Path, case: str, *, size: int, kernels: KernelsKind, repeats: int, results: Path) -> tuple[MapTiming, Arrays]:
    result = results / "map.npz"
    arguments = ["studies.map_timing", str(cut), case, "--repeats", str(repeats), "--result", str(result)]
    told = msgspec.json.decode(_run(arguments, kernels=kernels), type=_MapsTold)
    stages = dict.fromkeys(stage for run in told.runs for stage in run.wall_s)
    timing = MapTiming(
        case=case,
        kernels=kernels,
        encounters=size,
        repeats=repeats,
        total_s=statistics.median(sum(run.wall_s.values()) for run in told.runs),
        core_s=statistics.median(sum(run.core_s.values()) for run in told.runs),
        stages_s={stage: statistics.median(run.wall_s.get(stage, 0.0) for run in told.runs) for stage in stages},
        distances_s=statistics.median(sum_distances(run.wall_s) for run in told.runs),
        distances_core_s=statistics.median(sum_distances(run.core_s) for run in told.runs),
        peak_bytes=told.peak_bytes,
        points=told.points,
    )
    _tell(f"{size:,} encounters, {case}, {kernels} kernels: {timing.total_s:.3g} s, {timing.peak_bytes / 1e9:.2f} GB")
    return timing, _load(result)


def _time_peer(cut: Path, way: str, *, size: int, searched: int, results: Path) -> tuple[PeerTiming, Arrays]:
    result = results / "peer.npz"
    arguments = ["studies.plain_paths", str(cut), way, "--points", str(searched), "--result", str(result)]
    told = msgspec.json.decode(_run(arguments, kernels=KernelsKind.COMPILED), type=_PeerTold)
    timing = PeerTiming(
        way=way,
        encounters=size,
        wall_s=told.wall_s * _POINTS / searched,
        core_s=told.core_s * _POINTS / searched,
        points=_POINTS,
        searched=searched,
        peak_bytes=told.peak_bytes,
    )
    is_part = "" if searched == _POINTS else f", reckoned from {searched} searches"
    _tell(f"{size:,} encounters, scipy, {way}: {timing.wall_s:.3g} s{is_part}, {timing.peak_bytes / 1e9:.2f} GB")
    return timing, _load(result)


def _time_start(cut: Path) -> tuple[float, float]:
    """Start a process that makes one map: seconds by the wall's clock, and of all cores."""
    begun_s, begun_core_s = time.perf_counter(), _core_s_of_children()
    _run(["studies.map_timing", str(cut), _START_CASE, "--repeats", "1", "--cold"], kernels=KernelsKind.COMPILED)
    return time.perf_counter() - begun_s, _core_s_of_children() - begun_core_s


def _core_s_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _run(arguments: Sequence[str], *, kernels: KernelsKind) -> bytes:
    """Run a module of ours in a fresh process, and return what it printed."""
    environment = {**os.environ, KERNELS_VARIABLE: kernels.value}
    command = [sys.executable, "-m", *arguments]
    done = subprocess.run(command, capture_output=True, check=False, env=environment)
    if done.returncode:
        raise BenchmarkError(command=shlex.join(command), status=done.returncode, told=done.stderr.decode(errors="replace"))
    return done.stdout


def _load(path: Path) -> Arrays:
    with np.load(path) as content:
        return dict(content)


def _describe_machine() -> dict[str, str]:
    """Say where and when; what has no name of its own stands under the empty one."""
    cpuinfo = Path("/proc/cpuinfo")
    models = (
        [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line] if cpuinfo.exists() else []
    )
    return {
        "": f"{datetime.now(tz=UTC):%Y-%m-%d}, {os.cpu_count()} cores of {models[0] if models else platform.machine()}",
        "Python": platform.python_version(),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
    }


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _parse_sizes(text: str) -> tuple[int, ...]:
    try:
        numbers = sorted({float(part) for part in text.split(",")})
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}; wanted numbers of encounters, as 10000,1e6") from error
    unfit = [number for number in numbers if not (number.is_integer() and number >= _LEAST_SIZE)]
    if unfit:
        raise argparse.ArgumentTypeError(
            f"{unfit[0]:g}; wanted whole numbers of at least {_LEAST_SIZE:,}: with fewer, not all have met yet"
        )
    return tuple(int(number) for number in numbers)


def _parse_count(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r}; wanted a whole number of at least 1")
    return int(text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the report; exit status 1 where results differ, or with ``--check`` where a wanted ratio is missed."""
    parser = argparse.ArgumentParser(prog="python -m studies.bench_map", description="How fast maps are made, beside the plain ways.")
    parser.add_argument("--sizes", type=_parse_sizes, metavar="N,N", help="encounters, as 10000,1e6 (default: 10,000 to 3,000,000)")
    parser.add_argument("--method", choices=list(Method), help="the cases of this method alone (default: both)")
    parser.add_argument("--repeats", type=_parse_count, metavar="R", help=f"maps of each case (default: {_REPEATS})")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the simulated run (default: %(default)s)")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep the tables here (default: made anew every time)")
    parser.add_argument("--quick", action="store_true", help="small tables, one map of each: to see that it works")
    parser.add_argument("--full", action="store_true", help="all searches of the peer, and plain kernels, up to 1,000,000 encounters")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("--check", action="store_true", help="exit status 1 where a wanted ratio is missed")
    options = parser.parse_args(arguments)
    effort = Effort(
        sizes=options.sizes or (_QUICK_SIZES if options.quick else _SIZES),
        cases=tuple(case for case, recipe in CASES.items() if options.method in {None, recipe.method}),
        repeats=options.repeats or (1 if options.quick else _REPEATS),
        most_searched=_MOST_IN_FULL if options.full else _MOST_SEARCHED,
        most_plain=_MOST_IN_FULL if options.full else _MOST_PLAIN,
        patience_s=inf if options.full else _PATIENCE_S,
    )
    try:
        with tempfile.TemporaryDirectory(prefix="biobot-tables-") as directory:
            bench = measure(effort, seed=options.seed, cache=options.cache or Path(directory))
    except StudyError as error:
        _tell(str(error))
        return 1
    print(to_markdown(bench))
    if options.json is not None:
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(bench), indent=2) + b"\n")
    unequal = [one for one in bench.comparisons if one.differences]
    for one in unequal:
        _tell(f"results differ: {one.name}, {one.encounters:,} encounters: {'; '.join(one.differences)}")
    missed = [one for one in judge(bench) if one.is_ratio and not one.is_met]
    return 1 if unequal or (options.check and missed) else 0


if __name__ == "__main__":
    sys.exit(main())
