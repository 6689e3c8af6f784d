"""What all experiments share: their flags, where their results go, and how long they are."""

import argparse
import csv
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from studies.cases import Options
from studies.cases.flags import add_flags, read_flags
from studies.errors import StudyError
from studies.paper.drawing import save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ValueT = TypeVar("ValueT")

FINAL_SEED = 200_000
"""Nothing was trained, chosen or tried on seeds from here on."""

_DIGITS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """How an experiment is run.

    Parameters
    ----------
    out
        Folder of figures as PNG, and of summaries.
    work
        Folder of journals, of figures as SVG, and of tables with a row a run.
    is_quick
        A few short runs, to see that it works: the figures mean nothing.
    first_seed
        Seeds of runs that are reported count from here.
    cases
        How cases are run; the journal is ``work``'s.
    """

    out: Path
    work: Path
    is_quick: bool
    first_seed: int
    cases: Options

    def pick(self, full: ValueT, quick: ValueT) -> ValueT:
        """Return one of two values, for whole and for quick runs."""
        return quick if self.is_quick else full

    def options(self, name: str) -> Options:
        """Return how the cases of one study are run, with the study's own journal."""
        return replace(self.cases, journal=self.work / f"{name}.jsonl")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of an experiment.

    Parameters
    ----------
    summary
        Values that JSON can hold; the report's tables are made of them.
    rows
        A row a run, or the like, all with the same keys.
    figures
        By the end of the file name, which begins with that of the experiment; empty for the only one.
    """

    summary: Mapping[str, object]
    rows: Sequence[Mapping[str, object]]
    figures: Mapping[str, "Figure"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """One experiment: ``run`` computes it, as ``python -m studies.paper.NAME`` does."""

    name: str
    about: str
    run: Callable[[Setting], Outcome]


def perform(experiment: Experiment, setting: Setting) -> None:
    """Run an experiment and write its figures, its summary and its table of runs.

    Raises
    ------
    StudyError
        A run failed, or the runs cannot be computed as asked.
    OSError
        The results cannot be written.
    """
    outcome = experiment.run(setting)
    setting.out.mkdir(parents=True, exist_ok=True)
    setting.work.mkdir(parents=True, exist_ok=True)
    about = {"experiment": experiment.name, "is_quick": setting.is_quick, "first_seed": setting.first_seed, "runs": len(outcome.rows)}
    document = json.dumps(_rounded({**about, **outcome.summary}), indent=1, allow_nan=False)
    (setting.out / f"{experiment.name}.json").write_text(document + "\n", encoding="utf-8")
    with (setting.work / f"{experiment.name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(outcome.rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(outcome.rows)
    for end, figure in outcome.figures.items():
        stem = "-".join(filter(None, [experiment.name, end]))
        save_figure(figure, svg=setting.work / f"{stem}.svg", png=setting.out / f"{stem}.png")


def perform_main(experiments: Sequence[Experiment], arguments: Sequence[str] | None, *, prog: str, about: str) -> int:
    """Read the flags and run experiments; return the exit status: 0 done, 1 failed."""
    setting = read_setting(arguments, prog=prog, about=about)
    try:
        for experiment in experiments:
            print(f"{experiment.name}: {experiment.about}", file=sys.stderr)
            perform(experiment, setting)
    except (StudyError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def read_setting(arguments: Sequence[str] | None, *, prog: str, about: str) -> Setting:
    """Read the flags of a command of experiments."""
    parser = argparse.ArgumentParser(prog=prog, description=about)
    parser.add_argument("--quick", action="store_true", help="a few short runs, to see that it works: the figures mean nothing")
    parser.add_argument("--out", type=Path, metavar="DIR", help="PNG and summaries (default: docs/paper; artifacts/paper-quick)")
    parser.add_argument(
        "--work", type=Path, metavar="DIR", help="journals, SVG and tables (default: artifacts/paper; artifacts/paper-quick)"
    )
    parser.add_argument("--first-seed", type=int, default=FINAL_SEED, metavar="N", help="of the runs reported (default: %(default)s)")
    add_flags(parser)
    parsed = parser.parse_args(arguments)
    if parsed.first_seed < 0:
        parser.error(f"--first-seed is {parsed.first_seed}; wanted a whole number from 0 on")
    quick = Path("artifacts/paper-quick")
    return Setting(
        out=parsed.out or (quick if parsed.quick else Path("docs/paper")),
        work=parsed.work or (quick if parsed.quick else Path("artifacts/paper")),
        is_quick=parsed.quick,
        first_seed=parsed.first_seed,
        cases=read_flags(parsed, journal=None),
    )


def _rounded(value: object) -> object:
    """Round floats to six digits: enough to compare, and short."""
    match value:
        case float():
            return float(f"{value:.{_DIGITS}g}")
        case Mapping():
            return {str(key): _rounded(one) for key, one in value.items()}
        case list() | tuple():
            return [_rounded(one) for one in value]
        case _:
            return value
