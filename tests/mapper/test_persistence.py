"""Every engine, GUDHI and a literal reduction of the boundary matrix give the same diagram, whatever ties there are."""

import importlib.util
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given

from mapper.filtration import order_edges
from mapper.persistence import Diagram, rips_persistence
from mapper.rips_engines import Engine, choose_engine, pair_by_holos, pair_by_redzed
from mapper.types import FloatArray
from tests.mapper.distance_matrices import matrices

ENGINES = [
    engine
    for engine, module in ((pair_by_redzed, "redzed_tda"), (pair_by_holos, "holos_tda"))
    if importlib.util.find_spec(module) is not None
]


def _literal_persistence(distances: FloatArray) -> tuple[list[tuple[float, float]], list[tuple[float, float, tuple[int, ...]]]]:
    """Reduce the whole boundary matrix over Z/2, simplices by length, then dimension, then points.

    Returns bars of dimension 0, and of dimension 1 with the edge that gave birth to each, in ascending order.
    """
    m = len(distances)
    simplices = [simplex for size in (1, 2, 3) for simplex in combinations(range(m), size)]
    length = {simplex: max((float(distances[i, j]) for i, j in combinations(simplex, 2)), default=0.0) for simplex in simplices}
    # Edges of one length enter by larger, then smaller point; a triangle follows the last of its edges.
    place = {edge: k for k, edge in enumerate(sorted(combinations(range(m), 2), key=lambda e: (length[e], e[1], e[0])))}
    entry = {simplex: max((place[edge] for edge in combinations(simplex, 2)), default=-1) for simplex in simplices}
    order = sorted(simplices, key=lambda simplex: (entry[simplex], len(simplex), simplex))
    column_of: dict[tuple[int, ...], set[tuple[int, ...]]] = {}
    paired: dict[tuple[int, ...], tuple[int, ...]] = {}
    at = {simplex: k for k, simplex in enumerate(order)}
    for simplex in order:
        column = set(combinations(simplex, len(simplex) - 1)) if len(simplex) > 1 else set()
        while column and (lowest := max(column, key=at.__getitem__)) in column_of:
            column ^= column_of[lowest]
        if column:
            column_of[lowest] = column
            paired[lowest] = simplex
    bars = [[(length[a], length[b], a) for a, b in paired.items() if len(a) == size and length[b] > length[a]] for size in (1, 2)]
    return sorted((birth, death) for birth, death, _ in bars[0]), sorted(bars[1])


def _assert_equal(one: Diagram, other: Diagram) -> None:
    for k in (0, 1):
        assert np.array_equal(one.intervals[k], other.intervals[k])
    assert np.array_equal(one.birth_edges, other.birth_edges)
    assert np.array_equal(one.loop_ranks, other.loop_ranks)


@given(matrices(most=9))
@pytest.mark.parametrize("engine", ENGINES)
def test_persistence_is_that_of_the_reduced_boundary_matrix(engine: Engine, distances: FloatArray) -> None:
    diagram = rips_persistence(distances, engine=engine)
    merges, loops = _literal_persistence(distances)
    assert diagram.intervals[0][0].tolist() == [0.0, np.inf]
    assert sorted(map(tuple, diagram.intervals[0][1:].tolist())) == merges
    rows = zip(diagram.intervals[1].tolist(), diagram.birth_edges.tolist(), strict=True)
    assert sorted((birth, death, tuple(edge)) for (birth, death), edge in rows) == loops


@given(matrices())
def test_all_engines_give_the_same_diagram(distances: FloatArray) -> None:
    first, *others = (rips_persistence(distances, engine=engine) for engine in ENGINES)
    for other in others:
        _assert_equal(first, other)


@given(matrices())
def test_numbering_the_edges_changes_no_interval(distances: FloatArray) -> None:
    """GUDHI is given the distances as they are."""
    gudhi = pytest.importorskip("gudhi")
    tree = gudhi.RipsComplex(distance_matrix=distances).create_simplex_tree(max_dimension=2)
    tree.compute_persistence(homology_coeff_field=2, min_persistence=0.0, persistence_dim_max=True)
    diagram = rips_persistence(distances)
    for k in (0, 1):
        wanted = [bar for bar in tree.persistence_intervals_in_dimension(k).tolist() if bar[1] > bar[0]]
        assert sorted(diagram.intervals[k].tolist()) == sorted(wanted)


@given(matrices())
def test_every_edge_up_to_the_enclosing_radius_has_a_place_of_its_own(distances: FloatArray) -> None:
    filtration = order_edges(distances)
    radius = distances.max(axis=1).min()
    wanted = sorted((distances[i, j], i, j) for i in range(len(distances)) for j in range(i) if distances[i, j] <= radius)
    smaller, larger = filtration.ends(np.arange(1, filtration.n_edges + 1)).T
    assert list(zip(distances[larger, smaller].tolist(), larger.tolist(), smaller.tolist(), strict=True)) == wanted
    assert filtration.ranks[larger, smaller].tolist() == list(range(1, filtration.n_edges + 1))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1.0, 1e300])
def test_any_scale_will_do(engine: Engine, scale: float) -> None:
    square = np.array([[0, 1, 2, 1], [1, 0, 1, 2], [2, 1, 0, 1], [1, 2, 1, 0]]) * scale
    diagram = rips_persistence(square, engine=engine)
    assert diagram.intervals[1].tolist() == [[scale, 2 * scale]]
    assert diagram.birth_edges.tolist() == [[2, 3]]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("m", [1, 2, 3, 7])
def test_points_equally_far_apart_merge_at_once(engine: Engine, m: int) -> None:
    diagram = rips_persistence(1.0 - np.eye(m), engine=engine)
    assert diagram.intervals[0].tolist() == [[0.0, np.inf], *[[0.0, 1.0]] * (m - 1)]
    assert diagram.intervals[1].shape == (0, 2)


@pytest.mark.parametrize("engine", ENGINES)
def test_points_at_one_place_count_as_one(engine: Engine) -> None:
    at = np.array([0.0, 0.0, 0.0, 4.0])
    diagram = rips_persistence(np.abs(at[:, None] - at), engine=engine)
    assert diagram.intervals[0].tolist() == [[0.0, np.inf], [0.0, 4.0]]
    assert rips_persistence(np.zeros((3, 3)), engine=engine).intervals[0].tolist() == [[0.0, np.inf]]


def test_an_engine_is_found_here() -> None:
    assert choose_engine() in ENGINES
