"""Training of the classifier on 100 two-hole arenas, and its sensitivity by scale and by number of holes ([Dir16] VI, "Classification").

``python -m studies.paper.classifier``. The two holes of side 13 in 50 are at random places. Trained is by brute force on the mean error of
the count, eq. 17; lengths are shares of the metric's diameter, or the classifier would not be scale-invariant as claimed. Sensitivity is
TP / (TP + FN) of the whole method: of the mapper's own holes one is true if its outline goes around an obstacle; where only counts are
known, as many are true as there are obstacles. Scaled are arena and obstacles; biobots stay as they are.
"""

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mapper.types import Method
from studies.cases import results_of, run_cases
from studies.paper import drawing
from studies.paper.classification import PUBLISHED, Theta, Training, count_holes, train
from studies.paper.experiment import Experiment, Outcome, Setting, perform_main
from studies.paper.judged_runs import JUDGED, METHODS, Judged, JudgedRun
from studies.paper.swarm_runs import PRESETS, Place, RunCase

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_RUNS = 100
_SCALES = (0.5, 0.75, 1.0, 1.5, 2.0)
_HOLES = (1, 2, 3)
_FIRST_TRAINING_SEED = 0


def sensitivity(found: Sequence[int], true: Sequence[int]) -> float:
    """Return TP / (TP + FN) of counts: of each run as many are true as there are holes, at most."""
    return sum(min(one, holes) for one, holes in zip(found, true, strict=True)) / sum(true)


def run_classifier(setting: Setting) -> Outcome:
    """Train on two-hole arenas, and judge on others: of other scales, and with other numbers of holes."""
    presets = setting.pick(PRESETS, PRESETS[:1])
    n, share = setting.pick(_RUNS, 2), setting.pick(1.0, 0.5)
    places = {Place(holes=2, scale=scale) for scale in setting.pick(_SCALES, (1.0, 1.5))}
    places |= {Place(holes=holes) for holes in setting.pick(_HOLES, (1, 2))}
    ordered = sorted(places, key=lambda place: (place.scale, place.holes))

    def cases_of(preset: str, place: Place, first_seed: int) -> list[RunCase]:
        return [RunCase(preset=preset, place=place, seed=seed, time_share=share) for seed in range(first_seed, first_seed + n)]

    training_cases = [case for preset in presets for case in cases_of(preset, Place(holes=2), _FIRST_TRAINING_SEED)]
    test_cases = [case for preset in presets for place in ordered for case in cases_of(preset, place, setting.first_seed)]
    runs = results_of(run_cases(JUDGED, training_cases + test_cases, setting.options("classifier"), label="classifier"))
    training_runs, test_runs = runs[: len(training_cases)], runs[len(training_cases) :]
    trained: dict[tuple[str, Method], Training] = {}
    for preset in presets:
        own = [run for case, run in zip(training_cases, training_runs, strict=True) if case.preset == preset]
        for method in METHODS:
            trained[preset, method] = train([_of(run, method).loops for run in own], [2] * len(own))
    rows = [
        _row(case, run, method, trained[case.preset, method].theta)
        for case, run in zip(test_cases, test_runs, strict=True)
        for method in METHODS
    ]
    table = [_summarise(rows, preset=preset, place=place, method=method) for preset in presets for place in ordered for method in METHODS]
    training_table = [
        {
            "preset": preset,
            "method": str(method),
            "runs": n,
            "q": training.theta.q,
            "delta": training.theta.delta,
            "tau": training.theta.tau,
            "error": training.error,
            "published_found": sum(
                count_holes(_of(run, method).loops, PUBLISHED)
                for case, run in zip(training_cases, training_runs, strict=True)
                if case.preset == preset
            ),
        }
        for (preset, method), training in trained.items()
    ]
    examples = {
        preset: (case, run) for case, run in reversed(list(zip(training_cases, training_runs, strict=True))) for preset in [case.preset]
    }
    figures = {preset: _draw(*examples[preset], table, trained, preset=preset) for preset in presets}
    return Outcome(summary={"training": training_table, "table": table}, rows=rows, figures=figures)


def _of(run: JudgedRun, method: Method) -> Judged:
    return run.paper if method is Method.PAPER else run.default


def _row(case: RunCase, run: JudgedRun, method: Method, theta: Theta) -> dict[str, object]:
    own = _of(run, method)
    return {
        "preset": case.preset,
        "scale": case.place.scale,
        "true_holes": case.place.holes,
        "seed": case.seed,
        "method": str(method),
        "encounters": run.n_encounters,
        "holes_trained_here": count_holes(own.loops, theta),
        "holes_shipped": own.n_holes,
        "obstacles_enclosed": own.n_enclosing,
    }


