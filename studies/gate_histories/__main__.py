"""Try the stimulation gate in random histories: ``python -m studies.gate_histories --histories 100000`` (docs/gate-histories.md)."""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from studies.cases import run_cases
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.gate_histories.campaign import STUDY, Batch

_A_BATCH = 250


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; 0: no law was broken, 1: one was, 2: bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.gate_histories", description=__doc__)
    parser.add_argument(
        "--histories", type=int, default=100_000, metavar="N", help="how many, rounded up to batches (default: %(default)s)"
    )
    parser.add_argument("--first", type=int, default=0, metavar="BATCH", help="number of the first batch (default: %(default)s)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="journal of what is done: the same command goes on from there")
    add_flags(parser)
    parsed = parser.parse_args(arguments)
    if parsed.histories < 1:
        parser.error(f"--histories {parsed.histories}; wanted 1 or more")
    n_batches = -(-parsed.histories // _A_BATCH)
    batches = [Batch(number=parsed.first + at, n_histories=_A_BATCH) for at in range(n_batches)]
    try:
        done = run_cases(STUDY, batches, read_flags(parsed, journal=parsed.out), label="batches")
    except StudyError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    counts: Counter[str] = Counter()
    broken = []
    for one in done:
        if one.result is None:
            broken.append(f"batch {one.case.number}: {one.failure}")
            continue
        counts.update(one.result.counts)
        if one.result.broken:
            broken.append(f"batch {one.case.number}:\n{one.result.broken}")
    for name in sorted(counts):
        print(f"| {name} | {counts[name]:,} |")
    print(f"| histories that broke a law | {len(broken)} |")
    print("\n\n".join(broken))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
