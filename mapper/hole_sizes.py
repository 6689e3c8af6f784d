"""How large a hole is: perimeter and area of what stands in it, with their errors, from the loop around it.

What is measured is the shortest closed way around an obstacle: its length is the *perimeter*, what it encloses the *area*. Of a convex
obstacle they are the obstacle's own. Of another they are those of its hull, for nobody walks into a recess to get around.

A loop of drawn points lies further out than that, because the points keep a sampling distance from the obstacle, so it overstates both.
The scale at which the loop is filled, its death, does so far less: a loop of length P is filled at P / 3, whatever is sampled of it.
The rule here starts from that, corrects it by what else is known, and takes the form from the outline. Its numbers are trained.
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources
from math import exp, log, pi, sqrt

import msgspec
import numpy as np

from firmware_protocol.first_use import prepare
from mapper.types import FloatArray, Method, MetricKind

LIMITED = ("slack", "backing")
"""The features of `LoopMeasures` that correct a size; beyond what was seen in training they count as at its end."""

_LEAST_ROUNDNESS, _MOST_ROUNDNESS = 0.02, 1.0
_MOST_LOG_ERROR = 1.0  # an error as large as what is measured times e: nobody should read more into it


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopMeasures:
    """What a map tells of one hole; lengths are in the unit of the map.

    Parameters
    ----------
    birth, death
        Of its interval.
    loop_length
        Sum of the map's distances between neighbours on the outline.
    drawn_length, drawn_area
        Of the outline as it is drawn, made simple.
    encounters_per_point
        Encounters used for the component over points drawn.
    encounters_about
        Encounters to be expected in a square as wide as the hole's death, if all are spread evenly over one as wide as the diameter.
    """

    birth: float
    death: float
    loop_length: float
    drawn_length: float
    drawn_area: float
    encounters_per_point: float
    encounters_about: float

    @property
    def slack(self) -> float:
        """Logarithm of the loop's length over three times the death: how much longer the outline is than what fills it."""
        return log(self.loop_length / (3.0 * self.death))

    @property
    def backing(self) -> float:
        """Logarithm of the encounters per point."""
        return log(max(self.encounters_per_point, 1.0))

    @property
    def spacing(self) -> float:
        """Longest step that the loop needs, over the scale at which it is filled: 0 for dense points, 1 for points that show nothing."""
        return self.birth / self.death

    @property
    def scatter(self) -> float:
        """Relative error of a mean over the encounters about the hole, were they independent."""
        return 1.0 / sqrt(max(self.encounters_about, 1.0))

    @property
    def roundness(self) -> float:
        """Area times 4 pi over the squared length, of the outline as drawn: 1 for a disc."""
        return min(max(4.0 * pi * self.drawn_area / self.drawn_length**2, _LEAST_ROUNDNESS), _MOST_ROUNDNESS)


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeModel:
    """Trained numbers, for one method and metric.

    ``perimeter`` are the intercept and the weights of ``slack`` and ``backing`` in ``log(perimeter / (3 death))``; ``area`` are the
    intercept and the weights of the logarithm of the drawn roundness in ``log(roundness)``. ``limits`` are the least and greatest of
    ``slack`` and ``backing`` seen in training. ``perimeter_variance`` and ``area_variance`` are weights, not negative, of 1,
    ``spacing^2`` and ``scatter^2`` in the variance of the logarithms.
    """

    perimeter: tuple[float, float, float]
    area: tuple[float, float]
    limits: tuple[tuple[float, float], tuple[float, float]]
    perimeter_variance: tuple[float, float, float]
    area_variance: tuple[float, float, float]


prepare(SizeModel)


@dataclass(frozen=True, slots=True, kw_only=True)
class HoleSize:
    """Perimeter [length] and area [length^2] of what stands in a hole, each with its standard error in the same unit."""

    perimeter: float
    perimeter_error: float
    area: float
    area_error: float


def load_size_model(method: Method, metric: MetricKind) -> SizeModel | None:
    """Read the numbers that the package ships for one method and metric; None where there are none."""
    return _load_models().get(f"{method}/{metric}")


def estimate_size(loop: LoopMeasures, model: SizeModel) -> HoleSize:
    """Estimate the size of a hole.

    Notes
    -----
    Errors are relative ones of the logarithm times the value: about two in three true values are within one error, if the run is like
    those of training (docs/geometry.md). The walking speed and the scale of the map are taken to be right.
    """
    features = correction_features(loop, model.limits)
    perimeter = 3.0 * loop.death * exp(float(features @ model.perimeter))
    area = perimeter**2 / (4.0 * pi) * exp(float(np.array([1.0, log(loop.roundness)]) @ model.area))
    area = min(area, perimeter**2 / (4.0 * pi))  # no figure of this perimeter has more: the isoperimetric inequality
    sources = error_sources(loop)
    errors = [min(sqrt(float(sources @ variance)), _MOST_LOG_ERROR) for variance in (model.perimeter_variance, model.area_variance)]
    return HoleSize(perimeter=perimeter, perimeter_error=errors[0] * perimeter, area=area, area_error=errors[1] * area)


def correction_features(loop: LoopMeasures, limits: tuple[tuple[float, float], tuple[float, float]]) -> FloatArray:
    """Return 1 and the features that correct the perimeter, within limits: shape (3,)."""
    values = [float(getattr(loop, name)) for name in LIMITED]
    return np.array([1.0, *(min(max(value, least), most) for value, (least, most) in zip(values, limits, strict=True))])


def error_sources(loop: LoopMeasures) -> FloatArray:
    """Return what the variance of a logarithm is made of: 1, the squared spacing and the squared scatter, shape (3,)."""
    return np.array([1.0, loop.spacing**2, loop.scatter**2])


@cache
def _load_models() -> dict[str, SizeModel]:
    content = resources.files("mapper").joinpath("data", "hole_sizes.json").read_bytes()
    return msgspec.json.decode(content, type=dict[str, SizeModel])
