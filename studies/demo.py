"""The demo: insects walk, a gateway listens, a mapper draws, and at the end the map stands beside the truth.

``make demo`` runs it; ``python -m studies.demo --help`` tells the options. Three real processes, a pseudo-terminal and Zenoh.
"""

import argparse
import fcntl
import json
import shutil
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from studies.comparison import draw_comparison, fit_map
from studies.ledger import Ledger, check_ledger
from studies.scores import Scores, score_map
from studies.system import PartFailedError, RunningSystem, SystemSettings
from studies.truth import load_run

_PAGE = 1000
_BAR_WIDTH = 30


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; 0 where the map has the truth's Betti numbers and every encounter, 1 where not."""
    options = _parser().parse_args(arguments)
    out: Path = options.out
    # A polite kill ends the three processes as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    lock = _lock(out)
    if lock is None:
        print(f"error: another demo is running in {out}; choose another --out", file=sys.stderr)
        return 2
    if out.exists() and any(out.iterdir()):
        if not (out / "simulator.log").exists():
            print(f"error: {out} is not empty and not of an earlier demo; choose another --out", file=sys.stderr)
            return 2
        shutil.rmtree(out)
    settings = SystemSettings(
        out=out.resolve(), scenario=options.scenario, seed=options.seed, speed=options.speed, exploration_s=200 / options.speed,
        dispersion_s=max(20 / options.speed, 3.0), http_port=options.port, mapper_args=("--min-interval-s", "1"),
    )  # fmt: skip
    try:
        with RunningSystem(settings=settings) as system:
            return _run(system, keep_open=not options.exit)
    except PartFailedError as error:
        print(f"\nerror: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return 130


def _lock(out: Path) -> IO[bytes] | None:
    """Return the lock of a directory, held until it is closed; None where another demo has it."""
    out.parent.mkdir(parents=True, exist_ok=True)
    lock = out.with_name(f".{out.name}.lock").open("wb")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.close()
        return None
    return lock


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="make demo ARGS=...", description="Walking insects to a map, in three processes on this machine.")
    parser.add_argument("--exit", action="store_true", help="end when the map is made, instead of leaving the page open until Ctrl-C")
    parser.add_argument("--seed", type=int, default=1, help="same seed, same walks (default: 1)")
    parser.add_argument("--scenario", default="two-obstacles", help="see biobot-sim scenarios (default: two-obstacles)")
    parser.add_argument("--speed", type=float, default=4.0, metavar="X", help="insects are X times faster than life (default: 4)")
    parser.add_argument("--port", type=int, default=0, help="of the page (default: a free one)")
    parser.add_argument("--out", type=Path, default=Path("demo-out"), help="where truth, map, pictures and logs go (default: demo-out)")
    return parser


def _run(system: RunningSystem, *, keep_open: bool) -> int:
    settings = system.settings
    print(f"live page  {system.url}")
    print(f"to command sign in there with {system.token}")
    print(f"for others {_shown('biobot-mapper')} tokens add NAME --role operator --tokens {_relative(system.tokens)}")
    print(f"terminal   {_shown('biobot-gateway')} status --connect {system.bus_endpoint}")
    print(f"insects    {settings.n_biobots} in {settings.scenario}, {settings.speed:g} times faster than life, seed {settings.seed}")
    _follow(system)
    document, records = _settle(system)
    (settings.out / "map.json").write_text(json.dumps(document))
    for name in ("map.svg", "map.png"):
        (settings.out / name).write_bytes(system.download(f"/api/v1/{name}"))
    ledger = check_ledger(system.truth_directory, records)
    run = load_run(system.truth_directory)
    draw_comparison(fit_map(document, run), settings.out / "comparison.png", title=f"{settings.scenario}, seed {settings.seed}")
    is_right = _report(score_map(document, system.truth_directory), ledger, n_drawn=document["n_encounters"], out=settings.out)
    if keep_open:
        print("\nThe simulated insects have gone: the page shows their radio as down, and nobody obeys any more.")
        print(f"The page stays open: {system.url}   (Ctrl-C ends)")
        _wait_for_interrupt(system)
    return 0 if is_right else 1


