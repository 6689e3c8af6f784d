"""Place a subsample in the plane: classical multidimensional scaling."""

from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from threadpoolctl import ThreadpoolController

from mapper.types import FloatArray

_LIBRARIES = ThreadpoolController()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Embedding:
    """Plane coordinates, shape (m, 2), in the unit of the distances, and the share of the spectrum that two axes cannot hold."""

    coordinates: FloatArray
    lost_spectrum: float


def embed_in_plane(distances: FloatArray) -> Embedding:
    """Find plane coordinates whose distances are near the given ones.

    Parameters
    ----------
    distances
        Shape (m, m), symmetric, finite, zero diagonal; m at least 1.

    Returns
    -------
    Embedding
        ``lost_spectrum`` is 1 less the two leading positive eigenvalues over the sum of the magnitudes of all; 0 for a flat set.

    Notes
    -----
    Negative eigenvalues are clipped at zero, so a set on a line, or a single point, gets finite coordinates. An axis points to the side
    of its largest coordinate (the earliest of equals); which of a map and its mirror image is meant, distances cannot tell.

    References
    ----------
    Torgerson 1952; double centring as in [Dir16] IV.A.
    """
    m = len(distances)
    squared = distances**2
    row = squared.mean(axis=1)
    gram = -0.5 * (squared - row[:, None] - row[None, :] + squared.mean())
    with one_thread():
        values, vectors = np.linalg.eigh(gram)
    values, vectors = values[::-1], vectors[:, ::-1]
    leading = np.clip(values[:2], 0.0, None)
    coordinates = np.zeros((m, 2))
    coordinates[:, : len(leading)] = vectors[:, :2] * np.sqrt(leading)
    coordinates = _fix_signs(coordinates)
    total = float(np.abs(values).sum())
    return Embedding(coordinates=coordinates, lost_spectrum=1.0 - float(leading.sum()) / total if total > 0 else 0.0)


def turn_to_axes(places: FloatArray) -> FloatArray:
    """Move and turn a picture, shape (m, 2), so that its centre is at zero and it is longest along x; signs are as in `embed_in_plane`."""
    centred = places - places.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    return _fix_signs(centred @ axes[:, ::-1])


def one_thread() -> AbstractContextManager[object]:
    """Keep linear algebra in this thread.

    Notes
    -----
    Matrices of a few hundred rows gain nothing from more threads, and threads that wait for each other beside a busy gateway lose
    much: 0.7 s in place of 13 ms for 150 rows on two busy cores (measured).
    """
    limited: AbstractContextManager[object] = _LIBRARIES.limit(limits=1, user_api="blas")
    return limited


def _fix_signs(coordinates: FloatArray) -> FloatArray:
    strongest = coordinates[np.abs(coordinates).argmax(axis=0), [0, 1]]
    return np.asarray(coordinates * np.where(strongest < 0, -1.0, 1.0))
