"""Other programs that compute Rips persistence, each behind one call."""

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mapper.filtration import Filtration
from mapper.persistence import rips_persistence
from mapper.rips_engines import Pairs, pair_by_holos, pair_by_redzed
from studies import giotto_peer
from studies.truth import Floats, Intervals

Peer = Callable[[Floats], tuple[float, Intervals]]
"""Takes distances; returns the seconds that it took, and births and deaths, in no particular order, those without length may be there."""

_Computation = Callable[[Floats], Intervals]


@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """A peer that is not installed, and why."""

    reason: str


def find_peers() -> Mapping[str, Peer | Missing]:
    """Return our ways first, then the others: each ready to be called, or why it cannot be.

    Notes
    -----
    Every peer gets the enclosing radius where it does not find it by itself, and the field Z/2.
    """
    makers: dict[str, tuple[Callable[[], _Computation], str]] = {
        "ours, redzed-tda": (lambda: _ours("redzed_tda", pair_by_redzed), "no wheel of redzed-tda here"),
        "ours, holos-tda": (lambda: _ours("holos_tda", pair_by_holos), "holos-tda is not installed"),
        "GUDHI, edge collapse": (_gudhi_collapse, "gudhi is not installed"),
        "GUDHI, RipsPersistence": (_gudhi_sklearn, "gudhi and scikit-learn are not installed"),
        "ripser.py": (_ripser, "ripser is not installed"),
    }
    peers: dict[str, Peer | Missing] = {}
    for name, (make, reason) in makers.items():
        try:
            peers[name] = _timed(make())
        except ImportError as error:
            peers[name] = Missing(reason=f"{reason} ({error})")
    for name, n_threads in (("giotto-ph, 1 thread", 1), ("giotto-ph, 2 threads", 2)):
        if giotto_peer.is_installed():
            peers[name] = giotto_peer.GiottoProgram.start(n_threads=n_threads)
        else:
            peers[name] = Missing(reason="giotto-ph is not installed (it has no wheel after Python 3.12)")
    return peers


def find_dionysus() -> Mapping[str, Peer | Missing]:
    """Return the paper's library: up to the longest distance, as it is called most often, and up to the enclosing radius."""
    try:
        importlib.import_module("dionysus")
    except ImportError as error:
        return {"Dionysus": Missing(reason=f"dionysus is not installed ({error}); it is built from source with Boost 1.81 or later")}
    return {
        "Dionysus, all edges": _timed(lambda distances: _dionysus(distances, float(distances.max()))),
        "Dionysus, enclosing radius": _timed(lambda distances: _dionysus(distances, _enclosing_radius(distances))),
    }


def _timed(compute: _Computation) -> Peer:
    def call(distances: Floats) -> tuple[float, Intervals]:
        begin = time.perf_counter()
        intervals = compute(distances)
        return time.perf_counter() - begin, intervals

    return call


def _ours(module: str, engine: Callable[[Filtration], Pairs]) -> _Computation:
    importlib.import_module(module)
    return lambda distances: rips_persistence(distances, engine=engine).intervals


def _gudhi_collapse() -> _Computation:
    gudhi = importlib.import_module("gudhi")

    def compute(distances: Floats) -> Intervals:
        complex_ = gudhi.RipsComplex(distance_matrix=distances, max_edge_length=_enclosing_radius(distances))
        tree = complex_.create_simplex_tree(max_dimension=1)
        tree.collapse_edges()
        tree.expansion(2)
        tree.compute_persistence(homology_coeff_field=2)
        return _bars(tree.persistence_intervals_in_dimension(0)), _bars(tree.persistence_intervals_in_dimension(1))

    return compute


def _gudhi_sklearn() -> _Computation:
    sklearn = importlib.import_module("gudhi.sklearn")
    rips = sklearn.RipsPersistence(homology_dimensions=[0, 1], input_type="full distance matrix", homology_coeff_field=2)

    def compute(distances: Floats) -> Intervals:
        merges, loops = rips.fit_transform([distances])[0]
        return _bars(merges), _bars(loops)

    return compute


def _ripser() -> _Computation:
    ripser = importlib.import_module("ripser")

    def compute(distances: Floats) -> Intervals:
        merges, loops = ripser.ripser(distances, distance_matrix=True, maxdim=1)["dgms"]
        return _bars(merges), _bars(loops)

    return compute


def _dionysus(distances: Floats, radius: float) -> Intervals:
    dionysus = importlib.import_module("dionysus")
    condensed = distances[np.triu_indices(len(distances), 1)].astype(np.float32)
    filtration = dionysus.fill_rips(condensed, 2, radius)
    diagrams = dionysus.init_diagrams(dionysus.homology_persistence(filtration), filtration)
    merges, loops = ([(point.birth, point.death) for point in diagram] for diagram in diagrams[:2])
    return _bars(merges), _bars(loops)


def _enclosing_radius(distances: Floats) -> float:
    return float(distances.max(axis=1).min())


def _bars(found: object) -> Floats:
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)