def _shown(program: str) -> str:
    return str(_relative(Path(sys.executable).parent / program))


def _relative(path: Path) -> Path:
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _follow(system: RunningSystem) -> None:
    """Show phase and progress until the insects have stopped and everything they reported is acknowledged."""
    settings = system.settings
    total_s = settings.dispersion_s + settings.exploration_s
    started = time.monotonic()
    shown = ""
    for phase, n_encounters in _states(system):
        share = min((time.monotonic() - started) / total_s, 1.0)
        if sys.stdout.isatty():
            bar = "#" * round(_BAR_WIDTH * share)
            print(f"\r[{bar:.<{_BAR_WIDTH}}] {share:4.0%}  {phase:<20} {n_encounters:6} encounters ", end="", flush=True)
        elif phase != shown:
            print(f"{time.monotonic() - started:5.1f} s  {phase}", flush=True)
            shown = phase
    if sys.stdout.isatty():
        print()


def _states(system: RunningSystem) -> Iterator[tuple[str, int]]:
    simulator = system.process("simulator")
    while simulator.poll() is None:
        system.check_alive()
        mission = system.get("/api/v1/mission")
        phase = mission["phase"]["phase"] if mission.get("phase") else "starting"
        yield phase, int(system.get("/readyz").get("n_encounters", 0))
        time.sleep(0.5)
    system.check_alive()
    yield "done", int(system.get("/readyz").get("n_encounters", 0))


def _settle(system: RunningSystem) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Wait until the newest map is of every encounter in the store; return both."""

    def probe() -> tuple[dict[str, Any], list[dict[str, Any]]] | None:
        records = list(_all_encounters(system))
        document: dict[str, Any] = system.get("/api/v1/map")
        is_level = document["n_encounters"] + document["n_before"] == sum(not record["is_void"] for record in records)
        return (document, records) if is_level else None

    return system.wait_for(probe, what="a map of all encounters", timeout_s=60)


def _all_encounters(system: RunningSystem) -> Iterator[dict[str, Any]]:
    after: int | None = 0
    while after is not None:
        page = system.get(f"/api/v1/encounters?after={after}&limit={_PAGE}")
        yield from page["encounters"]
        after = page["next"]


def _report(scores: Scores, ledger: Ledger, *, n_drawn: int, out: Path) -> bool:
    found, real = scores.betti_numbers, scores.true_betti_numbers
    is_right = found == real and ledger.is_complete
    reports = f"{ledger.n_reports} reports, {len(ledger.missing)} missing, {len(ledger.doubled)} twice"
    exact = "" if scores.placement_error_of_exact is None else f" (of exact distances: {scores.placement_error_of_exact:.1%})"
    print(f"""
                      map     truth
components        {found[0]:7}   {real[0]:7}
holes             {found[1]:7}   {real[1]:7}   ({scores.n_obstacles_found} obstacles outlined, {scores.n_holes_false} false holes)
encounters        {ledger.n_records:7}   {ledger.n_encounters:7}   ({reports})
                  two meetings closer together than the clocks can tell are one record;
                  the map draws {n_drawn}: those since the landmarks stood

diagram           H1 is {scores.bottleneck_share[1]:.1%} of the diameter from the truth's (bottleneck distance)
picture           points are {scores.placement_error:.1%} of the side from their places (root mean square){exact}

pictures          {out / "comparison.png"} (map beside truth), {out / "map.svg"}, {out / "map.png"}
data              {out / "map.json"}, {out / "truth"}""")
    if not is_right:
        print("\nThe map does not agree with the truth this time." if ledger.is_complete else "\nEncounters are missing or doubled.")
    return is_right


def _wait_for_interrupt(system: RunningSystem) -> None:
    try:
        while True:
            system.check_alive()
            time.sleep(1)
    except KeyboardInterrupt:
        print()


if __name__ == "__main__":
    sys.exit(main())
