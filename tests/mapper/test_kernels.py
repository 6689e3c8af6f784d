"""The kernels by themselves, at the ends of what they may be given; every kind must give the same, to the bit.

`scripts/check_kernels.py` runs these once more on libraries that watch every access to memory.
"""

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mapper.errors import TooManyEncountersError
from mapper.kernels import Contraction, Kernels, Picks, Stands
from mapper.types import FloatArray, IntArray, ProfileNorm
from tests.mapper.graphs import KERNELS

COMPILED = KERNELS[0]

Sightings = tuple[IntArray, IntArray, IntArray]


@st.composite
def sightings(draw: st.DrawFn) -> Sightings:
    """Centres in no order, with ties, at times as far apart as there may be; biobots in several crowds, with any number as id."""
    n = draw(st.integers(0, 40))
    last = draw(st.sampled_from([0, 3, 40, 2**52]))
    ids = draw(
        st.lists(
            st.integers(-(2**63), 2**63 - 1) | st.integers(1, 4) | st.sampled_from([-(2**63), 2**63 - 1]),
            min_size=2,
            max_size=12,
            unique=True,
        )
    )
    centres = draw(st.lists(st.integers(0, last), min_size=n, max_size=n))
    pairs = draw(st.lists(st.lists(st.sampled_from(ids), min_size=2, max_size=2, unique=True).map(sorted), min_size=n, max_size=n))
    columns = np.array(pairs, dtype=np.int64).reshape(n, 2)
    return np.array(centres, dtype=np.int64), columns[:, 0], columns[:, 1]


@st.composite
def stands(draw: st.DrawFn) -> Stands:
    """Spells of some biobots, some of which are in no encounter; a biobot's are disjoint, and may be instants."""
    rows = []
    for node in sorted(draw(st.sets(st.integers(0, 5) | st.sampled_from([-(2**63), 2**63 - 1]), max_size=4))):
        instants = sorted(draw(st.sets(st.integers(0, 45), max_size=6)))
        rows += [(node, begin, end - draw(st.integers(0, 1))) for begin, end in pairwise(instants) if draw(st.booleans())]
    columns = np.array([row for row in rows if row[1] <= row[2]], dtype=np.int64).reshape(-1, 3)
    apart = np.ones(len(columns), dtype=bool)
    apart[1:] = (columns[1:, 0] != columns[:-1, 0]) | (columns[1:, 1] > columns[:-1, 2])
    return Stands(nodes=columns[apart, 0], begins=columns[apart, 1], ends=columns[apart, 2])


@st.composite
def contractions(draw: st.DrawFn) -> Contraction:
    centres, id1, id2 = draw(sightings())
    commanded = draw(stands())
    return COMPILED.contract(centres, id1, id2, still=commanded, commanded=commanded, moving_time=draw(st.booleans()))


def _arrays(thing: object) -> dict[str, NDArray[np.generic]]:
    """All arrays of a dataclass of arrays and of such dataclasses."""
    found: dict[str, NDArray[np.generic]] = {}
    for field in fields(thing):  # type: ignore[arg-type]  # of any dataclass
        value = getattr(thing, field.name)
        found |= {field.name: value} if isinstance(value, np.ndarray) else {f"{field.name}.{k}": v for k, v in _arrays(value).items()}
    return found


def _assert_same_picks(one: Picks, other: Picks) -> None:
    assert np.array_equal(one.chosen, other.chosen)
    assert one.distances.shape == (len(one.chosen), len(one.chosen))
    assert np.array_equal(one.distances, other.distances)
    assert one.cover_radius == other.cover_radius


@given(sightings(), stands(), stands(), st.booleans())
def test_every_kind_of_kernels_makes_the_same_graph(seen: Sightings, still: Stands, commanded: Stands, moving_time: bool) -> None:
    one, other = (_arrays(kernels.contract(*seen, still=still, commanded=commanded, moving_time=moving_time)) for kernels in KERNELS)
    assert one.keys() == other.keys()
    for name, array in one.items():
        assert array.dtype == other[name].dtype, name
        assert np.array_equal(array, other[name]), name


