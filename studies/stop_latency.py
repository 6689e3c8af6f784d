"""How soon a stop's frame has left for the dongle: ``python -m studies.stop_latency`` (docs/stop.md).

A real gateway and a real mapper, eight dongles on lines of 115,200 baud (``line_load``) that bring 1,000 encounters a second and are slow
to send, so that something always waits to go down; then the same with the journal's disk full. Stops are asked for over Zenoh and over
REST, one biobot at a time, and for all at once. Counted is from the request to the frame's last octet having left at the line's speed; a
stop of all counts once for each radio. Many stops come right behind a start of the same biobot, and no stimulus may leave after its stop.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from firmware_protocol.contract.commands import StimulationAction
from mapper.access import Role, add_token
from studies.bench_gateway import Part
from studies.ports import free_port
from studies.stop_asking import RestAsker, ZenohAsker
from studies.stop_frames import Stop, StopFrames
from studies.stop_report import report
from studies.system import PartFailedError

LINES: Final = ("native/pty", "native/tcp", "xbee/pty", "xbee/tcp", "znp/pty", "znp/tcp", "can/tcp", "canfd/tcp")
_BIOBOTS: Final = 256
_PATIENCE_S: Final = 5.0
_LONGEST_PAUSE_S: Final = 0.08
_SHARE_STARTED: Final = 0.4
"""Of the stops, those that come right behind a start of the same biobot."""
_DISK: Final = "size=300m"
_FULL_S: Final = 3.0
"""After so long with a full disk the gateway has met it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and report; 0 where every stop left and nothing left after it."""
    parser = argparse.ArgumentParser(prog="python -m studies.stop_latency", description=__doc__)
    parser.add_argument("--stops", type=int, default=200, help="of each way (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=1000, help="encounters a second (default: %(default)g)")
    parser.add_argument("--air-ms", type=float, default=8.0, help="that a payload takes on the air (default: %(default)g)")
    parser.add_argument("--warm-up", type=float, default=10.0, help="seconds of load before the first stop (default: %(default)g)")
    parser.add_argument("--ways", nargs="+", choices=("zenoh", "rest", "all"), default=["zenoh", "rest", "all"])
    parser.add_argument("--no-full-disk", action="store_true", help="leave out the part that mounts and fills a disk (it needs root)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="made anew: keep files and logs here (default: a directory that is removed)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every stop there too")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that all that was started ends, and the disk is given back
    with ExitStack() as stack:
        out = options.out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="stop-latency-", dir=Path.cwd())))
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        try:
            stops, frames = _measure(options, out.resolve())
        except PartFailedError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    text, is_good = report(stops, frames)
    print(text)
    if options.json is not None:
        options.json.write_text(json.dumps([stop.facts() for stop in stops], indent=1) + "\n")
    return 0 if is_good else 1


def _measure(options: argparse.Namespace, out: Path) -> tuple[list[Stop], StopFrames]:
    endpoint, url_file, chance = f"tcp/127.0.0.1:{free_port()}", out / "mapper.url", random.Random(options.seed)
    stops: list[Stop] = []
    with ExitStack() as stack:
        disk = stack.enter_context(_small_disk(out / "disk", is_wanted=not options.no_full_disk))
        load = ["studies.line_load", str(out), "--encounters", "1e9", "--rate", str(options.rate), "--entries", "1", "--sides", "1"]
        load += ["--biobots", str(_BIOBOTS), "--lines", *LINES, "--baud", "115200", "--air-ms", str(options.air_ms)]
        swarm = stack.enter_context(Part(name="load", arguments=load, log=out / "load.log"))
        ports = swarm.hear()["ports"]
        run = ["gateway", "run", "--journal", str((disk or out) / "journal.sqlite"), "--listen", endpoint]
        run += [argument for port in ports for argument in ("--port", port)]
        stack.enter_context(Part(name="gateway", arguments=run, log=out / "gateway.log"))
        serve = [
            "mapper",
            "serve",
            "--connect",
            endpoint,
            "--store",
            str(out / "mapper.sqlite"),
            "--port",
            "0",
            "--url-file",
            str(url_file),
            "--tokens",
            str(out / "tokens.json"),
        ]
        token = add_token(out / "tokens.json", name="bench", role=Role.OPERATOR).text
        stack.enter_context(Part(name="mapper", arguments=serve, log=out / "mapper.log"))
        swarm.hear()
        _wait(url_file.exists, what="the mapper", log=out / "mapper.log")
        frames = stack.enter_context(StopFrames(swarm, lines=[f"{line} {port}" for line, port in zip(LINES, ports, strict=True)]))
        zenoh = stack.enter_context(ZenohAsker(endpoint))
        rest = RestAsker(url_file.read_text().strip(), token=token)
        swarm.tell("go")
        _say(f"load for {options.warm_up:g} s, load average {os.getloadavg()[0]:.1f}")
        time.sleep(options.warm_up)
        for is_full in (False, True) if disk is not None else (False,):
            if is_full and disk is not None:
                _fill(disk)
                time.sleep(_FULL_S)
            for way in options.ways:
                _say(f"{options.stops} stops by {way}{', disk full' if is_full else ''}, load average {os.getloadavg()[0]:.1f}")
                for _ in range(options.stops):
                    stops.append(_stop_once(way, zenoh=zenoh, rest=rest, frames=frames, chance=chance, is_full=is_full))
                    time.sleep(chance.uniform(0.0, _LONGEST_PAUSE_S))
        time.sleep(1.0)  # what must not leave has had its time to
    return stops, frames


def _stop_once(way: str, *, zenoh: ZenohAsker, rest: RestAsker, frames: StopFrames, chance: random.Random, is_full: bool) -> Stop:
    node = chance.randrange(1, _BIOBOTS + 1)
    if not is_full and chance.random() < _SHARE_STARTED:
        frames.note_start(node, time.monotonic_ns())
        zenoh.ask(node, StimulationAction.START)
        time.sleep(chance.uniform(0.0, 0.03))
    asked = {"zenoh": zenoh.ask, "rest": rest.ask, "all": zenoh.ask}[way]
    asked_ns = time.monotonic_ns()
    stop = Stop(way=way, is_full=is_full, node=node, asked_ns=asked_ns)
    frames.expect(stop, n=len(LINES) if way == "all" else 1)
    stop.answered = asked(node, StimulationAction.STOP_ALL if way == "all" else StimulationAction.STOP)
    frames.wait_for(stop, patience_s=_PATIENCE_S)
    return stop


@contextlib.contextmanager
def _small_disk(place: Path, *, is_wanted: bool) -> Iterator[Path | None]:
    """A file system of its own, in memory; None where it is not wanted or cannot be had."""
    mount, umount = shutil.which("mount"), shutil.which("umount")
    place.mkdir(exist_ok=True)
    if not is_wanted or mount is None or umount is None or os.geteuid() != 0:
        yield None
        return
    done = subprocess.run([mount, "-t", "tmpfs", "-o", _DISK, "tmpfs", str(place)], capture_output=True, text=True, check=False)
    if done.returncode:
        _say(f"no full disk: {done.stderr.strip()}")
        yield None
        return
    try:
        yield place
    finally:
        subprocess.run([umount, "--lazy", str(place)], check=False)


def _fill(place: Path) -> None:
    """Leave no room on a file system."""
    with contextlib.suppress(OSError), (place / "filler").open("wb", buffering=0) as filler:
        while True:
            filler.write(bytes(1 << 20))
    with contextlib.suppress(OSError), (place / "last").open("wb", buffering=0) as filler:
        while True:
            filler.write(bytes(512))


def _wait(is_there: Any, *, what: str, log: Path) -> None:
    until = time.monotonic() + 60
    while not is_there():
        if time.monotonic() > until:
            raise PartFailedError(f"{what} is not there after a minute; see {log}")
        time.sleep(0.1)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
