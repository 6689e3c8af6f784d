"""Does anything grow? ``python -m studies.soak --hours 2``: a swarm, three dongles that fail now and then, a gateway, a mapper, pages.

Every half minute the memory, the open descriptors and the threads of each process are read from /proc. At the end the medians of the
middle third and of the last third are compared: the first third is the time in which windows and caches fill. A mapper keeps every
encounter, so its memory may grow with them.
"""

import argparse
import csv
import http.client
import json
import shutil
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final, TextIO

from studies.live_watch import Watch, children_of
from studies.parts import Parts
from studies.ports import free_port
from studies.system import PartFailedError

_LINKS: Final = ("pty:{out}/native", "tcp:127.0.0.1:0?dialect=xbee", "tcp:127.0.0.1:0?dialect=znp")
_FAULTS: Final = "bit-flip=1e-5,unplug=0.01,unplug-s=2,stall=0.01,stall-s=1,reset=0.005"
_PATHS: Final = {"/api/v1/map/status": 1.0, "/healthz": 2.0, "/api/v1/map": 3.0}
_MAP_EVERY_S: Final = 20
_MAX_GROWTH_MB_PER_H: Final = 2.0
_MAX_BYTES_PER_ENCOUNTER: Final = 2_000.0
_MB: Final = 2**20


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One process at one time. ``hour`` since the start; ``rss`` in bytes."""

    hour: float
    process: str
    rss: int
    n_descriptors: int
    n_threads: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """How one process has changed from the middle third of the time to the last one."""

    process: str
    rss_mb: float
    rss_mb_per_h: float
    n_descriptors: tuple[float, float]
    n_threads: tuple[float, float]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, measure and report; 0 where nothing has grown, 1 where something has or a process has ended."""
    parser = argparse.ArgumentParser(prog="python -m studies.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=2.0, help="(default: %(default)s)")
    parser.add_argument("--every", type=float, default=30.0, metavar="S", help="seconds between two readings (default: %(default)s)")
    parser.add_argument("--speed", type=float, default=2.0, help="insects are so many times faster than life (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("soak-out"), help="made anew; logs and readings stay there (default: %(default)s)")
    options = parser.parse_args(arguments)
    out: Path = options.out.resolve()
    if out.exists() and any(out.iterdir()) and not (out / "simulator.log").exists():
        print(f"error: {out} is not empty and not of an earlier run; choose another --out", file=sys.stderr)
        return 2
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    try:
        readings, n_encounters, n_failed = _run(options, out)
    except PartFailedError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    growths = [growth_of(name, readings) for name in sorted({reading.process for reading in readings})]
    faults = [*faults_of(growths, n_encounters=n_encounters, hours=options.hours), *([f"{n_failed} requests failed"] if n_failed else [])]
    print(_report(growths, n_encounters=n_encounters, hours=options.hours))
    for fault in faults:
        print(f"grows: {fault}")
    return 1 if faults else 0


def growth_of(process: str, readings: Sequence[Reading]) -> Growth:
    """Compare the middle and the last third of one process's readings, of which there are three at least."""
    mine = [reading for reading in readings if reading.process == process]
    third = len(mine) // 3
    middle, last = mine[third : 2 * third], mine[2 * third :]
    hours = median(one.hour for one in last) - median(one.hour for one in middle)
    before, after = (median(one.rss for one in part) / _MB for part in (middle, last))
    return Growth(
        process=process,
        rss_mb=after,
        rss_mb_per_h=(after - before) / hours,
        n_descriptors=(median(one.n_descriptors for one in middle), median(one.n_descriptors for one in last)),
        n_threads=(median(one.n_threads for one in middle), median(one.n_threads for one in last)),
    )


def faults_of(growths: Sequence[Growth], *, n_encounters: int, hours: float) -> list[str]:
    """Name what has grown beyond what a process may."""
    found = []
    for growth in growths:
        limit = _MAX_GROWTH_MB_PER_H
        if growth.process.startswith("mapper"):
            limit += n_encounters / hours * _MAX_BYTES_PER_ENCOUNTER / _MB
        if growth.rss_mb_per_h > limit and growth.process != "simulator":
            found.append(f"memory of the {growth.process} by {growth.rss_mb_per_h:.1f} MB/h, at most {limit:.1f} are allowed")
        for what, (before, after) in (("descriptors", growth.n_descriptors), ("threads", growth.n_threads)):
            if after > before + 1:  # a page may be asked for at the moment of a reading
                found.append(f"{what} of the {growth.process} from {before:g} to {after:g}")
    return found


def _run(options: argparse.Namespace, out: Path) -> tuple[list[Reading], int, int]:
    ready, url_file, end = out / "simulator.ready", out / "url", f"tcp/127.0.0.1:{free_port()}"
    with Parts(out=out) as parts:
        links = [argument for link in _LINKS for argument in ("--link", link.format(out=out))]
        parts.start(
            "simulator", "simulator", "serve", *links, "--scenario", "two-obstacles", "--preset", "paper-units", "--biobots", 150,
            "--speed", options.speed, "--duration", round(3600 * options.hours + 3600), "--seed", options.seed, "--fault", _FAULTS,
            "--ready-file", ready,
        )  # fmt: skip
        parts.wait(ready.exists, what="simulator ready")
        ports = [argument for port in ready.read_text().split() for argument in ("--port", port)]
        parts.start("gateway", "gateway", "run", *ports, "--journal", out / "gateway.sqlite", "--listen", end)
        parts.start(
            "mapper", "mapper", "serve", "--store", out / "mapper.sqlite", "--port", 0, "--url-file", url_file, "--connect", end,
            "--min-interval-s", _MAP_EVERY_S,
        )  # fmt: skip
        parts.wait(url_file.exists, what="mapper ready")
        url = url_file.read_text().strip().rstrip("/")
        parts.wait(lambda: _has_map(url), what="the first map")
        with Watch(url, periods_s=_PATHS) as watch, (out / "readings.csv").open("w", newline="") as file:
            readings = _read_on(parts, file, hours=options.hours, every_s=options.every, url=url)
        return readings, _n_encounters(url), watch.n_failed


def _read_on(parts: Parts, file: TextIO, *, hours: float, every_s: float, url: str) -> list[Reading]:
    readings: list[Reading] = []
    table = csv.writer(file)
    begun = time.monotonic()
    table.writerow(("hour", "process", "rss", "descriptors", "threads", "encounters"))
    while (hour := (time.monotonic() - begun) / 3600) < hours:
        time.sleep(every_s)
        parts.check()
        n_encounters = _n_encounters(url)
        for name, pid in parts.pids.items():
            for index, one in enumerate((pid, *children_of(pid))):
                reading = _read(one, process=name if index == 0 else f"{name}'s child {index}", hour=hour)
                if reading is not None:
                    readings.append(reading)
                    table.writerow((f"{hour:.4f}", reading.process, reading.rss, reading.n_descriptors, reading.n_threads, n_encounters))
        file.flush()
        print(f"\r{hour:.2f} of {hours:g} h, {n_encounters:,} encounters ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return readings


def _read(pid: int, *, process: str, hour: float) -> Reading | None:
    """Read what a process holds; None where it has just ended, as the mapper's computing process may."""
    try:
        lines = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        n_descriptors = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    except OSError:
        return None
    if "VmRSS" not in lines:
        return None
    return Reading(
        hour=hour, process=process, rss=int(lines["VmRSS"].split()[0]) * 1024, n_descriptors=n_descriptors, n_threads=int(lines["Threads"])
    )


def _has_map(url: str) -> bool:
    try:
        with urllib.request.urlopen(f"{url}/api/v1/map", timeout=30):
            return True
    except (urllib.error.URLError, http.client.HTTPException, TimeoutError):
        return False


def _n_encounters(url: str) -> int:
    try:
        with urllib.request.urlopen(f"{url}/healthz", timeout=30) as answer:
            return int(json.load(answer)["counters"].get("new", 0))
    except (urllib.error.URLError, http.client.HTTPException, TimeoutError):
        return 0


def _report(growths: Sequence[Growth], *, n_encounters: int, hours: float) -> str:
    lines = [f"{n_encounters:,} records in {hours:g} h", "", "| process | MB | MB/h | descriptors | threads |", "|---|---|---|---|---|"]
    for growth in growths:
        descriptors, threads = ("{:g} to {:g}".format(*pair) for pair in (growth.n_descriptors, growth.n_threads))
        lines.append(f"| {growth.process} | {growth.rss_mb:.1f} | {growth.rss_mb_per_h:+.2f} | {descriptors} | {threads} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