@given(contractions(), st.data())
def test_sweeps_from_any_vertices_even_the_same_twice_agree(graph: Contraction, data: st.DataObject) -> None:
    v = len(graph.component)
    sources = np.array(data.draw(st.lists(st.integers(0, v - 1), max_size=9)) if v else [], dtype=np.int64)
    one, other = (kernels.sweep_times(graph.links, n_vertices=v, sources=sources) for kernels in KERNELS)
    assert one.shape == (v, len(sources))
    assert np.array_equal(one, other)


@given(contractions(), st.sampled_from([0, 1, 2, 5, 39, 40, 2**62]))
def test_any_number_of_neighbours_may_be_asked_for(graph: Contraction, k: int) -> None:
    one, other = (kernels.sum_neighbour_times(graph.rows, graph.multiplicity, k=k) for kernels in KERNELS)
    assert one.shape == (len(graph.component),)
    assert np.array_equal(one, other)


@given(contractions(), st.data(), st.integers(0, 60))
def test_maxmin_needs_neither_a_connected_graph_nor_enough_vertices(graph: Contraction, data: st.DataObject, n_points: int) -> None:
    v = len(graph.component)
    candidates = np.array(data.draw(st.lists(st.booleans(), min_size=v, max_size=v)), dtype=bool)
    hubs = np.array(sorted(data.draw(st.sets(st.integers(0, v - 1), max_size=6)) if v else []), dtype=np.int64)
    one, other = (kernels.pick_along_graph(graph.rows, graph.links, candidates, hubs=hubs, n_points=n_points) for kernels in KERNELS)
    _assert_same_picks(one, other)
    assert candidates[one.chosen].all()


@pytest.mark.parametrize("kernels", KERNELS, ids=lambda kernels: kernels.name)
def test_of_no_candidates_none_is_picked_and_nothing_is_left_uncovered(kernels: Kernels) -> None:
    nobody = np.zeros(0, dtype=np.int64)
    graph = kernels.contract(
        np.array([5, 9]), np.array([1, 1]), np.array([2, 3]), still=Stands(nodes=nobody, begins=nobody, ends=nobody),
        commanded=Stands(nodes=nobody, begins=nobody, ends=nobody), moving_time=False,
    )  # fmt: skip
    none = np.zeros(2, dtype=bool)
    for picks in (
        kernels.pick_along_graph(graph.rows, graph.links, none, hubs=nobody, n_points=4),
        kernels.pick_profiles(np.zeros((0, 3)), norm=ProfileNorm.MAX, n_points=4),
    ):
        assert (len(picks.chosen), picks.distances.shape, picks.cover_radius) == (0, (0, 0), 0.0)


tables = st.builds(
    lambda n, n_places, seed, largest: np.random.default_rng(seed).integers(0, largest, (n, n_places)).astype(float),
    st.integers(1, 40),
    st.integers(1, 21),
    st.integers(0, 99),
    st.sampled_from([1, 3, 2**52]),
)


@given(tables, st.data())
def test_brackets_agree_for_any_number_of_places(times: FloatArray, data: st.DataObject) -> None:
    n, n_places = times.shape
    references = np.array(data.draw(st.lists(st.integers(0, n - 1), min_size=n_places, max_size=n_places)), dtype=np.int64)
    one, other = (kernels.bracket(times.copy(), references) for kernels in KERNELS)
    assert np.array_equal(one[0], other[0])
    assert np.array_equal(one[1], other[1])


@given(tables, st.sampled_from(ProfileNorm), st.integers(0, 60))
def test_more_profiles_than_there_are_cannot_be_picked(profiles: FloatArray, norm: ProfileNorm, n_points: int) -> None:
    one, other = (kernels.pick_profiles(profiles, norm=norm, n_points=n_points) for kernels in KERNELS)
    _assert_same_picks(one, other)
    assert len(one.chosen) <= min(n_points, len(profiles))


def test_more_encounters_than_can_be_numbered_are_refused_at_once() -> None:
    nobody = np.zeros(0, dtype=np.int64)
    none = Stands(nodes=nobody, begins=nobody, ends=nobody)
    # One number, shown as many times as there would be encounters: it takes no memory.
    many = np.broadcast_to(np.int64(7), (2**29,))
    with pytest.raises(TooManyEncountersError, match=r"536870912 encounters.*at most 536870911.*window"):
        COMPILED.contract(many, many, many, still=none, commanded=none, moving_time=False)
