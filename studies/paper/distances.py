"""d_GEL against d_M, between landmarks and between encounters, and the diagrams of both ([Dir16] VI, "Convergence Analysis").

``python -m studies.paper.distances``. Scenario 2 with 20 landmarks and 100 walkers. PD(M) is of a fine sample of the arena, as the paper
compares both diagrams with the same truth; beside it stands that of the same points.
"""

import sys
from typing import TYPE_CHECKING

import numpy as np

from studies.cases import results_of, run_cases
from studies.paper import drawing
from studies.paper.encounter_space import EncounterSpace, bottlenecks, measure_space, sample_scenario
from studies.paper.experiment import Experiment, Outcome, Setting, perform_main
from studies.paper.metric_agreement import DISTANCES, DistanceCase
from studies.paper.swarm_runs import PRESETS, Place, RunCase, simulate_run
from studies.truth import diagram_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SCENARIO = "one-obstacle"
_MOVERS = 100
_RUNS = 20
_POINTS, _QUICK_POINTS = 400, 80


def run_distances(setting: Setting) -> Outcome:
    """Compute all runs, and draw the first."""
    presets = setting.pick(PRESETS, PRESETS[:1])
    seeds = range(setting.first_seed, setting.first_seed + setting.pick(_RUNS, 2))
    n_points, share = setting.pick(_POINTS, _QUICK_POINTS), setting.pick(1.0, 0.5)

    def case_of(preset: str, seed: int) -> DistanceCase:
        run = RunCase(preset=preset, place=Place(scenario=_SCENARIO), seed=seed, movers=_MOVERS, time_share=share)
        return DistanceCase(run=run, n_points=n_points)

    cases = [case_of(preset, seed) for preset in presets for seed in seeds]
    runs = results_of(run_cases(DISTANCES, cases, setting.options("distances"), label="distances"))
    rows = [
        {
            "preset": case.run.preset,
            "seed": case.run.seed,
            "encounters": run.n_encounters,
            "set": name,
            "rms_error": own.rms_error,
            "median_ratio": own.median_ratio,
            "share_below": own.share_below,
            "bottleneck_1": own.bottleneck_1,
            "same_points_bottleneck_1": own.same_points_bottleneck_1,
            "cover_radius": own.cover_radius,
            "next_landmark": run.next_landmark,
        }
        for case, run in zip(cases, runs, strict=True)
        for name, own in (("landmarks", run.landmarks), ("encounters", run.encounters))
    ]
    table = []
    for preset in presets:
        for name in ("landmarks", "encounters"):
            group = [row for row in rows if (row["preset"], row["set"]) == (preset, name)]
            means = {key: float(np.mean([row[key] for row in group])) for key in list(rows[0])[4:]}
            table.append({"preset": preset, "set": name, "runs": len(group), **means})
    figures = {preset: _draw(case_of(preset, seeds[0])) for preset in presets}
    return Outcome(summary={"table": table}, rows=rows, figures=figures)


def _draw(case: DistanceCase) -> "Figure":
    run = simulate_run(case.run)
    space, fine = measure_space(run), sample_scenario(_SCENARIO, n_points=case.n_points)
    figure, axes = drawing.new_figure(2, 2, size=(9.0, 8.4))
    _draw_pairs(axes[0][0], space, name="landmarks")
    _draw_pairs(axes[0][1], space, name="encounters")
    diagrams = (diagram_of(space.between_landmarks), diagram_of(space.between_encounters))
    for diagram_axes, found, name in zip(axes[1], diagrams, ("L", "E"), strict=True):
        limit = 1.1 * max(float(part[np.isfinite(part)].max()) for part in (*found, *fine.intervals))
        drawing.draw_diagrams(diagram_axes, found, fine.intervals, limit=limit, names=(f"PD({name})", "PD(M)"))
        distance = bottlenecks(fine.intervals, found)
        diagram_axes.set(
            title=f"d_B(PD(M), PD({name})): {distance[0]:.2f} in H0, {distance[1]:.2f} in H1",
            xlabel="birth [1/50 of the side]",
            ylabel="death (never: at the top)",
        )
        diagram_axes.legend(loc="lower right")
    figure.suptitle(f"preset {case.run.preset}, scenario 2, 20 landmarks, {_MOVERS} walkers, seed {case.run.seed}")
    return figure


def _draw_pairs(axes: "Axes", space: EncounterSpace, *, name: str) -> None:
    found, true = {
        "landmarks": (space.between_landmarks, space.true_between_landmarks),
        "encounters": (space.between_encounters, space.true_between_encounters),
    }[name]
    above = np.triu_indices(len(true), 1)
    small = len(true) > 50
    axes.scatter(
        true[above], found[above], s=2 if small else 12, alpha=0.25 if small else 0.8, color=drawing.BLUE, linewidths=0, rasterized=True
    )
    limit = 1.05 * max(float(found.max()), float(true.max()))
    axes.plot([0, limit], [0, limit], color="black", linewidth=0.9, label="d_GEL = d_M")
    axes.set(title=f"{len(true)} {name}, all pairs", xlabel="d_M [1/50 of the side]", ylabel="d_GEL [1/50 of the side]")
    axes.set(xlim=(0, 1.05 * float(true.max())), ylim=(0, limit))
    axes.legend(loc="upper left")


EXPERIMENT = Experiment(name="distances", about="d_GEL against d_M, landmarks and encounters, scenario 2", run=run_distances)

if __name__ == "__main__":
    sys.exit(
        perform_main([EXPERIMENT], None, prog="python -m studies.paper.distances", about="d_GEL against d_M, and the diagrams of both.")
    )
