"""How much goes through a gateway, how fast, and at what cost: ``python -m studies.bench_gateway``.

Eight dongles of mixed dialects under load (``line_load``), a gateway with its journal on disk, and the mapper's way into its store
(``store_watch``), each a process of its own, on one machine. First as much as goes through, then a steady rate for the latency, then the
raw cost of disk and encoding in the same run, to compare with. In the end the store is compared with what the backpacks said.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from studies.bench_floor import measure_floor
from studies.load_check import Verdict, check_store
from studies.ports import free_port
from studies.system import PartFailedError

_START_S: Final = 60.0
_STOP_S: Final = 30.0
_POLL_S: Final = 0.2
_CLOCK_TICKS: Final = os.sysconf("SC_CLK_TCK")


@dataclass(slots=True, kw_only=True)
class Part:
    """A process that speaks in JSON lines, or says nothing; it ends with this context."""

    name: str
    arguments: list[str]
    log: Path
    source: Path | None = None
    """Tree whose code it runs; None: this one's."""
    _process: "subprocess.Popen[str] | None" = field(default=None)

    def __enter__(self) -> Self:
        environment = {**os.environ, "PYTHONPATH": str(self.source or Path.cwd())}
        with self.log.open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *self.arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, bufsize=1,
                env=environment, cwd=self.source,
            )  # fmt: skip
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()

    @property
    def process(self) -> "subprocess.Popen[str]":
        """The process, which was started."""
        assert self._process is not None, "the context was entered"
        return self._process

    def hear(self) -> dict[str, Any]:
        """Return the next line."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise PartFailedError(f"the {self.name} ended with exit status {self.process.wait()}; see {self.log}")
        facts: dict[str, Any] = json.loads(line)
        return facts

    def tell(self, text: str) -> None:
        """Write a line to it."""
        assert self.process.stdin is not None
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()

    def ask(self, text: str) -> dict[str, Any]:
        """Write a line, and return what comes back."""
        self.tell(text)
        return self.hear()

    def finish(self) -> None:
        """Let a process that listens end by itself, with its files in order."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(_STOP_S)

    def cpu_s(self) -> float:
        """Processor time so far [s]."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _CLOCK_TICKS

    def memory_mib(self) -> float:
        """Resident memory now [MiB]."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """What one run showed."""

    facts: dict[str, Any]
    verdict: Verdict
    memory: list[tuple[float, float, float]]
    """Encounters in the store, memory of gateway and of mapper [MiB], in the course of the run."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and report; 0 where nothing was lost, doubled or altered."""
    parser = argparse.ArgumentParser(prog="python -m studies.bench_gateway", description=__doc__)
    parser.add_argument("--encounters", type=float, default=2e5, help="reported in the run at full speed (default: %(default)g)")
    parser.add_argument("--rate", type=float, default=1000, help="encounters a second of the run for latency (default: %(default)g)")
    parser.add_argument("--seconds", type=float, default=30, help="that it lasts; 0: none (default: %(default)g)")
    parser.add_argument("--singles", type=float, default=5e4, help="at full speed in messages of one entry; 0: none (default: %(default)g)")
    parser.add_argument(
        "--outstanding", type=int, default=12, help="unacknowledged messages of a biobot: fewer on a busy machine (default: %(default)s)"
    )
    parser.add_argument(
        "--baseline", type=Path, metavar="TREE", help="a work tree of an earlier commit whose gateway runs beside this one's"
    )
    parser.add_argument("--out", type=Path, help="keep files and logs here (default: a directory that is removed)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there too")
    options = parser.parse_args(arguments)
    with ExitStack() as stack:
        out = options.out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench-gateway-", dir=Path.cwd())))
        try:
            runs = _measure(options, out)
        except PartFailedError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        floor = measure_floor(out)
    print(_report(runs, floor))
    if options.json is not None:
        options.json.write_text(json.dumps({name: run.facts for name, run in runs.items()} | {"floor": floor}, indent=1) + "\n")
    return 0 if all(run.verdict.is_good for run in runs.values()) else 1


def _measure(options: argparse.Namespace, out: Path) -> dict[str, Run]:
    runs: dict[str, Run] = {}
    closed = ["--outstanding", str(options.outstanding)]
    full = ["--encounters", str(options.encounters), *closed]
    if options.baseline is not None:
        few = ["--encounters", str(min(options.encounters, 1e5)), *closed]
        runs["earlier gateway, full speed"] = run_load(out / "earlier", few, source=options.baseline.resolve())
    runs["full speed"] = run_load(out / "full", full)
    if options.singles:
        runs["full speed, messages of one entry"] = run_load(
            out / "singles", ["--encounters", str(options.singles), "--entries", "1", *closed]
        )
    if options.seconds:
        steady = ["--encounters", str(options.rate * options.seconds), "--rate", str(options.rate), "--sides", "1"]
        runs[f"{options.rate:g} a second"] = run_load(out / "steady", steady, watches_closely=True)
    return runs


