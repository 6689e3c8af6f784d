"""Groups of what is joined, beside SciPy's connected components; and what a mapper does not import before it is wanted."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mapper.groups import label_groups
from mapper.types import IntArray


@st.composite
def joined(draw: st.DrawFn) -> tuple[int, IntArray]:
    """How many there are, and pairs of them, shape (2, k)."""
    n = draw(st.integers(1, 30))
    pairs = draw(st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=40))
    return n, np.array(pairs, dtype=np.int64).reshape(-1, 2).T


def _by_scipy(pairs: IntArray, *, n: int) -> IntArray:
    graph = coo_array((np.ones(pairs.shape[1], dtype=np.int8), (pairs[0], pairs[1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


@given(joined())
def test_groups_are_the_connected_components_in_order_of_their_lowest_members(case: tuple[int, IntArray]) -> None:
    n, pairs = case
    assert np.array_equal(label_groups(pairs[0], pairs[1], n=n), _by_scipy(pairs, n=n))


@pytest.mark.parametrize("is_shuffled", [False, True])
def test_a_long_chain_is_one_group(is_shuffled: bool) -> None:
    """However it is numbered: 10,000 members, each joined to the next."""
    order = np.arange(10_000)
    if is_shuffled:
        order = np.random.default_rng(1).permutation(order)
    assert not label_groups(order[:-1], order[1:], n=10_000).any()


def test_nobody_is_in_no_group() -> None:
    nothing = np.zeros(0, dtype=np.int64)
    assert label_groups(nothing, nothing, n=0).shape == (0,)


@pytest.mark.parametrize("module", ["mapper.service", "mapper.pipeline", "mapper.route_command"])
def test_no_mapper_imports_scipy_before_a_map_wants_it(module: str) -> None:
    """To import it takes nearly as long as to import all else of a mapper: whoever starts one need not wait for it."""
    script = f"import sys, {module}; print(sorted(name for name in sys.modules if name.partition('.')[0] in ('scipy', 'matplotlib')))"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "[]\n"
