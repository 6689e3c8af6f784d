"""Libraries that pair the edges of a Rips filtration, behind one call; whichever it is, the answer is the same."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from mapper.errors import EngineMissingError
from mapper.filtration import Filtration
from mapper.types import FloatArray, IntArray

# Single precision holds every whole number up to here.
_EXACT_IN_SINGLE = 1 << 24


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """Persistence over Z/2 in ranks of edges, in no particular order.

    ``merges``, shape (m - 1,): ranks of the edges that join two components. ``loops``, shape (k, 2): ranks of the edge that closes a
    loop and of the longest edge of the triangle that fills it; loops that one edge both closes and fills are left out.
    """

    merges: IntArray
    loops: IntArray


Engine = Callable[[Filtration], Pairs]
"""Pairs the edges of a filtration."""


def choose_engine() -> Engine:
    """Take the fastest engine that is installed: redzed-tda, then holos-tda.

    Raises
    ------
    EngineMissingError
        Neither is installed.
    """
    try:
        import redzed_tda  # noqa: F401, PLC0415  # no wheel for every platform: the mapper must start without it
    except ImportError:
        pass
    else:
        return pair_by_redzed
    try:
        import holos_tda  # noqa: F401, PLC0415  # same
    except ImportError as error:
        raise EngineMissingError(
            library="holos-tda", needed_for="persistence", next_step="pip install holos-tda, or redzed-tda where it has a wheel"
        ) from error
    return pair_by_holos


def name_engine() -> str:
    """Name the engine that is taken, with its version.

    Raises
    ------
    EngineMissingError
        None is installed.
    """
    library = "redzed-tda" if choose_engine() is pair_by_redzed else "holos-tda"
    return f"{library} {version(library)}"


def pair_by_redzed(filtration: Filtration) -> Pairs:
    """Pair by redzed-tda [KK26]. It counts in single precision.

    Raises
    ------
    ValueError
        There are more edges than single precision can number.
    """
    import redzed_tda  # noqa: PLC0415  # no wheel for every platform

    if filtration.n_edges >= _EXACT_IN_SINGLE:
        raise ValueError(f"{filtration.n_edges} edges; redzed-tda can number {_EXACT_IN_SINGLE - 1}; use pair_by_holos or fewer points")
    by_dimension = redzed_tda.rips(filtration.ranks, maxdim=1, threshold=filtration.n_edges)
    merges, loops = (np.asarray(found, dtype=np.float64) for found in by_dimension)
    return Pairs(merges=merges[np.isfinite(merges[:, 1]), 1].astype(np.int64), loops=loops.astype(np.int64))


def pair_by_holos(filtration: Filtration) -> Pairs:
    """Pair by holos-tda. It counts in double precision and has wheels for Linux on ARM."""
    import holos_tda  # noqa: PLC0415  # either engine will do

    condensed = filtration.ranks.T[np.triu_indices(len(filtration.ranks), 1)].tolist()
    bars: FloatArray = np.array(holos_tda.rips_condensed(condensed, max_dim=1, threshold=float(filtration.n_edges)), dtype=np.float64)
    finite = bars[np.isfinite(bars[:, 2])].astype(np.int64)
    return Pairs(merges=finite[finite[:, 0] == 0, 2], loops=finite[finite[:, 0] == 1, 1:])