def run_load(out: Path, load: list[str], *, source: Path | None = None, watches_closely: bool = False) -> Run:
    """Put a load on a gateway, wait until all is in the mapper's store, and compare.

    Parameters
    ----------
    out
        Made anew; all files and logs are there in the end.
    load
        Options of ``line_load``.
    source
        Tree whose gateway runs; None: this one's.
    watches_closely
        Look at the store twice a millisecond, for latencies.

    Raises
    ------
    PartFailedError
        A part of it ended.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    endpoint, store = f"tcp/127.0.0.1:{free_port()}", out / "store.sqlite"
    _say(f"{out.name}: {' '.join(load)}")
    with ExitStack() as stack:
        swarm = stack.enter_context(Part(name="load", arguments=["studies.line_load", str(out), *load], log=out / "load.log"))
        ports = swarm.hear()["ports"]
        run = ["gateway", "run", "--journal", str(out / "journal.sqlite"), "--listen", endpoint]
        run += [argument for port in ports for argument in ("--port", port)]
        watch = ["studies.store_watch", endpoint, str(store), "--pause-ms", "0.5" if watches_closely else "20"]
        mapper = stack.enter_context(Part(name="mapper", arguments=watch, log=out / "mapper.log"))
        mapper.hear()
        gateway = stack.enter_context(Part(name="gateway", arguments=run, log=out / "gateway.log", source=source))
        swarm.hear()
        first = _wait_until_quiet(mapper)
        before = {part.name: part.cpu_s() for part in (gateway, mapper)}
        swarm.tell("go")
        facts, memory = _follow(swarm, gateway, mapper)
        last = _wait_until_quiet(mapper)
        cpu = {part.name: part.cpu_s() - before[part.name] for part in (gateway, mapper)}
        cpu["mapper"] -= last["watch_cpu_s"] - first["watch_cpu_s"]
        facts["stored_s"] = (last["reached_ns"] - facts["begun_ns"]) / 1e9
        facts |= {f"{name}_us": seconds / facts["entries"] * 1e6 for name, seconds in cpu.items()}
        facts["load_us"] = facts["cpu_s"] / facts["entries"] * 1e6
        facts |= {"counters": last["counters"], "gateways": last["gateways"]}
        mapper.ask("save")
        mapper.finish()
        swarm.tell("end")
    verdict = check_store(store, out / "timetable.npz", seen=store.with_suffix(".seen.npy") if watches_closely else None)
    facts |= {"expected": verdict.n_expected, "lost": verdict.n_lost, "duplicated": verdict.n_duplicated, "altered": verdict.n_altered}
    if len(verdict.latency_ns):
        facts["latency_ms"] = {f"p{p:g}": float(np.percentile(verdict.latency_ns, p)) / 1e6 for p in (50, 90, 99, 99.9, 100)}
    facts["memory"] = memory
    return Run(facts=facts, verdict=verdict, memory=memory)


def _follow(swarm: Part, gateway: Part, mapper: Part) -> tuple[dict[str, Any], list[tuple[float, float, float]]]:
    """Return what the load says in the end, and memory in its course, ever more rarely looked at."""
    result: list[dict[str, Any]] = []
    hearing = threading.Thread(target=lambda: result.append(swarm.hear()), daemon=True)
    hearing.start()
    memory: list[tuple[float, float, float]] = []
    pause_s = 1.0
    while hearing.is_alive():
        hearing.join(pause_s)
        memory.append((float(mapper.ask("facts")["encounters"]), gateway.memory_mib(), mapper.memory_mib()))
        if len(memory) >= 40:
            memory, pause_s = memory[1::2], 2 * pause_s
    if not result:
        raise PartFailedError(f"the load ended; see {swarm.log}")
    return result[0], memory


def _wait_until_quiet(mapper: Part) -> dict[str, Any]:
    """Wait until nothing comes into the store any more."""
    before, since = -1, time.monotonic()
    while True:
        facts = mapper.ask("facts")
        if facts["change"] != before:
            before, since = facts["change"], time.monotonic()
        if time.monotonic() - since > 5 * _POLL_S:
            return facts
        time.sleep(_POLL_S)


def _report(runs: dict[str, Run], floor: dict[str, float]) -> str:
    lines = ["", "| run | encounters/s | gateway CPU [us] | mapper CPU [us] | load CPU [us] | repeats | lost | doubled | altered |"]
    lines.append("|---|---|---|---|---|---|---|---|---|")
    for name, run in runs.items():
        facts = run.facts
        speed = facts["entries"] / facts["stored_s"]
        lines.append(
            f"| {name} | {speed:,.0f} | {facts['gateway_us']:.1f} | {facts['mapper_us']:.1f} | {facts['load_us']:.1f} "
            f"| {facts['repeats']:,} | {facts['lost']} | {facts['duplicated']} | {facts['altered']} |"
        )
    lines += ["", "CPU is of one encounter: one entry of a batch on the radio. The floor, in the same run:"]
    lines += [f"  {name}: {microseconds:.1f} us" for name, microseconds in floor.items()]
    for name, run in runs.items():
        if "latency_ms" in run.facts:
            percentiles = ", ".join(f"{p} {value:.1f} ms" for p, value in run.facts["latency_ms"].items())
            lines += ["", f"Radio byte to mapper's store, {name}: {percentiles}"]
    for name, run in runs.items():
        lines += ["", f"Memory, {name} (encounters stored: gateway, mapper [MiB]):"]
        step = max(1, len(run.memory) // 8)
        lines += [f"  {stored:>12,.0f}: {gateway:6.1f} {mapper:6.1f}" for stored, gateway, mapper in run.memory[::step]]
    return "\n".join(lines)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
