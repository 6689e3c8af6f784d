"""When backpacks fail: lost, or with a flat battery; drawn for each before the run begins."""

import numpy as np
from numpy.typing import NDArray

from simulator import draws
from simulator.motion import MotionParameters

_LOSS_STREAM = 20
_BATTERY_STREAM = 21

Floats = NDArray[np.float64]


def draw_failures(motion: MotionParameters, *, seed: int, keys: NDArray[np.uint64]) -> tuple[Floats, Floats]:
    """Draw when each backpack is lost, and when its battery is flat [s], shape (n,) each; inf for never."""
    first = np.zeros(keys.size, dtype=np.uint64)
    lost_s, flat_s = np.full(keys.size, np.inf), np.full(keys.size, np.inf)
    if motion.loss_hazard > 0.0:
        lost_s = draws.exponential(draws.words(seed=seed, biobot=keys, stream=_LOSS_STREAM, index=first)) / motion.loss_hazard
    if motion.battery_life_s is not None:
        share = draws.uniform(draws.words(seed=seed, biobot=keys, stream=_BATTERY_STREAM, index=first))
        flat_s = motion.battery_life_s * (1.0 + motion.battery_spread * (2.0 * share - 1.0))
    return lost_s, flat_s
