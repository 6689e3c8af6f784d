"""Maxmin against KNN-maxmin: the signal-to-noise ratio of dimension 1 with one obstacle, 100 runs ([Dir16] VI, "Example Scenarios").

``python -m studies.paper.subsampling``. The default method, which drops other encounters and compares them otherwise, stands beside.
"""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mapper.pipeline import compute_map
from mapper.types import MapResult
from studies.cases import results_of, run_cases
from studies.paper import drawing
from studies.paper.experiment import Experiment, Outcome, Setting, perform_main
from studies.paper.interval_powers import POWERS, SUBSAMPLES, Powers, recipes_of
from studies.paper.swarm_runs import PRESETS, Place, RunCase, SwarmRun, simulate_run
from studies.truth import diagram_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PLACE = Place(scenario="one-obstacle")
_RUNS = 100
_COLOURS = dict(zip(SUBSAMPLES, (drawing.GREY, drawing.ORANGE, drawing.BLUE), strict=True))


def signal_to_noise(signals: Sequence[float | None], noises: Sequence[float | None]) -> float | None:
    """Divide the mean power of signals by that of noise, of the runs that have any ([Dir16] VI); None where none has."""
    signal, noise = ([power for power in powers if power is not None] for powers in (signals, noises))
    if not (signal and noise and np.mean(noise) > 0):
        return None
    return float(np.mean(signal) / np.mean(noise))


def run_subsampling(setting: Setting) -> Outcome:
    """Compute all runs, and draw the clouds and diagrams of the first."""
    presets = setting.pick(PRESETS, PRESETS[:1])
    seeds = range(setting.first_seed, setting.first_seed + setting.pick(_RUNS, 2))
    share = setting.pick(1.0, 0.5)
    cases = [RunCase(preset=preset, place=_PLACE, seed=seed, time_share=share) for preset in presets for seed in seeds]
    runs = results_of(run_cases(POWERS, cases, setting.options("subsampling"), label="subsampling"))
    rows = [
        {
            "preset": case.preset,
            "seed": case.seed,
            "subsample": name,
            "holes": own.n_called,
            "called_signal": own.called_signal,
            "called_noise": own.called_noise,
            "true_signal": own.true_signal,
            "true_noise": own.true_noise,
        }
        for case, run in zip(cases, runs, strict=True)
        for name, own in zip(SUBSAMPLES, run.powers, strict=True)
    ]
    table, figures = [], {}
    for preset in presets:
        of_preset = [run.powers for case, run in zip(cases, runs, strict=True) if case.preset == preset]
        ratios = {}
        for name, own in zip(SUBSAMPLES, zip(*of_preset, strict=True), strict=True):
            ratios[name] = _ratios(own)
            table.append(
                {
                    "preset": preset,
                    "subsample": name,
                    "runs": len(own),
                    "snr_called": signal_to_noise([one.called_signal for one in own], [one.called_noise for one in own]),
                    "snr_true": signal_to_noise([one.true_signal for one in own], [one.true_noise for one in own]),
                    "runs_with_hole": sum(one.n_called > 0 for one in own),
                    "runs_with_one_hole": sum(one.n_called == 1 for one in own),
                }
            )
        run = simulate_run(RunCase(preset=preset, place=_PLACE, seed=seeds[0], time_share=share))
        figures[preset] = _draw(run, ratios, title=f"preset {preset}, one obstacle; left and middle: seed {seeds[0]}")
    return Outcome(summary={"table": table}, rows=rows, figures=figures)


def _ratios(powers: Sequence[Powers]) -> tuple[list[float], list[float]]:
    """Return the ratio of each run that has one: the signal being what is called a hole, and the longest interval."""
    called = [one.called_signal / one.called_noise for one in powers if one.called_signal and one.called_noise]
    true = [one.true_signal / one.true_noise for one in powers if one.true_signal and one.true_noise]
    return called, true


def _draw(run: SwarmRun, ratios: dict[str, tuple[list[float], list[float]]], *, title: str) -> "Figure":
    figure, axes = drawing.new_figure(2, 3, size=(11.5, 7.4))
    for name, recipe, row in zip(SUBSAMPLES, recipes_of(run), axes, strict=False):
        _draw_sample(row[0], row[1], run, compute_map(run.table, run.spells, recipe), name=name)
    _draw_shares(axes[0][2], {name: own[1] for name, own in ratios.items()}, title="signal: the longest interval")
    _draw_shares(axes[1][2], {name: own[0] for name, own in ratios.items()}, title="signal: what is called a hole")
    figure.legend(*axes[0][1].get_legend_handles_labels(), loc="outside lower left", ncols=5, frameon=False)
    figure.legend(*axes[0][2].get_legend_handles_labels(), loc="outside lower right", ncols=3, frameon=False)
    figure.suptitle(title)
    return figure


def _draw_sample(cloud: "Axes", diagram: "Axes", run: SwarmRun, result: MapResult, *, name: str) -> None:
    cloud.scatter(result.points.x, result.points.y, s=12, color=_COLOURS[name])
    unit = "[1/50 of the side]"
    cloud.set(title=f"{name}: {len(result.points)} points in the plane", xlabel=f"x {unit}", ylabel=f"y {unit}")
    cloud.set_aspect("equal", adjustable="datalim")
    true = diagram_of(run.true_distances(result.points.encounter))
    limit = 0.55 * float(result.diameter)
    part = result.components[0].intervals
    drawing.draw_diagrams(diagram, (part[0], part[1]), true, limit=limit, names=("map", "truth"))
    drawing.mark_holes(diagram, np.array([(hole.birth, hole.death) for hole in result.holes]).reshape(-1, 2))
    diagram.set(title=f"{name}: diagram", xlabel="birth", ylabel="death (never: at the top)")


def _draw_shares(axes: "Axes", ratios: dict[str, list[float]], *, title: str) -> None:
    """Draw for each way the share of its runs whose ratio is no larger."""
    for name, values in ratios.items():
        ordered = np.sort(values)
        axes.step(ordered, np.arange(1, len(ordered) + 1) / max(1, len(ordered)), where="post", color=_COLOURS[name], label=name)
    limits = drawing.whole_decades(np.concatenate([values for values in ratios.values() if values] or [[1.0]]))
    counts = ", ".join(str(len(values)) for values in ratios.values())
    axes.set(
        title=f"{title}\n(runs: {counts})",
        xscale="log",
        xlim=limits,
        xlabel="signal-to-noise ratio of a run",
        ylabel="share of runs at or below it",
        ylim=(0, 1.02),
    )
    axes.grid(visible=True, alpha=0.3)


EXPERIMENT = Experiment(name="subsampling", about="signal to noise of maxmin and KNN-maxmin, one obstacle", run=run_subsampling)

if __name__ == "__main__":
    sys.exit(
        perform_main([EXPERIMENT], None, prog="python -m studies.paper.subsampling", about="Maxmin against KNN-maxmin, by signal to noise.")
    )
