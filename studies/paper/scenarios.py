"""Scenarios 1 to 3 of [Dir16] VI: maps and diagrams beside the truth, bottleneck distances, and what is called a hole.

``python -m studies.paper.scenarios``. Both presets and both methods; lengths are those of an arena of side 50, and nothing is fitted.
"""

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mapper.types import BettiRuleKind, MapResult, Method
from studies.cases import results_of, run_cases
from studies.paper import drawing
from studies.paper.encounter_space import bottlenecks
from studies.paper.experiment import Experiment, Outcome, Setting, perform_main
from studies.paper.map_scores import SCORES, ScenarioScore, intervals_of, make_map
from studies.paper.swarm_runs import PRESETS, SCENARIOS, Place, RunCase, SwarmRun, simulate_run
from studies.truth import diagram_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_RUNS = 20
_TRUE_HOLES = dict(zip(SCENARIOS, (0, 1, 2), strict=True))


def run_scenarios(setting: Setting) -> Outcome:
    """Compute all runs, and draw the first of each scenario."""
    presets = setting.pick(PRESETS, PRESETS[:1])
    seeds = range(setting.first_seed, setting.first_seed + setting.pick(_RUNS, 1))
    share = setting.pick(1.0, 0.5)
    scenarios = setting.pick(SCENARIOS, SCENARIOS[1:2])
    cases = [
        RunCase(preset=preset, place=Place(scenario=scenario), seed=seed, time_share=share)
        for preset in presets
        for scenario in scenarios
        for seed in seeds
    ]
    scores = results_of(run_cases(SCORES, cases, setting.options("scenarios"), label="scenarios"))
    rows = [_row(case, score, method) for case, score in zip(cases, scores, strict=True) for method in Method]
    table = [
        _summarise(rows, preset=preset, scenario=scenario, method=method)
        for preset in presets
        for scenario in scenarios
        for method in (Method.PAPER, Method.DEFAULT)
    ]
    figures = {preset: _draw(preset, scenarios, seed=seeds[0], share=share) for preset in presets}
    return Outcome(summary={"table": table}, rows=rows, figures=figures)


def _row(case: RunCase, score: ScenarioScore, method: Method) -> dict[str, object]:
    own = score.paper if method is Method.PAPER else score.default
    return {
        "preset": case.preset,
        "scenario": case.place.scenario,
        "seed": case.seed,
        "method": str(method),
        "encounters": score.n_encounters,
        "components": own.betti[0],
        "holes": own.betti[1],
        "true_holes": _TRUE_HOLES[case.place.scenario],
        "bottleneck_0": own.bottleneck[0],
        "bottleneck_1": own.bottleneck[1],
        "diameter": own.diameter,
        "holes_published_theta": own.published_holes[0],
        "holes_published_tau_30": own.published_holes[1],
        "picture_error": own.picture_error,
        "exact_picture_error": own.exact_picture_error,
    }


def _summarise(rows: Sequence[Mapping[str, object]], *, preset: str, scenario: str, method: Method) -> dict[str, object]:
    own = [row for row in rows if (row["preset"], row["scenario"], row["method"]) == (preset, scenario, str(method))]
    column = {name: np.array([row[name] for row in own], dtype=np.float64) for name in own[0] if isinstance(own[0][name], int | float)}
    shares = [column[f"bottleneck_{dimension}"] / column["diameter"] for dimension in (0, 1)]
    return {
        "preset": preset,
        "scenario": scenario,
        "method": str(method),
        "runs": len(own),
        "encounters": float(np.median(column["encounters"])),
        "bottleneck_0_mean": float(shares[0].mean()),
        "bottleneck_1_mean": float(shares[1].mean()),
        "bottleneck_1_max": float(shares[1].max()),
        "holes_right": int((column["holes"] == column["true_holes"]).sum()),
        "components_right": int((column["components"] == 1).sum()),
        "published_theta_right": int((column["holes_published_theta"] == column["true_holes"]).sum()),
        "published_theta_found": int(column["holes_published_theta"].sum()),
        "published_tau_30_right": int((column["holes_published_tau_30"] == column["true_holes"]).sum()),
        "picture_error": float(column["picture_error"].mean()),
        "exact_picture_error": float(column["exact_picture_error"].mean()),
    }


