"""Bracketed landmark profiles: bounds from both sides on how far each encounter is from every landmark.

A shortest path in time can only overstate a distance, because nobody has to have gone straight from here to there. What two landmarks
know of each other bounds it from below: ``d(i, k) >= d(k, m) - d(i, m)`` for any third place m. The middle of the two bounds is a much
better estimate than the path, and their gap says how far the estimate can be trusted.
"""

from dataclasses import dataclass

import numpy as np

from mapper.kernels import Kernels
from mapper.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProfileBracket:
    """Where v vertices are, by their distances to l reference places.

    ``middle`` [ticks], shape (v, l): half way between the bounds. ``doubt`` [ticks], shape (v,): half the gap between them, its
    median over the references; 0 at a reference itself.
    """

    middle: FloatArray
    doubt: FloatArray


def bracket_profiles(times: FloatArray, references: IntArray, *, kernels: Kernels) -> ProfileBracket:
    """Take the middle of the upper and lower bound of every distance to a reference.

    Parameters
    ----------
    times
        Shortest-path time from each vertex to each reference [ticks], shape (v, l), finite: the upper bounds. It may be overwritten.
    references
        The vertices that the columns of ``times`` belong to, shape (l,).

    Notes
    -----
    The lower bound is ``max_m d(k, m) - d(i, m)`` over the references m other than k. The triangle inequality keeps it below the upper
    one. Both move by no more than the encounter metric between two vertices does, and so does their middle. With one
    reference there is no lower bound and the upper one is taken.
    """
    middle, doubt = kernels.bracket(times, references)
    return ProfileBracket(middle=middle, doubt=doubt)


def keep_well_bracketed(bracket: ProfileBracket, *, q: float) -> BoolArray:
    """Say which vertices to keep: those whose doubt is within its q-quantile over the vertices.

    Returns
    -------
    BoolArray
        Shape (v,); at least one is True.

    Notes
    -----
    Dropping what lies far from its neighbours, as [Dir16] does, empties the narrow passages where few biobots meet, and with them
    the proof that a hole is surrounded. A wide gap between bounds marks an encounter that is badly located, wherever it is.
    """
    return np.asarray(bracket.doubt <= np.quantile(bracket.doubt, q))


def thin_out(kept: BoolArray, *, limit: int) -> BoolArray:
    """Take no more than ``limit`` of the vertices that are kept, evenly in the order of their first encounters; 0 takes all.

    Parameters
    ----------
    kept
        Shape (v,), in the order of first encounters.

    Returns
    -------
    BoolArray
        Shape (v,); as many are True as are kept, or ``limit`` where that is fewer.

    Notes
    -----
    A share of the time is a share of every place, as all insects walk all the time. More candidates do not make a better map
    (docs/accuracy.md): the errors of encounters that share a path are alike, and no mean over a place takes them away.
    """
    rows = np.flatnonzero(kept)
    if limit == 0 or len(rows) <= limit:
        return kept
    thinned = np.zeros_like(kept)
    thinned[rows[np.arange(limit) * len(rows) // limit]] = True
    return thinned


def smooth_profiles(profiles: FloatArray, *, n_neighbours: int, n_passes: int = 1, kernels: Kernels) -> FloatArray:
    """Replace every profile by the mean of itself and those nearest to it (Euclidean, ties to the earlier), again and again.

    Parameters
    ----------
    profiles
        Shape (c, l).
    n_neighbours
        How many are averaged with each; 0 changes nothing.
    n_passes
        How often.

    Notes
    -----
    Furthest-point sampling picks the worst errors first, and the more encounters there are the worse the worst. Averaging over a fixed
    share of the encounters, that is over a fixed area, undoes that. In the first pass errors hide who is near; in the next, neighbours
    are better chosen. So several means over few take more error away, and less of the shape, than one over many (docs/method.md).
    """
    n_neighbours = min(n_neighbours, len(profiles) - 1)
    for _ in range(n_passes if n_neighbours >= 1 else 0):
        profiles = kernels.average_nearest(profiles, n_nearest=n_neighbours + 1)
    return profiles
