"""Distance matrices to try persistence on: with and without ties, metrics and others."""

import numpy as np
from hypothesis import strategies as st
from scipy.sparse.csgraph import shortest_path

from mapper.types import FloatArray


def _mirrored(above: FloatArray) -> FloatArray:
    above = np.triu(above, 1)
    return above + above.T


def _draw(kind: str, m: int, rng: np.random.Generator) -> FloatArray:
    if kind == "no metric":
        return _mirrored(rng.uniform(0.1, 9.0, (m, m)))
    if kind == "ties":
        return _mirrored(rng.integers(1, 6, (m, m)).astype(np.float64))
    if kind == "nearly equal":
        return _mirrored(1.0 + np.spacing(1.0) * rng.integers(0, 9, (m, m)))
    if kind == "grid":
        points = rng.permutation(49)[:m]
        return np.asarray(np.hypot(*(np.subtract.outer(at, at) for at in (points // 7, points % 7))), dtype=np.float64)
    # As between encounters: shortest paths in a sparse graph of whole ticks, in units of length.
    is_joined = (rng.random((m, m)) < 3.0 / m) | np.eye(m, k=1, dtype=bool)
    return np.asarray(shortest_path(np.where(is_joined, rng.integers(1, 40, (m, m)), 0), directed=False)) / 7.3


@st.composite
def matrices(draw: st.DrawFn, most: int = 40) -> FloatArray:
    kind = draw(st.sampled_from(["no metric", "ties", "nearly equal", "grid", "encounters"]))
    return _draw(kind, draw(st.integers(1, most)), np.random.default_rng(draw(st.integers(0, 2**32))))
