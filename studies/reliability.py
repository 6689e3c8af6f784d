"""Reliability diagrams: how often what was told with a probability was so."""

import io
from collections.abc import Mapping
from itertools import pairwise

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mapper.types import BoolArray, FloatArray

_N_BINS = 10
_BLUE, _GREY = "#0072b2", "#999999"  # Wong 2011


def draw_reliability(panels: Mapping[str, tuple[FloatArray, BoolArray]], *, image_format: str) -> bytes:
    """Draw one panel for each kind of event.

    Parameters
    ----------
    panels
        Title to probabilities and whether each event was so, shape (n,) each.

    Notes
    -----
    Points are bins of a tenth; bars are two standard errors of the share, and numbers how many events are in the bin.
    """
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "biobot", "svg.fonttype": "none"}):
        figure = Figure(figsize=(5.2 * len(panels), 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        for axes, (title, (chance, is_so)) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
            axes.plot([0, 1], [0, 1], color=_GREY, linewidth=0.8)
            for low, high in pairwise(np.linspace(0.0, 1.0, _N_BINS + 1)):
                inside = (chance >= low) & ((chance < high) | (high == 1.0))
                n = int(inside.sum())
                if n == 0:
                    continue
                told, share = float(chance[inside].mean()), float(is_so[inside].mean())
                error = 2.0 * np.sqrt(max(share * (1.0 - share), 0.25 / n) / n)
                axes.errorbar(told, share, yerr=error, fmt="o", color=_BLUE, capsize=3, markersize=5)
                axes.annotate(str(n), (told, share), xytext=(7, -11), textcoords="offset points", fontsize=8, color=_GREY)
            axes.set(title=title, xlabel="probability told", ylabel="share that was so", xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
            axes.set_aspect("equal")
        figure.savefig(buffer, format=image_format, dpi=120, metadata={"Date": None} if image_format == "svg" else None)
    return buffer.getvalue()
