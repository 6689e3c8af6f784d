"""Two gateways, each with a dongle of its own, and one of them with a wrong clock: ``python -m studies.two_gateways``.

A simulated swarm walks between two coordinators. Once both are dongles of one gateway; once each has a gateway, and the second one's
wall clock is wrong. The mapper must count the same encounters, at the same times, and say which clock is wrong by how much.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from studies.ledger import Ledger, check_ledger
from studies.ports import free_port
from studies.system import PartFailedError

_POLL_S: Final = 0.05
_START_S: Final = 60.0
_STOP_S: Final = 15.0
_SETTLE_S: Final = 15.0
_NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What walks, how long [s], and how far ahead the second gateway's clock is [s]; None: there is only one gateway, with both dongles."""

    n_biobots: int
    seed: int
    speed: float
    duration_s: float
    ahead_s: float | None
    sensing: str = "ideal"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What the mapper has in the end.

    ``intervals``: encounters that count, pair and instants [s since the run began, by the site's clock]. ``n_records`` are not void,
    ``n_joint`` encounters are of several of them, and ``n_absorbed`` records stand for none of their own therefore: two meetings of a
    pair that follow each other closer than the clocks can tell make one encounter of three records or four. ``clocks`` and ``faults``
    as the mapper tells them.
    """

    ledger: Ledger
    intervals: tuple[tuple[int, int, float, float], ...]
    n_records: int
    n_joint: int
    n_absorbed: int
    n_reciprocal: int
    n_known: int
    clocks: dict[str, dict[str, Any]]
    faults: tuple[str, ...]


def run(settings: Settings, out: Path) -> Outcome:
    """Run simulator, gateways and mapper until all that was reported is in the mapper.

    Raises
    ------
    PartFailedError
        One of them ended, or was not done in time.
    """
    out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        parts = _Parts(out, stack)
        ready, url_file = out / "ready", out / "url"
        simulator = parts.start(
            "simulator", "simulator", "serve", "--link", "tcp:127.0.0.1:0", "--link", "tcp:127.0.0.1:0", "--scenario", "no-obstacle",
            "--preset", "paper-units", "--biobots", settings.n_biobots, "--seed", settings.seed, "--speed", settings.speed,
            "--duration", settings.duration_s, "--sensing", settings.sensing, "--drain-s", _SETTLE_S,
            "--out", out / "truth", "--ready-file", ready,
        )  # fmt: skip
        parts.wait(ready.exists, what="simulator ready")
        dongles = [f"tcp:{line.removeprefix('tcp:')}" for line in ready.read_text().split()]
        shared = [dongles] if settings.ahead_s is None else [[dongle] for dongle in dongles]
        ends = []
        for number, ports in enumerate(shared):
            end = f"tcp/127.0.0.1:{free_port()}"
            ends.append(end)
            clock = ["studies.wrong_clock", settings.ahead_s] if number and settings.ahead_s else []
            names = [argument for port in ports for argument in ("--port", port)]
            name = f"gateway{number + 1}"
            parts.start(name, *clock, "gateway", "run", *names, "--journal", out / f"{name}.sqlite", "--listen", end, "--name", name)
        connect = [argument for end in ends for argument in ("--connect", end)]
        parts.start(
            "mapper", "mapper", "serve", *connect, "--port", 0, "--url-file", url_file, "--min-interval-s", 0.2, "--method", "paper"
        )
        parts.wait(url_file.exists, what="mapper ready")
        url = url_file.read_text().strip().rstrip("/")
        parts.wait(lambda: simulator.poll() is not None, what="the swarm's end", timeout_s=settings.duration_s + _START_S)
        parts.wait(lambda: _is_level(url, n_gateways=len(shared)), what="a map of what all gateways recorded")
        deadline = time.monotonic() + _SETTLE_S
        while not (found := _look(url, out / "truth")).ledger.is_complete and time.monotonic() < deadline:
            time.sleep(_POLL_S)
        return found


def _look(url: str, truth: Path) -> Outcome:
    records = _all_encounters(url)
    zero_ns = json.loads((truth / "run.json").read_text())["t0_wall_ns"]
    counted, n_reciprocal = [], 0
    for record in records:
        joint = record["joint"] or {**record, "is_counted": True}
        if not record["is_void"] and joint["is_counted"]:
            counted.append({**record, "t_start_wall_ns": joint["t_start_wall_ns"], "t_end_wall_ns": joint["t_end_wall_ns"]})
            n_reciprocal += joint["is_reciprocal"]
    health = _get(url, "/healthz")
    return Outcome(
        ledger=check_ledger(truth, records),
        intervals=tuple(
            sorted(
                (one["node_a"], one["node_b"], (one["t_start_wall_ns"] - zero_ns) / _NS_PER_S, (one["t_end_wall_ns"] - zero_ns) / _NS_PER_S)
                for one in counted
            )
        ),
        n_records=sum(not record["is_void"] for record in records),
        n_joint=sum(bool(record["joint"]) and record["joint"]["is_counted"] for record in records),
        n_absorbed=sum(len(record["joint"]["records"]) - 1 for record in records if record["joint"] and record["joint"]["is_counted"]),
        n_reciprocal=n_reciprocal,
        n_known=health["n_encounters"],
        clocks={gateway["name"]: gateway["clocks"][0] for gateway in _get(url, "/api/v1/gateways")["gateways"]},
        faults=tuple(health["faults"]),
    )


class _Parts:
    """Processes that end with the stack, the last started first."""

    def __init__(self, out: Path, stack: ExitStack) -> None:
        self._out = out
        self._stack = stack
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *arguments: object) -> subprocess.Popen[bytes]:
        with (self._out / f"{name}.log").open("wb") as log:
            command = [sys.executable, "-m", *map(str, arguments)]
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        self._processes[name] = process
        self._stack.callback(_stop, process)
        return process

    def wait(self, probe: Callable[[], object], *, what: str, timeout_s: float = _START_S) -> None:
        deadline = time.monotonic() + timeout_s
        while not probe():
            for name, process in self._processes.items():
                if process.poll() and name != "simulator":
                    raise PartFailedError(f"the {name} ended with exit status {process.returncode}; see {self._out / name}.log")
            if time.monotonic() > deadline:
                raise PartFailedError(f"{what}: not after {timeout_s:g} s; the logs are in {self._out}")
            time.sleep(_POLL_S)


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _is_level(url: str, *, n_gateways: int) -> bool:
    """Say whether the mapper has records of all gateways, and has tried a map of all that it has."""
    status, gateways = _get(url, "/api/v1/map/status"), _get(url, "/api/v1/gateways")["gateways"]
    return bool(
        sum(bool(gateway["clocks"]) for gateway in gateways) == n_gateways and not status["n_waiting"] and not status["is_computing"]
    )


def _all_encounters(url: str) -> list[dict[str, Any]]:
    records: list[dict[str, Any]] = []
    after: int | None = 0
    while after is not None:
        page = _get(url, f"/api/v1/encounters?after={after}&limit=1000")
        records += page["encounters"]
        after = page["next"]
    return records


def _get(url: str, path: str) -> Any:
    with urllib.request.urlopen(url + path, timeout=60) as answer:
        return json.loads(answer.read())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run both, print what came out; 0 where no encounter is missing or there twice, 1 where one is.

    Two runs count the same but for meetings of a pair that follow each other within what the clocks of that run could tell apart.
    """
    parser = argparse.ArgumentParser(prog="python -m studies.two_gateways", description=__doc__)
    parser.add_argument("--biobots", type=int, default=120, help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(default: %(default)s)")
    parser.add_argument("--speed", type=float, default=8.0, help="insects are so many times faster than life (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=30.0, metavar="S", help="(default: %(default)s)")
    parser.add_argument("--ahead", type=float, default=300.0, metavar="S", help="of the second gateway's clock (default: %(default)s)")
    parser.add_argument("--sensing", choices=("ideal", "beacon"), default="ideal", help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    arms: dict[str, Outcome] = {}
    with tempfile.TemporaryDirectory(prefix="two-gateways-") as scratch:
        for name, ahead_s in (("one gateway, two dongles", None), ("two gateways", options.ahead)):
            settings = Settings(
                n_biobots=options.biobots,
                seed=options.seed,
                speed=options.speed,
                duration_s=options.duration,
                ahead_s=ahead_s,
                sensing=options.sensing,
            )
            try:
                arms[name] = run(settings, Path(scratch) / name.replace(" ", "-"))
            except (PartFailedError, urllib.error.URLError) as error:
                print(f"error: {error}", file=sys.stderr)
                return 1
    print(_report(arms))
    return 1 if any(arm.ledger.missing or arm.ledger.doubled for arm in arms.values()) else 0


def _report(arms: dict[str, Outcome]) -> str:
    lines = [
        "| | records | encounters counted | of several records | reciprocal | true encounters | missing | doubled |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, arm in arms.items():
        ledger = arm.ledger
        found = (arm.n_records, arm.n_known, arm.n_joint, arm.n_reciprocal)
        numbers = (*found, ledger.n_encounters, len(ledger.missing), len(ledger.doubled))
        lines.append(f"| {name} | " + " | ".join(f"{number:,}" for number in numbers) + " |")
    for name, arm in arms.items():
        for gateway, clock in arm.clocks.items():
            if clock["n_shared"]:
                ahead_s, bound_s = clock["ahead_ns"] / 1e9, clock["bound_ns"] / 1e9
                lines += ["", f"{name}: {gateway} is {ahead_s:+.4f} s ahead of {clock['reference']}, give or take {bound_s:.4f} s,"]
                lines.append(f"by {clock['n_shared']:,} shared encounters")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
