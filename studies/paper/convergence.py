"""Theorems 1 and 2 of [Dir16] held against simulated runs: how far d_GE and d_GEL may be from d_MxT and d_M.

``python -m studies.paper.convergence``. Scenarios 1 and 2 with the paper's swarm, 20 runs each. The paper proves these bounds and shows no
figure of them; here tau, epsilon and delta_e are measured, and pairs that break a bound are counted.
"""

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from studies.cases import results_of, run_cases
from studies.paper import drawing, theorems
from studies.paper.encounter_space import measure_space
from studies.paper.experiment import Experiment, Outcome, Setting, perform_main
from studies.paper.step_checks import STEPS, StepsCase, measure_steps
from studies.paper.swarm_runs import PRESETS, Place, RunCase, simulate_run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SCENARIOS = ("no-obstacle", "one-obstacle")
_RUNS = 20
_EVENTS, _QUICK_EVENTS = 500, 60


def run_convergence(setting: Setting) -> Outcome:
    """Compute all runs, and draw the first of scenario 2."""
    presets, scenarios = setting.pick(PRESETS, PRESETS[:1]), setting.pick(_SCENARIOS, _SCENARIOS[1:])
    seeds = range(setting.first_seed, setting.first_seed + setting.pick(_RUNS, 1))
    n_events, share = setting.pick(_EVENTS, _QUICK_EVENTS), setting.pick(1.0, 0.5)

    def case_of(preset: str, scenario: str, seed: int) -> StepsCase:
        return StepsCase(run=RunCase(preset=preset, place=Place(scenario=scenario), seed=seed, time_share=share), n_events=n_events)

    cases = [case_of(preset, scenario, seed) for preset in presets for scenario in scenarios for seed in seeds]
    runs = results_of(run_cases(STEPS, cases, setting.options("convergence"), label="convergence"))
    rows = [
        {"preset": case.run.preset, "scenario": case.run.place.scenario, "seed": case.run.seed, **asdict(run)}
        for case, run in zip(cases, runs, strict=True)
    ]
    table = []
    for preset in presets:
        for scenario in scenarios:
            own = [asdict(run) for case, run in zip(cases, runs, strict=True) if _is(case, preset, scenario)]
            table.append(
                {
                    "preset": preset,
                    "scenario": scenario,
                    "runs": len(own),
                    **{name: float(np.mean([run[name] for run in own])) for name in own[0]},
                }
            )
    figures = {preset: _draw(case_of(preset, _SCENARIOS[1], seeds[0])) for preset in presets}
    return Outcome(summary={"table": table}, rows=rows, figures=figures)


def _is(case: StepsCase, preset: str, scenario: str) -> bool:
    return (case.run.preset, case.run.place.scenario) == (preset, scenario)


def _draw(case: StepsCase) -> "Figure":
    run = simulate_run(case.run)
    steps, space = measure_steps(run, n_events=case.n_events), measure_space(run)
    figure, ((events_axes, landmark_axes),) = drawing.new_figure(1, 2, size=(11.5, 5.2))
    above = np.triu_indices(len(steps.events), 1)
    true, found = steps.true[above], steps.found[above]
    events_axes.scatter(true, found, s=1, alpha=0.12, color=drawing.BLUE, linewidths=0, rasterized=True)
    _draw_limits(events_axes, limit=float(true.max()), inflation=steps.inflation, tau=steps.tau)
    events_axes.set(
        title=f"Theorem 1: {len(steps.events)} encounters, delta_e = {steps.delta_e:.0f}, tau = {steps.tau:.0f}",
        xlabel="max(d_M, |dt|) [1/50 of the side]",
        ylabel="d_GE [1/50 of the side]",
        xscale="log",
        yscale="log",
        xlim=(1.0, float(true.max())),
        ylim=(1.0, 3.0 * float(found.max())),
    )
    above = np.triu_indices(len(space.landmarks), 1)
    true, found = space.true_between_landmarks[above], space.between_landmarks[above]
    landmark_axes.scatter(true, found, s=14, color=drawing.BLUE, linewidths=0)
    _draw_limits(landmark_axes, limit=float(true.max()), inflation=steps.inflation, tau=steps.tau)
    landmark_axes.set(
        title=f"Theorem 2: {len(space.landmarks)} landmarks, {np.mean(found < true):.0%} of the pairs below d_M",
        xlabel="d_M [1/50 of the side]",
        ylabel="d_GEL [1/50 of the side]",
        xlim=(0, float(true.max())),
        ylim=(0, 3.0 * float(true.max())),
    )
    figure.legend(*events_axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"preset {case.run.preset}, scenario 2, seed {case.run.seed}")
    return figure


def _draw_limits(axes: "Axes", *, limit: float, inflation: float, tau: float) -> None:
    x = np.linspace(0.0, limit, 2_000)
    axes.plot(x, x, color="black", linewidth=1.0, label="lower bound")
    axes.plot(x, theorems.theorem_1(x, inflation=inflation), color=drawing.ORANGE, label="upper bound, published")
    axes.plot(x, theorems.theorem_1(x, inflation=inflation, tau=tau), color=drawing.GREEN, label="upper bound, corrected")


EXPERIMENT = Experiment(name="convergence", about="Theorems 1 and 2 with measured constants, scenarios 1 and 2", run=run_convergence)

if __name__ == "__main__":
    sys.exit(perform_main([EXPERIMENT], None, prog="python -m studies.paper.convergence", about="Theorems 1 and 2, held against runs."))
