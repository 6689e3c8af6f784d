"""Three gateways, two routers, a mapper and a second site, cut and healed: ``python -m studies.sites`` (docs/sites.md)."""

import argparse
import asyncio
import json
import shutil
import signal
import sys
from dataclasses import asdict
from pathlib import Path

from studies.campaign.surroundings import enter_namespaces
from studies.errors import SitesError
from studies.sites.faults import all_faults
from studies.sites.run import Plan, run
from studies.sites.short import run_short
from studies.sites.table import write_table
from studies.sites.wires import find_problem


def main(arguments: list[str] | None = None) -> int:
    """Run the topology through its faults; 0 where nothing was lost, doubled, forged, overheard or told falsely, else 1."""
    parser = argparse.ArgumentParser(prog="python -m studies.sites", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("sites-out"), metavar="DIR", help="made anew (default: sites-out)")
    parser.add_argument("--speed", type=float, default=8.0, metavar="X", help="insects are so much faster than life (default: 8)")
    parser.add_argument("--calm-s", type=float, default=3.0, metavar="S", help="before each fault (default: 3)")
    parser.add_argument("--faults", type=int, default=len(all_faults()), metavar="N", help="only the first N")
    parser.add_argument("--short", action="store_true", help="the shortest of it: two routers, a gateway's bus, a mapper's store; seconds")
    options = parser.parse_args(arguments)
    enter_namespaces("studies.sites")
    if (problem := find_problem()) is not None:
        sys.stderr.write(f"sites: skipped: {problem}\n")
        return 0
    signal.signal(signal.SIGTERM, _leave)  # the first process of a namespace is not ended by it of itself
    out: Path = options.out
    if out.exists() and any(out.iterdir()):
        if not (out / "pki").is_dir():
            sys.stderr.write(f"sites: error: {out} is not empty, and not of an earlier run; give another --out\n")
            return 1
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    if options.short:
        return _run_short(out)
    plan = Plan(out=out.resolve(), faults=all_faults()[: options.faults], speed=options.speed, calm_s=options.calm_s)
    try:
        found = asyncio.run(run(plan))
    except SitesError as error:
        sys.stderr.write(f"sites: error: {error}\n")
        return 1
    (out / "facts.json").write_text(json.dumps(asdict(found), indent=1) + "\n", encoding="utf-8")
    table = write_table(found)
    (out / "table.md").write_text(table, encoding="utf-8")
    sys.stdout.write(table)
    return 1 if found.problems else 0


def _run_short(out: Path) -> int:
    try:
        facts = asyncio.run(run_short(out.resolve()))
    except SitesError as error:
        sys.stderr.write(f"sites: error: {error}\n")
        return 1
    sys.stdout.write(json.dumps(facts) + "\n")
    return 1 if facts["problems"] else 0


def _leave(number: int, _: object) -> None:
    raise SystemExit(128 + number)


if __name__ == "__main__":
    raise SystemExit(main())