def _summarise(rows: Sequence[Mapping[str, object]], *, preset: str, place: Place, method: Method) -> dict[str, object]:
    wanted = (preset, place.scale, place.holes, str(method))
    own = [row for row in rows if (row["preset"], row["scale"], row["true_holes"], row["method"]) == wanted]
    column = {name: np.array([row[name] for row in own], dtype=np.int64) for name in own[0] if isinstance(own[0][name], int)}
    true = column["true_holes"].tolist()
    return {
        "preset": preset,
        "scale": place.scale,
        "true_holes": place.holes,
        "method": str(method),
        "runs": len(own),
        "encounters": float(np.median(column["encounters"])),
        "sensitivity": sensitivity(column["holes_trained_here"].tolist(), true),
        "error": float(np.abs(column["holes_trained_here"] - column["true_holes"]).mean()),
        "false_holes": float(np.maximum(column["holes_trained_here"] - column["true_holes"], 0).mean()),
        "shipped_sensitivity": sum(column["obstacles_enclosed"].tolist()) / sum(true),
        "shipped_right": int((column["holes_shipped"] == column["true_holes"]).sum()),
    }


def _draw(
    case: RunCase, run: JudgedRun, table: Sequence[Mapping[str, Any]], trained: Mapping[tuple[str, Method], Training], *, preset: str
) -> "Figure":
    """Draw an arena, the lengths of its intervals with the threshold for each method, and sensitivity by scale and by holes."""
    figure, ((arena_axes, *length_axes), (scale_axes, holes_axes, error_axes)) = drawing.new_figure(2, 3, size=(12.0, 7.4))
    drawing.draw_arena(arena_axes, case.place.build(seed=case.seed))
    unit = "[1/50 of the side]"
    arena_axes.set(title=f"a two-hole arena of training, seed {case.seed}", xlabel=f"x {unit}", ylabel=f"y {unit}")
    for axes, method in zip(length_axes, METHODS, strict=True):
        theta = trained[preset, method].theta
        loops = _of(run, method).loops
        lengths = loops[:, 1] - loops[:, 0]
        threshold = theta.tau * (float(np.quantile(lengths, theta.q, method="lower")) + theta.delta)
        axes.hist(lengths, bins=40, color=drawing.METHOD_COLOURS[method])
        axes.axvline(threshold, color="black", linestyle="--", linewidth=1, label=f"threshold: {count_holes(loops, theta)} above")
        axes.set(title=f"{method} method, {len(lengths)} intervals of H1", xlabel="length [diameters]", ylabel="intervals", yscale="log")
        axes.legend()
    for axes, key, values in ((scale_axes, "scale", "true_holes"), (holes_axes, "true_holes", "scale")):
        fixed = 2 if values == "true_holes" else 1.0
        for method in METHODS:
            own = [row for row in table if (row["preset"], row["method"], row[values]) == (preset, str(method), fixed)]
            colour, x = drawing.METHOD_COLOURS[method], [row[key] for row in own]
            axes.plot(x, [row["sensitivity"] for row in own], "o-", color=colour, label=f"{method}, trained here")
            axes.plot(x, [row["shipped_sensitivity"] for row in own], "s--", color=colour, label=f"{method}, shipped, enclosing")
        axes.set(ylim=(0, 1.03), ylabel="sensitivity TP / (TP + FN)")
        axes.grid(visible=True, alpha=0.3)
    scale_axes.set(title="two holes, by scale", xlabel="scale of arena and holes")
    holes_axes.set(title="scale 1, by number of holes", xlabel="true number of holes", xticks=list(_HOLES))
    figure.legend(*holes_axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    for method in METHODS:
        own = [row for row in table if (row["preset"], row["method"], row["scale"]) == (preset, str(method), 1.0)]
        error_axes.plot(
            [row["true_holes"] for row in own], [row["error"] for row in own], "o-", color=drawing.METHOD_COLOURS[method], label=str(method)
        )
    error_axes.set(
        title="scale 1: error of the count, trained here",
        xlabel="true number of holes",
        ylabel="mean |found - true| [holes]",
        xticks=list(_HOLES),
    )
    error_axes.set_ylim(bottom=0)
    figure.suptitle(f"preset {preset}")
    return figure


EXPERIMENT = Experiment(
    name="classifier", about="training on two-hole arenas, sensitivity by scale and number of holes", run=run_classifier
)

if __name__ == "__main__":
    sys.exit(
        perform_main([EXPERIMENT], None, prog="python -m studies.paper.classifier", about="Training of the classifier, and its robustness.")
    )
