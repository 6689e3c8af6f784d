"""Write the tables of docs/paper.md from what the experiments left: ``python -m studies.paper.report``.

Every figure in a table comes from the summaries beside the pictures; the text around the tables is written by hand.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from studies.errors import StudyError, SummaryError
from studies.paper.overview import tell_overview
from studies.tables import put_between_markers

Summary = Mapping[str, Any]
Rows = Sequence[Sequence[str]]

_SCENARIO_NUMBERS = {"no-obstacle": "1", "one-obstacle": "2", "two-obstacles": "3"}


def table_of(names: Sequence[str], rows: Rows) -> str:
    """Return a table in Markdown."""
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def tell_units(summary: Summary) -> str:
    """Encounters by the side of the arena."""
    rows = [[f"{row['side_m']:g} m", str(row["runs"]), f"{row['encounters']:,.1f}", f"{row['theory']:,.1f}"] for row in summary["table"]]
    return table_of(("side of the arena", "runs", "encounters, simulated", "kinetic theory"), rows)


def tell_scenarios(summary: Summary) -> str:
    """Bottleneck distances, holes and pictures of the scenarios."""
    rows = [
        [
            row["preset"],
            _SCENARIO_NUMBERS[row["scenario"]],
            row["method"],
            f"{row['encounters']:,.0f}",
            f"{row['bottleneck_1_mean']:.1%} ({row['bottleneck_1_max']:.1%})",
            f"{row['bottleneck_0_mean']:.1%}",
            f"{row['holes_right']} of {row['runs']}",
            f"{row['published_theta_right']} of {row['runs']} ({row['published_theta_found']} found)",
            f"{row['picture_error']:.1%} ({row['exact_picture_error']:.1%})",
        ]
        for row in summary["table"]
    ]
    names = (
        "preset",
        "scenario",
        "method",
        "encounters",
        "d_B in H1: mean (largest)",
        "d_B in H0",
        "holes right",
        "holes right by the published theta",
        "picture, rms (of exact geodesics)",
    )
    return table_of(names, rows)


def tell_subsampling(summary: Summary) -> str:
    """Signal to noise of the ways to subsample."""
    rows = [
        [
            row["preset"],
            row["subsample"],
            str(row["runs"]),
            _ratio(row["snr_called"]),
            _ratio(row["snr_true"]),
            f"{row['runs_with_hole']}",
            f"{row['runs_with_one_hole']}",
        ]
        for row in summary["table"]
    ]
    names = (
        "preset",
        "subsample",
        "runs",
        "SNR, signal: called a hole",
        "SNR, signal: the longest",
        "runs with a hole",
        "with exactly one",
    )
    return table_of(names, rows)


def tell_training(summary: Summary) -> str:
    """What brute force found."""
    rows = [
        [
            row["preset"],
            row["method"],
            str(row["runs"]),
            f"({row['q']:g}, {row['delta']:g}, {row['tau']:g})",
            f"{row['error']:.2f}",
            f"{row['published_found']} of {2 * row['runs']}",
        ]
        for row in summary["training"]
    ]
    names = ("preset", "method", "runs", "theta: q, Delta [diameters], tau", "training error", "holes found by the published theta")
    return table_of(names, rows)


def tell_robustness(summary: Summary) -> str:
    """Sensitivity by scale and by number of holes."""
    rows = [
        [
            row["preset"],
            f"{row['scale']:g}",
            str(row["true_holes"]),
            row["method"],
            f"{row['encounters']:,.0f}",
            f"{row['sensitivity']:.1%}",
            f"{row['error']:.2f}",
            f"{row['false_holes']:.2f}",
            f"{row['shipped_sensitivity']:.1%}",
            f"{row['shipped_right']} of {row['runs']}",
        ]
        for row in summary["table"]
    ]
    names = (
        "preset",
        "scale",
        "holes",
        "method",
        "encounters",
        "sensitivity, trained here",
        "mean error of the count",
        "holes too many a run",
        "sensitivity, shipped, enclosing",
        "counts right, shipped",
    )
    return table_of(names, rows)


def tell_distances(summary: Summary) -> str:
    """d_GEL against d_M."""
    rows = [
        [
            row["preset"],
            row["set"],
            f"{row['rms_error']:.1%}",
            f"{row['median_ratio']:.2f}",
            f"{row['share_below']:.1%}",
            f"{row['cover_radius']:.1f}",
            f"{row['next_landmark']:.1f}" if row["set"] == "landmarks" else "",
            f"{row['bottleneck_1']:.2f}",
            f"{row['same_points_bottleneck_1']:.2f}",
        ]
        for row in summary["table"]
    ]
    names = (
        "preset",
        "between",
        "rms error",
        "median of d_GEL / d_M",
        "pairs with d_GEL < d_M",
        "covering radius",
        "landmark to the next",
        "d_B in H1, PD(M) of the arena",
        "d_B in H1, PD(M) of the same points",
    )
    return table_of(names, rows)


def tell_convergence(summary: Summary) -> str:
    """Theorems 1 and 2, and the lower bound of Corollary 1."""
    checks = (
        ("Theorem 1, d_MxT <= d_GE", "below_1", "below_1_handovers", "r_d a handover"),
        ("Theorem 1, d_GE <= (1 + lambda_3) d_MxT", "above_1", "above_1_corrected", "+ tau"),
        ("Theorem 2, d_M <= d_GEL", "below_2", "below_2_handovers", "r_d a handover"),
        ("Theorem 2, d_GEL <= (1 + lambda_3) d_M", "above_2", "above_2_corrected", "+ tau, events alike in time"),
        ("Corollary 1, d_M <= d_GEL", "below_corollary", "below_corollary_handovers", "r_d a handover"),
    )
    rows = [
        [name, *(f"{row[key]:.2%}" for row in summary["table"] for key in (published, corrected)), change]
        for name, published, corrected, change in checks
    ]
    heads = [f"{row['preset']}, scenario {_SCENARIO_NUMBERS[row['scenario']]}" for row in summary["table"]]
    names = ("pairs that break", *(f"{head}: {kind}" for head in heads for kind in ("published", "corrected")), "corrected by")
    constants = [
        [
            head,
            str(row["runs"]),
            f"{row['delta_e']:.1f}",
            f"{row['epsilon']:.0f}",
            f"{row['tau']:.0f}",
            f"{row['lambda_3']:.2f}",
            f"{row['close_pairs_joined']:.1%}",
        ]
        for head, row in zip(heads, summary["table"], strict=True)
    ]
    measured = table_of(("", "runs", "delta_e", "epsilon", "tau", "lambda_3", "pairs within epsilon that share a biobot"), constants)
    return f"{measured}\n\n{table_of(names, rows)}"


def tell_bounds(summary: Summary) -> str:
    """Violations of Theorem 3 and Corollary 1, and lambda_3 at the ends of the grid."""
    rows = []
    for row in summary["violations"]:
        runs = row["runs"]
        where = [row["preset"], _SCENARIO_NUMBERS[row["scenario"]]]
        for of, name in (("l", "d_B(PD(M), PD(L))"), ("e", "d_B(PD(M), PD(E))")):
            counts = [
                f"{row[f'{kind}_{of}_0']} / {row[f'{kind}_{of}_1']} of {runs}; {row[f'{kind}_{of}_slack']:.1f} x"
                for kind in ("published", "corrected", "stable")
            ]
            rows.append([*where, name, *counts])
    names = ("preset", "scenario", "Theorem 3", "published", "corrected", "with the metric's error as measured")
    pairs = [
        [
            row["preset"],
            _SCENARIO_NUMBERS[row["scenario"]],
            *(f"{row[key]:.2%}" for key in ("theorem_2_below", "corollary_below")),
            *(f"{row[key]:.2%}" for key in ("corollary_published", "corollary_corrected", "corollary_by_landmarks")),
        ]
        for row in summary["violations"]
    ]
    pair_names = (
        "preset",
        "scenario",
        "pairs of landmarks with d_GEL < d_M",
        "pairs of encounters with d_GEL < d_M",
        "above Corollary 1, published",
        "delta_l twice the covering radius",
        "by the way over the landmarks",
    )
    landmarks, movers = ([row[key] for row in summary["grid"]] for key in ("landmarks", "movers"))
    ends = [
        [
            row["preset"],
            _SCENARIO_NUMBERS[row["scenario"]],
            str(row["landmarks"]),
            str(row["movers"]),
            f"{row['n_encounters']:,.0f}",
            f"{row['lambda_max']:.2f}",
            f"{row['lambda_median']:.2f}",
            f"{row['bottleneck_e_1']:.2f}",
            f"{row['bottleneck_l_1']:.2f}",
        ]
        for row in summary["grid"]
        if row["landmarks"] in {min(landmarks), max(landmarks)} and row["movers"] in {min(movers), max(movers)}
    ]
    end_names = (
        "preset",
        "scenario",
        "N_l",
        "N_m",
        "encounters",
        "lambda_3, largest",
        "median",
        "d_B(PD(M), PD(E)) in H1",
        "d_B(PD(M), PD(L)) in H1",
    )
    return "\n\n".join([table_of(end_names, ends), table_of(names, rows), table_of(pair_names, pairs)])


TABLES: Mapping[str, tuple[str, Callable[[Summary], str]]] = {
    "units": ("units", tell_units),
    "scenarios": ("scenarios", tell_scenarios),
    "subsampling": ("subsampling", tell_subsampling),
    "training": ("classifier", tell_training),
    "robustness": ("classifier", tell_robustness),
    "distances": ("distances", tell_distances),
    "convergence": ("convergence", tell_convergence),
    "bounds": ("bounds", tell_bounds),
}
"""By the name in the document's markers: the experiment, and what makes the table of its summary."""


