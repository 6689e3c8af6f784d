"""Figures of lambda_3 and of bottleneck distances with their bounds, over the numbers of landmarks and of walkers."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from studies.paper import drawing
from studies.paper.bound_checks import BoundsRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Grid = Mapping[tuple[int, int], Sequence[BoundsRun]]
"""Runs by number of landmarks and number of walkers."""


def draw_inflation(grid: Grid, *, title: str) -> "Figure":
    """Draw the largest and the median lambda_3: left over N_l, right over N_m; a line for each value of the other."""
    figure, axes = drawing.new_figure(2, 2, size=(10.0, 7.0))
    for row, (name, label) in zip(axes, (("lambda_max", "largest"), ("lambda_median", "median")), strict=True):
        for k in (0, 1):
            fixed_name, moving_name = (("N_m", "N_l"), ("N_l", "N_m"))[k]
            for colour, fixed in zip(drawing.SERIES, _values(grid, 1 - k), strict=False):
                x = _values(grid, k)
                groups = [[getattr(run, name) for run in _at(grid, k, value, fixed)] for value in x]
                drawing.draw_spread(row[k], x, groups, label=f"{fixed_name} = {fixed}", colour=colour)
            row[k].set(title=f"{label} over pairs of landmarks", xlabel=_axis_name(moving_name), ylabel="lambda_3", xticks=_values(grid, k))
            row[k].axhline(0.0, color="black", linewidth=0.6)
            row[k].grid(visible=True, alpha=0.3)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower left", ncols=2, frameon=False)
    figure.legend(*axes[0][1].get_legend_handles_labels(), loc="outside lower right", ncols=2, frameon=False)
    figure.suptitle(f"{title}; mean and quartiles")
    return figure


def draw_bottlenecks(grid: Grid, *, title: str) -> "Figure":
    """Draw d_B in dimension 1 (dashed) with its bounds as published and as corrected (solid): left over N_l, right over N_m."""
    figure, axes = drawing.new_figure(2, 2, size=(10.5, 8.0))
    for row, (of, name) in zip(axes, (("e", "encounters: d_B(PD(M), PD(E))"), ("l", "landmarks: d_B(PD(M), PD(L))")), strict=True):
        for k in (0, 1):
            fixed_name, moving_name = (("N_m", "N_l"), ("N_l", "N_m"))[k]
            others = _values(grid, 1 - k)
            fixed = others[len(others) // 2]
            _draw_bounded(row[k], grid, k, fixed, of=of)
            row[k].set(
                title=f"{name},\n{fixed_name} = {fixed}",
                xlabel=_axis_name(moving_name),
                ylabel="d_B and bounds [1/50 of the side]",
                yscale="log",
                ylim=drawing.whole_decades(row[k].dataLim.intervaly),
                xticks=_values(grid, k),
            )
            row[k].grid(visible=True, which="both", alpha=0.25)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{title}; mean and quartiles")
    return figure


def _draw_bounded(axes: "Axes", grid: Grid, k: int, fixed: int, *, of: str) -> None:
    x = _values(grid, k)
    series = (
        (f"bottleneck_{of}_1", "d_B in H1", drawing.BLUE, True),
        (f"bottleneck_{of}_0", "d_B in H0", drawing.SKY, True),
        (f"published_{of}", "Theorem 3, published", drawing.ORANGE, False),
        (f"corrected_{of}", "Theorem 3, corrected", drawing.GREEN, False),
    )
    for name, label, colour, is_dashed in series:
        groups = [[getattr(run, name) for run in _at(grid, k, value, fixed)] for value in x]
        drawing.draw_spread(axes, x, groups, label=label, colour=colour, dashed=is_dashed)


def _at(grid: Grid, k: int, value: int, fixed: int) -> Sequence[BoundsRun]:
    return grid[(value, fixed) if k == 0 else (fixed, value)]


def _values(grid: Grid, k: int) -> list[int]:
    return sorted({key[k] for key in grid})


def _axis_name(name: str) -> str:
    return {"N_l": "number of landmarks N_l", "N_m": "number of walkers N_m"}[name]
