"""Live operation under load: ``python -m studies.bench_live``.

A store of 500,000 encounters, a mapper on it, and two gateways: one with a simulated swarm on its radio, and one that publishes 2,000
encounters a second. How old is the map, how long does the API take, does the gateway with the radio notice, is anything lost, and how
long does a restart take? All are processes of their own, on one machine.
"""

import argparse
import json
import os
import shutil
import signal
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, RecordIdentity
from gateway.journal_file import JournalReader
from mapper.store import Store
from studies.link_tap import LinkTap
from studies.live_feeder import NAME as FEEDER
from studies.live_life import Life, fill_store
from studies.live_watch import Watch, core_times, peak_memory, share
from studies.parts import Parts
from studies.ports import free_port
from studies.system import PartFailedError

_SWARM: Final = "gateway1"
_STATUS, _MAP, _HEALTH = "/api/v1/map/status", "/api/v1/map", "/healthz"
_PERIODS_S: Final = {_STATUS: 0.1, _MAP: 0.5, _HEALTH: 0.5}
_SETTLE_S: Final = 5.0
_PAGE: Final = 10_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and report; 0 where nothing was lost and the map was never older than asked, 1 where not."""
    parser = argparse.ArgumentParser(prog="python -m studies.bench_live", description=__doc__)
    parser.add_argument("--encounters", type=int, default=500_000, help="in the store at the start (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=2_000, help="encounters published a second (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=60, help="that they are (default: %(default)s)")
    parser.add_argument("--alone-seconds", type=float, default=20, help="the swarm's gateway is measured alone (default: %(default)s)")
    parser.add_argument("--method", choices=("paper", "default"), default="paper", help="recipe of the map (default: %(default)s)")
    parser.add_argument("--max-age", type=float, default=3.0, metavar="S", help="the map may be so old (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("bench-live-out"), help="made anew; logs stay there (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there too")
    options = parser.parse_args(arguments)
    out: Path = options.out.resolve()
    if out.exists() and any(out.iterdir()) and not (out / "life.npz").exists():
        print(f"error: {out} is not empty and not of an earlier run; choose another --out", file=sys.stderr)
        return 2
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    try:
        facts = _measure(options, out)
    except PartFailedError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.json is not None:
        options.json.write_text(json.dumps(facts, indent=1) + "\n")
    print(_report(facts, options))
    return 0 if facts["lost"] == 0 and facts["behind_s"]["max"] <= options.max_age else 1


def _measure(options: argparse.Namespace, out: Path) -> dict[str, Any]:
    n_published = round(options.rate * options.seconds)
    _say(f"simulating {options.encounters + n_published:,} encounters")
    life = Life.simulate(options.encounters + n_published, seed=1)
    life.save(out / "life.npz")
    anchor_ns = time.time_ns() - int(life.t_end_ns[-1])
    store = out / "mapper.sqlite"
    _say(f"filling a store with {options.encounters:,}")
    fill_store(store, life, n_encounters=options.encounters, anchor_ns=anchor_ns)
    facts: dict[str, Any] = {"encounters": options.encounters, "method": options.method, "load_before": os.getloadavg()[0]}
    with ExitStack() as stack:
        parts = stack.enter_context(Parts(out=out))
        ends = {name: f"tcp/127.0.0.1:{free_port()}" for name in (FEEDER, _SWARM)}
        mapper = ["mapper", "serve", "--store", store, "--port", "0", "--url-file", out / "url", "--method", options.method]
        mapper += [argument for end in ends.values() for argument in ("--connect", end)]
        tap = _start_swarm(parts, stack, end=ends[_SWARM])
        _say(f"measuring the gateway alone for {options.alone_seconds:g} s")
        time.sleep(_SETTLE_S)
        begun = time.monotonic()
        time.sleep(options.alone_seconds)
        facts["acknowledged_alone"] = _describe(tap.waits_between(begun, time.monotonic()), seconds=time.monotonic() - begun)
        _say("starting the mapper on a store without a map")
        facts["first_map_s"] = _start_mapper(parts, mapper)[0]
        feeder = ["--life", out / "life.npz", "--journal", out / "feeder.sqlite", "--listen", ends[FEEDER], "--anchor-ns", anchor_ns]
        feeder += ["--first", options.encounters, "--rate", options.rate, "--done-file", out / "done"]
        parts.start("feeder", "studies.live_feeder", *feeder)
        pid, url = parts.pids["mapper"], (out / "url").read_text().strip().rstrip("/")
        _say(f"publishing {options.rate:,.0f} encounters a second for {options.seconds:g} s")
        parts.wait(lambda: _get(url + _HEALTH)["counters"].get("new", 0) > options.rate, what="records of the feeder")
        begun, before = time.monotonic(), core_times(pid)
        with Watch(url, periods_s=_PERIODS_S) as watch:
            parts.wait((out / "done").exists, what="the feeder's end", timeout_s=4 * options.seconds + 60)
            seconds = time.monotonic() - begun
            serving_s, computing_s = (now - then for now, then in zip(core_times(pid), before, strict=True))
        facts["acknowledged_under_load"] = _describe(tap.waits_between(begun, begun + seconds), seconds=seconds)
        facts["behind_s"] = {"max": max(watch.behind_s), "p95": share(watch.behind_s, 0.95), "p50": share(watch.behind_s, 0.5)}
        facts["maps"] = {
            "n": len(watch.versions),
            "computing_p50_s": share(watch.computing_s, 0.5),
            "computing_max_s": max(watch.computing_s),
        }
        facts["core_s"] = {"serving_per_s": serving_s / seconds, "computing_per_map": computing_s / len(watch.versions)}
        facts["api"] = {path: _describe(waits, seconds=seconds) for path, waits in watch.latency_s.items()} | {"failed": watch.n_failed}
        facts["load_during"] = os.getloadavg()[0]
        facts["peak_memory_mb"] = {name: [round(peak / 2**20) for peak in peak_memory(one).values()] for name, one in parts.pids.items()}
        _say("restarting the mapper")
        parts.stop("simulator")
        parts.wait(lambda: _is_level(url), what="a map of everything")
        parts.stop("mapper")
        facts["restart_s"], facts["restart_version_kept"] = _start_mapper(parts, mapper)
        parts.stop("mapper", number=signal.SIGKILL)
        facts["restart_after_kill_s"], _ = _start_mapper(parts, mapper)
        parts.stop("mapper")
    facts["published"], facts["lost"] = _count_lost(store, [out / "feeder.sqlite", out / "gateway.sqlite"])
    return facts


def _start_swarm(parts: Parts, stack: ExitStack, *, end: str) -> LinkTap:
    """Start a simulated swarm behind a dongle, the tap on its line, and its gateway."""
    out = parts.out
    ready = out / "simulator.ready"
    parts.start(
        "simulator", "simulator", "serve", "--link", "tcp:127.0.0.1:0", "--scenario", "two-obstacles", "--preset", "paper-units",
        "--biobots", 150, "--speed", 4, "--duration", 100_000, "--seed", 2, "--ready-file", ready,
    )  # fmt: skip
    parts.wait(ready.exists, what="simulator ready")
    host, _, port = ready.read_text().strip().removeprefix("tcp:").rpartition(":")
    tap = stack.enter_context(LinkTap(host=host, port=int(port)))
    journal = out / "gateway.sqlite"
    parts.start("gateway", "gateway", "run", "--port", f"tcp:127.0.0.1:{tap.port}", "--journal", journal, "--listen", end, "--name", _SWARM)
    parts.wait(lambda: tap.waits, what="the gateway's first acknowledgement")
    return tap


def _start_mapper(parts: Parts, arguments: list[object]) -> tuple[float, int]:
    """Start the mapper; return how long its first map took to be served [s], and its version."""
    url_file = parts.out / "url"
    url_file.unlink(missing_ok=True)
    begun = time.monotonic()
    parts.start("mapper", *arguments)
    parts.wait(url_file.exists, what="mapper ready")
    url = url_file.read_text().strip().rstrip("/")
    parts.wait(lambda: _get(url + _MAP, default=None), what="first map")
    return time.monotonic() - begun, int(_get(url + _MAP)["version"])


def _is_level(url: str) -> bool:
    before = _get(url + _STATUS)
    time.sleep(1.0)
    after = _get(url + _STATUS)
    return bool(after["n_waiting"] == 0 and before["n_known"] == after["n_known"])


def _count_lost(path: Path, journals: Sequence[Path]) -> tuple[int, int]:
    """Count the records in journals, and the encounters there whose newest revision the store lacks."""
    newest: dict[RecordIdentity, int] = {}
    n_records = 0
    for journal in journals:
        with closing(JournalReader(journal)) as reader:
            first, records = 1, list[JournalRecord]()
            while first == 1 or records:
                records, _ = reader.read_records(from_offset=first, limit=_PAGE)
                for record in records:
                    if isinstance(record, EncounterRecord):
                        newest[record.identity] = max(record.revision, newest.get(record.identity, 0))
                n_records += len(records)
                first += _PAGE
    with closing(Store(path)) as store:
        after, has_more = 0, True
        while has_more:
            page = store.encounters(after=after, limit=_PAGE)
            after, has_more = page.cursor, page.has_more
            for record in page.records:
                if newest.get(record.identity) == record.revision:
                    del newest[record.identity]
    return n_records, len(newest)


def _get(url: str, *, default: Any = None) -> Any:
    try:
        with urllib.request.urlopen(url, timeout=60) as answer:
            return json.loads(answer.read())
    except urllib.error.HTTPError as error:
        if error.code == 503:
            return default
        raise


def _describe(waits: list[float], *, seconds: float) -> dict[str, float]:
    return {
        "per_s": len(waits) / seconds,
        "p50_ms": 1e3 * share(waits, 0.5),
        "p99_ms": 1e3 * share(waits, 0.99),
        "max_ms": 1e3 * max(waits, default=float("nan")),
    }


def _report(facts: dict[str, Any], options: argparse.Namespace) -> str:
    def row(name: str, one: dict[str, float]) -> str:
        return f"| {name} | {one['per_s']:.1f} | {one['p50_ms']:.1f} | {one['p99_ms']:.1f} | {one['max_ms']:.1f} |"

    behind, maps, memory = facts["behind_s"], facts["maps"], facts["peak_memory_mb"]
    api, core = facts["api"], facts["core_s"]
    lines = [
        f"# Live: {options.rate:,.0f} encounters/s into a store of {facts['encounters']:,}, method {facts['method']}",
        "",
        f"Load of the machine {facts['load_before']:.1f} before and {facts['load_during']:.1f} during, on {os.cpu_count()} cores.",
        "",
        f"- age of the served map: {behind['max']:.2f} s at most, p95 {behind['p95']:.2f} s, median {behind['p50']:.2f} s",
        f"- {maps['n']} maps; computing {maps['computing_p50_s']:.2f} s, at most {maps['computing_max_s']:.2f} s",
        f"- time of a core: {core['computing_per_map']:.2f} s for a map, {core['serving_per_s']:.2f} s a second for store, bus and API",
        f"- records lost: {facts['lost']} of {facts['published']:,}; API answers failed: {api['failed']}",
        f"- first map of a store without one {facts['first_map_s']:.2f} s after the process began; of one with {facts['restart_s']:.2f} s",
        f"- first map after SIGKILL {facts['restart_after_kill_s']:.2f} s after the process began",
        "- peak of memory [MB]: " + "; ".join(f"{name} {' + '.join(map(str, peaks))}" for name, peaks in memory.items()),
        "",
        "| | per s | p50 ms | p99 ms | max ms |",
        "|---|---|---|---|---|",
        row("gateway acknowledges, mapper and feeder off", facts["acknowledged_alone"]),
        row("gateway acknowledges, under load", facts["acknowledged_under_load"]),
        *(row(f"GET {path}", api[path]) for path in _PERIODS_S),
    ]
    return "\n".join(lines)


def _say(text: str) -> None:
    print(f"{time.strftime('%H:%M:%S')}  {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
