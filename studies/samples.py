"""Points spread over an arena, and how far they are apart: what persistence is tried on where the truth is known."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulator.arenas.arena import Arena

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_DRAWN_PER_POINT = 4


def sample_arena(arena: Arena, measure: Callable[[Arena, Floats], Floats], *, n_points: int, seed: int) -> tuple[Floats, Floats]:
    """Draw places all over an arena and keep some that are far from each other.

    Parameters
    ----------
    measure
        Makes of an arena and places, shape (n, 2) [length], the distances between them, shape (n, n) [length].

    Returns
    -------
    tuple of Floats
        Places, shape (n_points, 2), in the order in which they were chosen (``spread``), and distances, shape (n_points, n_points).
    """
    places = arena.draw_places(seed=seed, ids=np.arange(1, _DRAWN_PER_POINT * n_points + 1, dtype=np.uint64))
    distances = measure(arena, places)
    chosen = spread(distances, n_points=n_points)
    return places[chosen], distances[np.ix_(chosen, chosen)]


def measure_straight(_: Arena, places: Floats) -> Floats:
    """Measure through walls."""
    difference = places[:, None] - places
    return np.asarray(np.hypot(difference[..., 0], difference[..., 1]), dtype=np.float64)


def spread(distances: Floats, *, n_points: int) -> Indices:
    """Choose points one after the other, each furthest from those before (maxmin), the first being the first; shape (n_points,)."""
    chosen, nearest = [0], distances[0]
    while len(chosen) < n_points:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, distances[chosen[-1]])
    return np.array(chosen)
