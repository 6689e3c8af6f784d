"""Install, upgrade, break and remove the services for real, and say what was seen; ``make install-check``."""

import argparse
import json
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from scripts.containers.podman import CheckFailedError, Podman, missing
from scripts.installed import checks
from scripts.installed.bundle import BROUGHT, live_from_bundle
from scripts.installed.machine import WITH_COMPILER, WITH_PYTHON, Machine, fetch_wheels

_ROOT = Path(__file__).parents[2]
_UNUSED = ("podman-compose",)
"""What building and running compose files needs and this does not."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Do it; 0 all is as it should be, or skipped with --skip; 1 something is not; 2 something is missing here."""
    options = _parser().parse_args(arguments)
    if problems := [problem for problem in missing() if not problem.startswith(_UNUSED)]:
        print("a machine with systemd cannot be made here:", *(f"  {problem}" for problem in problems), sep="\n", file=sys.stderr)
        if options.skip:
            print("skipped: make install-check")
            return 0
        return 2
    if options.bundle is not None and not options.bundle.is_file():
        print(f"error: there is no {options.bundle}; make bundle makes it", file=sys.stderr)
        return 2
    home: Path = options.home.resolve()
    podman = Podman(home)
    result = home / ("result.json" if options.bundle is None else "result-bundle.json")
    seen: list[str] = []
    started = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - started:6.0f} s  {text}", flush=True)
        seen.append(text)

    try:
        if options.bundle is not None:
            _live_from_bundle(podman, say, options.bundle, suite=options.suite)
        else:
            _live(podman, say, suite=options.suite, is_short=options.short)
    except (CheckFailedError, subprocess.SubprocessError) as error:
        print(f"failed: {error}; the machine's journal is {home / 'journal.log'}", file=sys.stderr)
        return 1
    finally:
        facts = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "suite": options.suite, "machine": platform.machine(), "seen": seen}
        result.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    print(f"all as it should be; {result}")
    return 0


def _live(podman: Podman, say: checks.Say, *, suite: str, is_short: bool) -> None:
    """Live through a station's life; a short one is installed and removed."""
    machine = Machine(podman, WITH_COMPILER, suite=suite, brings={"/wheels": podman.home / "wheels", "/src": _ROOT})
    fetch_wheels(podman, source=_ROOT)
    with machine:
        _say_what_runs(machine, say, suite)
        checks.make_simulator(machine, "1.0.0")
        before = machine.files()
        checks.check_refusals(machine, say)
        checks.start_insects(machine)
        checks.check_installation(machine, say, "1.0.0")
        checks.check_units(machine, say)
        if not is_short:
            checks.check_upgrade(machine, say, "1.1.0", "1.0.0")
            checks.check_broken_upgrades(machine, say, "1.1.0")
            checks.check_boot(machine, say)
            checks.check_obstacles(machine, say)
            checks.check_watchdogs(machine, say)
        checks.check_removal(machine, say, before)
        checks.check_image(machine, say)


def _live_from_bundle(podman: Podman, say: checks.Say, archive: Path, *, suite: str) -> None:
    with Machine(podman, WITH_PYTHON, suite=suite, brings={BROUGHT: archive.resolve().parent}) as machine:
        _say_what_runs(machine, say, suite)
        live_from_bundle(machine, say, archive)


def _say_what_runs(machine: Machine, say: checks.Say, suite: str) -> None:
    say(f"Debian {suite} runs, with {machine.run('systemctl --version').splitlines()[0]}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="make install-check ARGS=...", description=(__doc__ or "").partition(";")[0] + ".")
    parser.add_argument("--suite", default="bookworm", help="release of Debian (default: bookworm)")
    parser.add_argument(
        "--bundle", type=Path, metavar="ARCHIVE", help="live through docs/bundle.md instead, on a machine with Python alone"
    )
    parser.add_argument("--short", action="store_true", help="install and remove alone: no upgrade, no watchdog, no loss of power")
    parser.add_argument("--skip", action="store_true", help="where something is missing, say what and count as done")
    parser.add_argument("--home", type=Path, default=Path("artifacts/install-check"), help="store, wheels, logs and result")
    return parser


if __name__ == "__main__":
    sys.exit(main())
