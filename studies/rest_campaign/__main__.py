"""Hold the OpenAPI document against the service: ``python -m studies.rest_campaign`` (docs/rest-campaign.md)."""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from studies.rest_campaign.campaign import run_campaign
from studies.rest_campaign.site import lonely_mapper, running_site
from studies.rest_campaign.tally import write_report
from studies.system import PartFailedError

_WALK_S = 3600.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a campaign and print its report; 0 where no rule was broken, 1 where one was."""
    options = _parser().parse_args(arguments)
    with tempfile.TemporaryDirectory() as scratch:
        directory: Path = options.out or Path(scratch)
        try:
            site = (
                lonely_mapper(directory)
                if options.lonely
                else running_site(directory, seed=options.seed, duration_s=_WALK_S, n_biobots=options.biobots)
            )
            with site as target:
                began_s = time.monotonic()
                tally = run_campaign(target, n_cases=options.cases, seed_number=options.seed, tell=_tell)
        except PartFailedError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    facts = {
        "seed": options.seed,
        "site": "a mapper alone" if options.lonely else f"{options.biobots} simulated insects, a gateway, a mapper",
        "schemathesis": version("schemathesis"),
        "took": f"{time.monotonic() - began_s:.0f} s",
    }
    print(write_report(tally, facts))
    return 1 if tally.failures else 0


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="make rest-campaign ARGS=...", description="Generated requests to every operation of a mapper's API."
    )
    parser.add_argument("--cases", type=int, default=20_000, metavar="N", help="how many requests (default: 20000)")
    parser.add_argument("--seed", type=int, default=1, help="same seed, same requests but for what the site knows (default: 1)")
    parser.add_argument("--biobots", type=int, default=40, metavar="N", help="insects that walk (default: 40)")
    parser.add_argument("--lonely", action="store_true", help="a mapper without gateway, insects and map")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep logs and store there; an empty directory (default: nowhere)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
