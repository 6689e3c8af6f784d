"""How fast the mapper's REST is: ``python -m studies.rest_speed``.

First, with nothing else to do, ``GET /api/v1/map`` from the cache beside a bare Starlette route that returns the same bytes, served in the
same way, in turns on the same machine: answers a second, and the time of a core that each costs; and the same where the client has the map
already (304), and compressed. Then the latency of that request while encounters arrive and maps are made. All the while, or for longer,
event streams are held open. The mapper, the bare server, the feeder and this client are processes of their own.
"""

import argparse
import asyncio
import json
import os
import shutil
import sys
import time
import urllib.request
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final

from studies.bare_server import PATH
from studies.live_feeder import NAME as FEEDER
from studies.live_life import Life, fill_store
from studies.live_watch import core_times, peak_memory, share
from studies.parts import Parts
from studies.ports import free_port
from studies.rest_client import Ask, ask_for, streams_held
from studies.system import PartFailedError

_STATUS: Final = "/api/v1/map/status"
_EVENTS: Final = "/api/v1/events"
_BARE, _OURS, _KNOWN, _PACKED = "bare Starlette", "GET /api/v1/map", "304", "gzip"
_SETTLE_S: Final = 2.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and report; 0 where every limit is kept, 1 where one is not."""
    parser = argparse.ArgumentParser(prog="python -m studies.rest_speed", description=__doc__)
    parser.add_argument("--encounters", type=int, default=100_000, help="in the store at the start (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=12, help="of a slice of time for each (default: %(default)s)")
    parser.add_argument("--slice-s", type=float, default=1.0, help="(default: %(default)s)")
    parser.add_argument("--connections", type=int, default=8, help="(default: %(default)s)")
    parser.add_argument("--rate", type=float, default=1_000, help="encounters a second while latency is measured (default: %(default)s)")
    parser.add_argument("--minutes", type=float, default=1.0, help="that is, and event streams are held (default: %(default)s)")
    parser.add_argument("--streams", type=int, default=200, help="event streams (default: %(default)s)")
    parser.add_argument("--least-share", type=float, default=0.7, help="of the bare route's answers a second (default: %(default)s)")
    parser.add_argument("--most-ms", type=float, default=50.0, help="p99 of the latency (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("rest-speed-out"), help="made anew; logs stay there (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there too")
    options = parser.parse_args(arguments)
    out: Path = options.out.resolve()
    if out.exists() and any(out.iterdir()) and not (out / "life.npz").exists():
        print(f"error: {out} is not empty and not of an earlier run; choose another --out", file=sys.stderr)
        return 2
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    try:
        facts = asyncio.run(_measure(options, out))
    except PartFailedError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.json is not None:
        options.json.write_text(json.dumps(facts, indent=1) + "\n")
    print(_report(facts))
    return 0 if _is_good(facts, options) else 1


async def _measure(options: argparse.Namespace, out: Path) -> dict[str, Any]:
    n_more = round(options.rate * (60 * options.minutes + 30))
    _say(f"simulating {options.encounters + n_more:,} encounters")
    life = Life.simulate(options.encounters + n_more, seed=1)
    life.save(out / "life.npz")
    anchor_ns = time.time_ns() - int(life.t_end_ns[-1])
    fill_store(out / "mapper.sqlite", life, n_encounters=options.encounters, anchor_ns=anchor_ns)
    end = f"tcp/127.0.0.1:{free_port()}"
    facts: dict[str, Any] = {"cpus": os.cpu_count(), "load_before": os.getloadavg()[0]}
    with Parts(out=out) as parts:
        _say("starting the mapper")
        parts.start(
            "mapper", "mapper", "serve", "--store", out / "mapper.sqlite", "--port", 0, "--url-file", out / "url", "--connect", end,
            "--tokens", out / "tokens.json",
        )  # fmt: skip
        parts.wait((out / "url").exists, what="mapper ready")
        url = (out / "url").read_text().strip().rstrip("/")
        parts.wait(lambda: _status(url)["version"] is not None and not _status(url)["is_computing"], what="first map")
        body, etag = _get(url + PATH)
        (out / "map.json").write_bytes(body)
        facts["map_bytes"] = len(body)
        parts.start("bare", "studies.bare_server", "--body", out / "map.json", "--url-file", out / "bare-url")
        parts.wait((out / "bare-url").exists, what="bare server ready")
        bare = (out / "bare-url").read_text().strip()
        asks = [
            Ask(name=_BARE, url=bare, path=PATH),
            Ask(name=_OURS, url=url, path=PATH),
            Ask(name=_KNOWN, url=url, path=PATH, headers=(("If-None-Match", etag),)),
            Ask(name=_PACKED, url=url, path=PATH, headers=(("Accept-Encoding", "gzip"),)),
        ]
        _say(f"asking in turns, {options.rounds} rounds")
        facts["turns"] = await _take_turns(asks, parts, options)
        parts.stop("bare")
        _say(f"{options.rate:g} encounters a second, {options.streams} event streams, {options.minutes:g} minutes")
        feeder = ["--life", out / "life.npz", "--journal", out / "feeder.sqlite", "--listen", end, "--anchor-ns", anchor_ns]
        feeder += ["--first", options.encounters, "--rate", options.rate, "--done-file", out / "done"]
        parts.start(FEEDER, "studies.live_feeder", *feeder)
        n_before = _status(url)["n_known"]
        await asyncio.to_thread(parts.wait, lambda: _status(url)["n_known"] > n_before, what="records of the feeder")
        facts["busy"] = await _watch_busy(url, parts, options)
    return facts


async def _take_turns(asks: Sequence[Ask], parts: Parts, options: argparse.Namespace) -> dict[str, Any]:
    """Measure each in every round, in a turning order, and compare it with the bare route of the same round."""
    rounds: list[dict[str, tuple[float, float]]] = []
    pids = {ask.name: parts.pids["bare" if ask.name == _BARE else "mapper"] for ask in asks}
    for number in range(-1, options.rounds):
        found: dict[str, tuple[float, float]] = {}
        for ask in (*asks[number % len(asks) :], *asks[: number % len(asks)]):
            before = core_times(pids[ask.name])[0]
            taken = await ask_for(ask, seconds=options.slice_s, n_connections=options.connections)
            found[ask.name] = taken.per_s, 1e6 * (core_times(pids[ask.name])[0] - before) / len(taken.waits_s)
            wanted = 304 if ask.name == _KNOWN else 200
            if set(taken.statuses) != {wanted}:
                raise PartFailedError(f"{ask.name}: answers {taken.statuses}, wanted {wanted} alone")
        if number >= 0:  # the first one warms up
            rounds.append(found)
    return {
        ask.name: {
            "per_s": median(one[ask.name][0] for one in rounds),
            "core_us": median(one[ask.name][1] for one in rounds),
            "share": median(one[ask.name][0] / one[_BARE][0] for one in rounds),
        }
        for ask in asks
    }


async def _watch_busy(url: str, parts: Parts, options: argparse.Namespace) -> dict[str, Any]:
    """Hold event streams, and ask for the map now and then, while encounters arrive and maps are made."""
    before, known = _status(url), peak_memory(parts.pids["mapper"])
    events = Ask(name="events", url=url, path=_EVENTS)
    asked = Ask(name=_OURS, url=url, path=PATH)
    begun = time.monotonic()
    async with streams_held(events, n_streams=options.streams) as streams:
        await asyncio.sleep(_SETTLE_S)
        n_before = streams.n_messages
        taken = await ask_for(asked, seconds=60 * options.minutes, n_connections=2, period_s=0.1)
        held = {"open": streams.n_open, "lost": streams.n_lost, "messages_each": (streams.n_messages - n_before) / options.streams}
    after = _status(url)
    return {
        "per_s": taken.per_s,
        **{f"p{name}_ms": 1e3 * share(taken.waits_s, q) for name, q in (("50", 0.5), ("99", 0.99), ("99.9", 0.999))},
        "max_ms": 1e3 * max(taken.waits_s),
        "statuses": taken.statuses,
        "maps": after["version"] - before["version"],
        "encounters_per_s": (after["n_known"] - before["n_known"]) / (time.monotonic() - begun),
        "streams": held,
        "memory_mb": {"before": sum(known.values()) / 2**20, "after": sum(peak_memory(parts.pids["mapper"]).values()) / 2**20},
        "load": os.getloadavg()[0],
    }


def _status(url: str) -> Any:
    with urllib.request.urlopen(url + _STATUS, timeout=60) as answer:
        return json.loads(answer.read())


def _get(url: str) -> tuple[bytes, str]:
    with urllib.request.urlopen(url, timeout=60) as answer:
        return answer.read(), str(answer.headers["ETag"])


def _is_good(facts: dict[str, Any], options: argparse.Namespace) -> bool:
    turns, busy = facts["turns"], facts["busy"]
    is_fast = turns[_OURS]["share"] >= options.least_share and turns[_KNOWN]["per_s"] > turns[_OURS]["per_s"]
    return is_fast and busy["p99_ms"] <= options.most_ms and not busy["streams"]["lost"] and set(busy["statuses"]) == {200}


def _report(facts: dict[str, Any]) -> str:
    busy = facts["busy"]
    streams, memory = busy["streams"], busy["memory_mb"]
    latency = ", ".join(f"{name} {busy[f'{name}_ms']:.1f} ms" for name in ("p50", "p99", "max"))
    loads = f"load {facts['load_before']:.1f} before, {busy['load']:.1f} at the end"
    under_way = f"{busy['encounters_per_s']:,.0f} encounters/s arrived and {busy['maps']} maps were made"
    held = f"{streams['open']} open, {streams['lost']} lost, {streams['messages_each']:.0f} messages each"
    lines = [
        f"{facts['cpus']} cores, {loads}; map of {facts['map_bytes']:,} bytes",
        "",
        "| | per s | core us each | share of bare |",
        "|---|---|---|---|",
        *(f"| {name} | {one['per_s']:,.0f} | {one['core_us']:.0f} | {one['share']:.0%} |" for name, one in facts["turns"].items()),
        "",
        f"while {under_way}: {latency}, {busy['per_s']:.0f} per s",
        f"event streams: {held}; memory {memory['before']:.0f} -> {memory['after']:.0f} MB",
    ]
    return "\n".join(lines)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
