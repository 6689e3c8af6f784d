"""Simulate and map runs over a grid of parameters, and tell how often each cell counts the holes right. See docs/studies.md."""

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from studies.cases import PackageFile, Study, run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.sweep.definition import load_sweep
from studies.sweep.map_case import CaseResult, compute_case
from studies.sweep.report import account_for, table, tell_failures, to_csv, to_json

JOURNALS = Path("artifacts/sweeps")

STUDY = Study(
    name="sweep",
    compute=compute_case,
    result_type=CaseResult,
    files=(PackageFile(package="mapper", path="data/classifier.json"),),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sweep: 0 done, 1 where a case failed or the sweep could not go on, 2 for bad usage or definition."""
    parser = argparse.ArgumentParser(prog="python -m studies.sweep", description=__doc__)
    parser.add_argument("--version", action="version", version=version("biobot-gateway"))
    parser.add_argument("definition", type=Path, metavar="SWEEP.toml", help="what to sweep over")
    parser.add_argument("--journal", type=Path, metavar="FILE", help=f"what is done (default: {JOURNALS}/NAME.jsonl)")
    parser.add_argument("--repeats", type=int, metavar="N", help="runs of each cell, instead of the definition's")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the account as JSON")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the account as CSV")
    parser.add_argument("--check-config", action="store_true", help="check the definition, say how many cases it has, and stop")
    add_flags(parser)
    options = parser.parse_args(arguments)
    try:
        sweep = load_sweep(options.definition, flags={"repeats": options.repeats})
    except ConfigurationError as error:
        for problem in error.problems:
            print(f"error: {problem}", file=sys.stderr)
        return 2
    cases = sweep.cases()
    if options.check_config:
        print(f"{sweep.name}: {len(sweep.cells)} cells, {len(cases)} cases, seeds {sweep.seeds.start} to {sweep.seeds.stop - 1}")
        return 0
    journal = options.journal or JOURNALS / f"{sweep.name}.jsonl"
    try:
        finished = run_cases(STUDY, cases, read_flags(options, journal=journal), label=sweep.name)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"stopped; what is done is in {journal}: give the same command again to go on", file=sys.stderr)
        return 130
    accounts = account_for(sweep, finished)
    print(table(accounts))
    try:
        for path, text in ((options.json, to_json(sweep, accounts)), (options.csv, to_csv(accounts))):
            if path is not None:
                path.write_text(text, encoding="utf-8")
    except OSError as error:
        print(f"error: {error.filename}: cannot be written: {error.strerror}; the journal {journal} has all results", file=sys.stderr)
        return 1
    failures = tell_failures(finished)
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
