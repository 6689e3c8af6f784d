"""Run all experiments of [Dir16] and write the tables of docs/paper.md: ``make paper``."""

import sys
from collections.abc import Sequence

from studies.paper import bounds, classifier, convergence, distances, scenarios, subsampling, units
from studies.paper.experiment import perform_main

EXPERIMENTS = (
    units.EXPERIMENT,
    scenarios.EXPERIMENT,
    subsampling.EXPERIMENT,
    classifier.EXPERIMENT,
    distances.EXPERIMENT,
    convergence.EXPERIMENT,
    bounds.EXPERIMENT,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all; return the exit status."""
    return perform_main(EXPERIMENTS, arguments, prog="python -m studies.paper", about="All experiments of [Dir16]; resumable.")


if __name__ == "__main__":
    sys.exit(main())
