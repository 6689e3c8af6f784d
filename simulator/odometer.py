"""How far each insect has walked, as its backpack's inertial unit measures it: the true path, with an error of scale. No clock.

Steps of a walk are as long as the world's: between two of them an insect is taken to move straight. An inertial unit counts strides and is
wrong by a factor that stays with the insect, drawn evenly within ``SCALE_ERROR`` of 1: an assumption, for nobody has published one on an
insect of this size.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence

import numpy as np

from firmware_protocol.units import NodeId
from simulator import chance
from simulator.legs import Floats

SCALE_ERROR = 0.1

_SCALE_STREAM = 203
_MAX_STEPS = 128
"""Steps of the world that can be looked back on: 6 s and more."""


class Odometer:
    """See the module.

    Parameters
    ----------
    places
        Where all are at first, shape (n, 2) [length], in the order of ``nodes``.
    mm_per_unit
        The unit of length [mm].
    """

    def __init__(self, nodes: Sequence[NodeId], *, places: Floats, mm_per_unit: float, seed: int) -> None:
        self._row = {node: row for row, node in enumerate(nodes)}
        draws = [chance.uniform(seed=seed, biobot=node, stream=_SCALE_STREAM, index=0) for node in nodes]
        self._mm_per_unit = mm_per_unit * (1.0 + SCALE_ERROR * (2.0 * np.array(draws) - 1.0))
        self._places = places
        self._steps: deque[tuple[int, Floats]] = deque([(0, np.zeros(len(nodes)))], maxlen=_MAX_STEPS)

    def advance(self, places: Floats, *, at_ns: int) -> None:
        """Note where all are at ``at_ns``, later than any instant before."""
        walked = np.hypot(*(places - self._places).T) * self._mm_per_unit
        self._steps.append((at_ns, self._steps[-1][1] + walked))
        self._places = places

    def read_mm(self, node: NodeId, at_ns: int) -> float:
        """Return what a biobot has walked by then [mm]; for an instant before or after all that is remembered, by the nearest one."""
        row = self._row[node]
        instants = [step_ns for step_ns, _ in self._steps]
        after = bisect_right(instants, at_ns)
        if after in {0, len(instants)}:
            return float(self._steps[min(after, len(instants) - 1)][1][row])
        (before_ns, before), (after_ns, later) = self._steps[after - 1], self._steps[after]
        share = (at_ns - before_ns) / (after_ns - before_ns)
        return float(before[row] + share * (later[row] - before[row]))