def _draw(preset: str, scenarios: Sequence[str], *, seed: int, share: float) -> "Figure":
    """Draw one run of each scenario: snapshot, and complex and diagrams of both methods."""
    figure, axes = drawing.new_figure(len(scenarios), 5, size=(16.5, 0.6 + 3.3 * len(scenarios)))
    for scenario, row in zip(scenarios, axes, strict=True):
        run = simulate_run(RunCase(preset=preset, place=Place(scenario=scenario), seed=seed, time_share=share))
        drawing.draw_arena(row[0], run.arena)
        row[0].scatter(run.mover_positions[:, 0], run.mover_positions[:, 1], s=14, color=drawing.GREY, label="walking")
        row[0].scatter(run.landmark_positions[:, 0], run.landmark_positions[:, 1], s=30, color=drawing.GREEN, marker="^", label="landmark")
        row[0].set(
            title=f"scenario {1 + SCENARIOS.index(scenario)},\nseed {seed}", xlabel="x [1/50 of the side]", ylabel="y [1/50 of the side]"
        )
        for k, method in enumerate((Method.PAPER, Method.DEFAULT)):
            _draw_map(row[1 + 2 * k], row[2 + 2 * k], run, method)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2, frameon=False)
    handles, labels = axes[-1][2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=len(labels), frameon=False)
    figure.suptitle(f"preset {preset}: lengths in an arena of side 50")
    return figure


def _draw_map(map_axes: "Axes", diagram_axes: "Axes", run: SwarmRun, method: Method) -> None:
    result = make_map(run, method)
    exact = run.true_distances(result.points.encounter)
    found, true = intervals_of(result), diagram_of(exact)
    xy = np.column_stack([result.points.x, result.points.y])
    drawing.draw_complex(map_axes, xy, edges=result.edges, triangles=result.triangles)
    map_axes.set(
        title=f"{method} method: {len(xy)} points,\ncomplex at {result.components[0].epsilon:.1f}",
        xlabel="x [1/50 of the side]",
        ylabel="y [1/50 of the side]",
    )
    limit = 1.08 * max(float(result.diameter), float(exact.max())) / 2
    drawing.draw_diagrams(diagram_axes, found, true, limit=limit, names=("map", "truth"))
    drawing.mark_holes(diagram_axes, np.array([(hole.birth, hole.death) for hole in result.holes]).reshape(-1, 2))
    for dimension, colour in ((0, drawing.BLUE), (1, drawing.ORANGE)):
        threshold = _threshold(result, dimension)
        if threshold is not None and threshold < limit:
            label = f"threshold H{dimension}"
            diagram_axes.plot([0, limit - threshold], [threshold, limit], color=colour, linestyle="--", linewidth=0.9, label=label)
    distance = bottlenecks(true, found)[1]
    diagram_axes.set(
        title=f"{method} method, holes: {result.betti_numbers[1]},\nd_B(H1) = {distance:.2f} = {distance / exact.max():.1%}",
        xlabel="birth",
        ylabel="death (never: at the top)",
    )


def _threshold(result: MapResult, dimension: int) -> float | None:
    """Return the least length that the map's rule calls real; None where it goes by other things."""
    rules = result.recipe.betti_rules
    rule = None if rules is None else rules[dimension]
    part = result.components[0]
    finite = part.intervals[dimension][np.isfinite(part.intervals[dimension][:, 1])]
    if rule is None or rule.kind is not BettiRuleKind.QUANTILE or not len(finite):
        return None
    return rule.tau * (float(np.quantile(finite[:, 1] - finite[:, 0], rule.q, method="lower")) + rule.delta * part.diameter)


EXPERIMENT = Experiment(name="scenarios", about="scenarios 1 to 3, both presets and methods", run=run_scenarios)

if __name__ == "__main__":
    sys.exit(perform_main([EXPERIMENT], None, prog="python -m studies.paper.scenarios", about="Scenarios 1 to 3 of [Dir16] VI."))
