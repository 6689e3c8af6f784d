"""Lengths between all points of a map in few bytes, for a page that draws the complex at a scale of the operator's choice."""

import numpy as np

from mapper.types import FloatArray, MapResult

WHOLE = 65535
"""What stands for the diameter of the map."""


def encode_lengths(result: MapResult) -> bytes:
    """Return the lengths between points as shares of the map's diameter, as unsigned numbers of 16 bits, little-endian.

    Returns
    -------
    bytes
        For each component in its order the upper triangle of its matrix, row by row, without the diagonal; its points are in the order of
        ``MapResult.points``. A share is wrong by no more than 1 / 131,070.
    """
    parts = [_condense(part.distances) for part in result.components]
    shares = np.rint(np.concatenate(parts) / (result.diameter or 1.0) * WHOLE)
    return shares.clip(0, WHOLE).astype("<u2").tobytes()


def _condense(distances: FloatArray) -> FloatArray:
    condensed: FloatArray = distances[np.triu_indices(len(distances), k=1)]
    return condensed
