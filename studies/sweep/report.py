"""The account of a sweep: a line for each cell, as a table, JSON or CSV."""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import sqrt

import numpy as np

from studies.cases import Finished
from studies.sweep.case import Cell, SweepCase, Value
from studies.sweep.definition import Sweep
from studies.sweep.map_case import CaseResult

_Z = 1.959964  # deviations of a normal distribution to either side, with 19 in 20 between


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """What the cases of one cell gave. Where none finished, shares, errors and times are None.

    Parameters
    ----------
    cases, failed
        In all, and those that raised; all below is of the others.
    no_map
        Those in which too few met for a map; they count as wrong.
    right, share, standard_error, low, high
        Those whose number of holes is exactly right; as a share, with its standard error and Wilson's interval of 95 %.
    components_wrong
        Those mapped whose number of components is not that of the arena.
    hole_error, hole_bias, component_error
        Mean of the absolute and of the signed error of the number of holes, and of the absolute one of the number of components, of those
        mapped.
    encounters
        Median.
    simulate_s, map_s
        Means [s].
    """

    cell: Mapping[str, Value]
    cases: int
    failed: int
    no_map: int
    right: int
    share: float | None
    standard_error: float | None
    low: float | None
    high: float | None
    components_wrong: int
    hole_error: float | None
    hole_bias: float | None
    component_error: float | None
    encounters: float | None
    simulate_s: float | None
    map_s: float | None


def wilson(right: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson's score: true at 0 and 1, and for few runs, too.

    References
    ----------
    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc. 22, 1927.
    """
    share, z2 = right / runs, _Z**2
    middle = (share + z2 / (2 * runs)) / (1 + z2 / runs)
    half = _Z / (1 + z2 / runs) * sqrt(share * (1 - share) / runs + z2 / (4 * runs**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def account_for(sweep: Sweep, finished: Sequence[Finished[SweepCase, CaseResult]]) -> list[Account]:
    """Sum up every cell of a sweep, in its order."""
    n_cells = len(sweep.cells)
    return [_account(cell, finished[number::n_cells]) for number, cell in enumerate(sweep.cells)]


def _account(cell: Cell, finished: Sequence[Finished[SweepCase, CaseResult]]) -> Account:
    results = [one.result for one in finished if one.result is not None]
    errors = np.array([np.subtract(one.map_betti, one.true_betti) for one in results if one.map_betti is not None]).reshape(-1, 2)
    right, runs = int((errors[:, 1] == 0).sum()), len(results)
    share = right / runs if runs else None
    low, high = wilson(right, runs) if runs else (None, None)
    return Account(
        cell=cell,
        cases=len(finished),
        failed=len(finished) - runs,
        no_map=runs - len(errors),
        right=right,
        share=share,
        standard_error=None if share is None else sqrt(share * (1 - share) / runs),
        low=low,
        high=high,
        components_wrong=int((errors[:, 0] != 0).sum()),
        hole_error=_mean(np.abs(errors[:, 1])),
        hole_bias=_mean(errors[:, 1]),
        component_error=_mean(np.abs(errors[:, 0])),
        encounters=float(np.median([one.n_encounters for one in results])) if results else None,
        simulate_s=_mean([one.simulate_s for one in results]),
        map_s=_mean([one.map_s for one in results]),
    )


def tell_failures(finished: Sequence[Finished[SweepCase, CaseResult]]) -> list[str]:
    """Say what failed: each kind of failure once, with how often and the first case."""
    groups: dict[str, list[SweepCase]] = {}
    for one in finished:
        if one.failure is not None:
            groups.setdefault(f"{one.failure.kind}: {one.failure.message}", []).append(one.case)
    return [
        f"{len(group)} failed: {problem}; the first is seed {group[0].seed} of {label(group[0].cell, group[0].cell)}"
        for problem, group in groups.items()
    ]


def table(accounts: Sequence[Account]) -> str:
    """Draw the table for people; a cell is named by what differs between cells."""
    varied = [key for key in _keys(accounts) if len({repr(one.cell.get(key)) for one in accounts}) > 1]
    header = ("cell", "cases", "failed", "no map", "holes right", "95 %", "|holes|", "bias", "|comp.|", "enc.", "sim [s]", "map [s]")
    rows = [
        (
            label(one.cell, varied) or "all",
            str(one.cases),
            str(one.failed),
            str(one.no_map),
            "-" if one.share is None or one.standard_error is None else f"{one.share:.1%} ± {one.standard_error:.1%}",
            "-" if one.low is None or one.high is None else f"{one.low:.1%} to {one.high:.1%}",
            _shown(one.hole_error, ".2f"),
            _shown(one.hole_bias, "+.2f"),
            _shown(one.component_error, ".2f"),
            _shown(one.encounters, ".0f"),
            _shown(one.simulate_s, ".3g"),
            _shown(one.map_s, ".3g"),
        )
        for one in accounts
    ]
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    lines = [
        "  ".join(
            text.ljust(width) if column == 0 else text.rjust(width) for column, (text, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in (header, *rows)
    ]
    return "\n".join(lines)


def to_json(sweep: Sweep, accounts: Sequence[Account]) -> str:
    """Write the account as JSON."""
    seeds = {"first_seed": sweep.seeds.start, "repeats": len(sweep.seeds)}
    return json.dumps({"sweep": sweep.name, **seeds, "cells": [asdict(one) for one in accounts]}, indent=2, allow_nan=False) + "\n"


def to_csv(accounts: Sequence[Account]) -> str:
    """Write the account as CSV: the keys of the cells, then the figures; what is None is empty."""
    keys = _keys(accounts)
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    figures = [name for name in Account.__dataclass_fields__ if name != "cell"]
    writer.writerow([*keys, *figures])
    for one in accounts:
        writer.writerow([*(one.cell.get(key) for key in keys), *(getattr(one, name) for name in figures)])
    return text.getvalue()


def label(cell: Cell, keys: Iterable[str]) -> str:
    """Name a cell by some of its keys, each by its last part."""
    return ", ".join(f"{key.rpartition('.')[2]}={cell[key]}" for key in keys if key in cell)


def _keys(accounts: Sequence[Account]) -> list[str]:
    return list(dict.fromkeys(key for one in accounts for key in one.cell))


def _mean(values: Sequence[float] | np.ndarray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _shown(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)
