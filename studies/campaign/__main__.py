"""Let a whole site live through faults, and account for every encounter: ``python -m studies.campaign`` (docs/campaign.md)."""

import argparse
import asyncio
import json
import math
import signal
import sys
from pathlib import Path
from typing import Any

from studies.campaign.round import RoundPlan, describe_place, run_round
from studies.campaign.surroundings import enter_namespaces
from studies.campaign.table import is_sound, write_table
from studies.errors import CampaignError


def main(arguments: list[str] | None = None) -> int:
    """Run what is left of a campaign and print its table; return 0 where nothing was lost, doubled or altered, else 1."""
    options = _parse(arguments)
    enter_namespaces("studies.campaign")
    out: Path = options.out
    out.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, _leave)  # the first process of a namespace is not ended by it of itself
    failures: list[str] = []
    rounds: list[dict[str, Any]] = []
    try:
        rounds = _run_rounds(options, out)
    except* CampaignError as group:
        failures = [str(error) for error in group.exceptions]
    if failures:
        sys.stderr.write("".join(f"campaign: error: {failure}\n" for failure in failures))
        return 1
    table = write_table(rounds)
    head = f"Run in {describe_place()}; disks {', '.join(rounds[0]['disks']) or 'not of their own'}.\n\n"
    (out / "table.md").write_text(head + table, encoding="utf-8")
    sys.stdout.write(head + table)
    return 0 if is_sound(rounds) else 1


def _run_rounds(options: argparse.Namespace, out: Path) -> list[dict[str, Any]]:
    settings = {name: getattr(options, name) for name in ("encounters", "faults", "seed", "rate", "round", "mapper_down_half", "quick")}
    _check_same(out / "settings.json", settings)
    n_rounds = math.ceil(options.encounters / options.round)
    rounds = []
    for number in range(n_rounds):
        directory = out / f"round{number + 1}"
        facts = directory / "facts.json"
        if not facts.exists():
            plan = RoundPlan(
                seed=options.seed + number,
                n_encounters=math.ceil(options.encounters / n_rounds),
                n_faults=math.ceil(options.faults / n_rounds),
                rate=options.rate,
                is_mapper_down_half=options.mapper_down_half,
                is_quick=options.quick,
                directory=directory,
            )
            asyncio.run(run_round(plan))
        rounds.append(json.loads(facts.read_text(encoding="utf-8")))
    return rounds


def _leave(number: int, _: object) -> None:
    raise SystemExit(128 + number)


def _check_same(path: Path, settings: dict[str, Any]) -> None:
    """Note what a directory's campaign is, or refuse to go on with another one."""
    if path.exists() and (before := json.loads(path.read_text(encoding="utf-8"))) != settings:
        raise CampaignError(f"{path.parent} holds a campaign with {before}, not {settings}; give another --out, or remove it")
    path.write_text(json.dumps(settings) + "\n", encoding="utf-8")


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m studies.campaign", description=__doc__)
    parser.add_argument("--encounters", type=_count, default=1_000_000, metavar="N", help="at least so many (default: 1000000)")
    parser.add_argument("--faults", type=_count, default=1_000, metavar="N", help="(default: 1000)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="same seed, same meetings and same plan of faults (default: 1)")
    parser.add_argument("--rate", type=float, default=600.0, metavar="X", help="meetings that begin each second (default: 600)")
    parser.add_argument("--round", type=_count, default=250_000, metavar="N", help="so many encounters, then anew (default: 250000)")
    parser.add_argument("--mapper-down-half", action="store_true", help="the mapper is started when half of each round is over")
    parser.add_argument("--quick", action="store_true", help="short meetings and short faults, for a run of some seconds")
    parser.add_argument("--out", type=Path, default=Path("campaign-out"), metavar="DIR", help="rounds that are done stay done here")
    options = parser.parse_args(arguments)
    if not 1 <= options.rate <= 20_000:
        parser.error(f"--rate is {options.rate}; wanted 1 to 20000 meetings/s")
    if not 0 <= options.seed < 2**32:
        parser.error(f"--seed is {options.seed}; wanted 0 to 2^32 - 1")
    return options


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 10**9:
        raise argparse.ArgumentTypeError(f"{text} is out of range; wanted 1 to 1000000000")
    return value


if __name__ == "__main__":
    raise SystemExit(main())