def fill(document: str, folder: Path, *, path: Path) -> str:
    """Return the document with every table made anew.

    Parameters
    ----------
    folder
        Of the summaries.
    path
        Of the document, for errors.

    Raises
    ------
    MarkerError
        A table has no place in the document.
    SummaryError
        A summary is missing or faulty, or of a quick run.
    """
    summaries = {experiment: _read(folder / f"{experiment}.json") for experiment, _ in TABLES.values()}
    overview = table_of(("", "the paper", "here", "why they differ"), tell_overview(summaries))
    document = put_between_markers(document, overview, path=path, markers=_markers("overview"))
    for name, (experiment, tell) in TABLES.items():
        first, runs = summaries[experiment]["first_seed"], summaries[experiment]["runs"]
        source = f"`python -m studies.paper.{experiment}`, seeds from {first:,}; {runs:,} rows of results."
        table = f"{tell(summaries[experiment])}\n\n{source}"
        document = put_between_markers(document, table, path=path, markers=_markers(name))
    return document


def _read(path: Path) -> Summary:
    try:
        summary: Summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SummaryError(path=path, problem=f"cannot be read: {error}") from error
    if summary.get("is_quick", True):
        raise SummaryError(path=path, problem="is of a quick run, whose figures mean nothing")
    return summary


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the document; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m studies.paper.report", description="Write the tables of docs/paper.md.")
    parser.add_argument("--data", type=Path, default=Path("docs/paper"), metavar="DIR", help="summaries (default: %(default)s)")
    parser.add_argument("--document", type=Path, default=Path("docs/paper.md"), metavar="FILE", help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        text = fill(options.document.read_text(encoding="utf-8"), options.data, path=options.document)
        options.document.write_text(text, encoding="utf-8")
    except (StudyError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _markers(name: str) -> tuple[str, str]:
    return f"<!-- {name} begins -->", f"<!-- {name} ends -->"


def _ratio(value: float | None) -> str:
    return "none" if value is None else f"{value:.1f}"


if __name__ == "__main__":
    sys.exit(main())
