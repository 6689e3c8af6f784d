"""The kernels in C: numpy arrays in, numpy arrays out. The interpreter lock is free while they run."""

import ctypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mapper.errors import TooManyEncountersError
from mapper.kernels.arrays import Contraction, Links, Picks, Rows, Stands, Tension, VertexArray
from mapper.kernels.binding import SPELL, Graph
from mapper.types import BoolArray, FloatArray, IntArray, KernelsKind, ProfileNorm

_NORM_NUMBERS: Final = {ProfileNorm.MAX: 0, ProfileNorm.RMS: 1}
# Fewer rows are not worth a second thread.
_ROWS_OF_A_THREAD: Final = 20_000
# So that twice as many, the biobots there may be, are still numbered in 32 bits when their table has doubled.
_MAX_ENCOUNTERS: Final = 2**29 - 1
# Of the trees of profiles; a search for one row costs as much as a hundred rows elsewhere.
_ROWS_OF_A_LEAF: Final = 16
_LEAVES_OF_A_THREAD: Final = 50
_ROWS_FOR_AXES: Final = 2_000
# As WIDTH in smoothing.c.
_SHADOW: Final = 8
# Landmarks measured together: between passes the table between them is closed, which saves passes, but is cubic in their number.
_MOST_SOURCES: Final = 128
# Picks measured together, whose table saves nothing: as many as memory is meant for.
_LANES: Final = 32


class CompiledKernels:
    """See `mapper.kernels.Kernels`."""

    name: Final = KernelsKind.COMPILED
    shortfall: Final = None

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    @property
    def library(self) -> ctypes.CDLL:
        """The library itself, for what is no kernel."""
        return self._library

    def contract(
        self, centres: IntArray, id1: IntArray, id2: IntArray, *, still: Stands, commanded: Stands, moving_time: bool
    ) -> Contraction:
        """See `Kernels.contract`."""
        n = len(centres)
        if n > _MAX_ENCOUNTERS:
            raise TooManyEncountersError(n_encounters=n, maximum=_MAX_ENCOUNTERS)
        # Upper bounds: pages that are not written to cost nothing.
        first, multiplicity, component, vertex_of = (np.empty(n, dtype=np.int32) for _ in range(4))
        is_landmark = np.empty(n, dtype=np.bool_)
        link_from, link_to = np.empty(2 * n, dtype=np.int32), np.empty(2 * n, dtype=np.int32)
        link_time, link_before = np.empty(2 * n), np.empty(2 * n, dtype=np.int32)
        starts, neighbours, times = np.empty(n + 1, dtype=np.int64), np.empty(4 * n, dtype=np.int32), np.empty(4 * n)
        graph = Graph(
            vertex_of=_address(vertex_of),
            first_encounter=_address(first),
            multiplicity=_address(multiplicity),
            is_landmark=_address(is_landmark),
            component=_address(component),
            link_from=_address(link_from),
            link_to=_address(link_to),
            link_time=_address(link_time),
            link_before=_address(link_before),
            row_start=_address(starts),
            neighbour=_address(neighbours),
            time=_address(times),
        )
        centres, id1, id2 = (np.ascontiguousarray(column, dtype=np.int64) for column in (centres, id1, id2))
        spells, stands = _spells(still), _spells(commanded)
        columns = (_address(centres), _address(id1), _address(id2), n, _address(spells), len(spells), _address(stands), len(stands))
        _check(self._library.build_graph(*columns, int(moving_time), ctypes.byref(graph)))
        v, n_links, n_edges = graph.n_vertices, graph.n_links, graph.n_edges
        return Contraction(
            links=Links(sources=link_from[:n_links], targets=link_to[:n_links], times=link_time[:n_links], before=link_before[:n_links]),
            rows=Rows(starts=starts[: v + 1], neighbours=neighbours[:n_edges], times=times[:n_edges]),
            first_encounter=first[:v],
            multiplicity=multiplicity[:v],
            is_landmark=is_landmark[:v],
            component=component[:v],
            vertex_of=vertex_of,
        )

    def sweep_times(self, links: Links, *, n_vertices: int, sources: IntArray) -> FloatArray:
        """See `Kernels.sweep_times`."""
        if len(sources) > _MOST_SOURCES:
            whole = np.empty((n_vertices, len(sources)))
            for begin in range(0, len(sources), _MOST_SOURCES):
                some = slice(begin, begin + _MOST_SOURCES)
                whole[:, some] = self.sweep_times(links, n_vertices=n_vertices, sources=sources[some])
            return whole
        chosen = np.ascontiguousarray(sources, dtype=np.int32)
        # Rows are padded to whole vectors while they are computed.
        room = np.empty(n_vertices * (-(-len(chosen) // 4) * 4))
        _check(self._library.sweep_times(*_links(links), n_vertices, len(chosen), _address(chosen), _address(room)))
        return room[: n_vertices * len(chosen)].reshape(n_vertices, len(chosen))

    def sum_neighbour_times(self, rows: Rows, multiplicity: VertexArray, *, k: int) -> FloatArray:
        """See `Kernels.sum_neighbour_times`."""
        n = len(multiplicity)
        sums = np.empty(n)

        def run(begin: int, end: int) -> int:
            return int(self._library.sum_neighbours(*_rows(rows), _address(multiplicity), n, begin, end, k, _address(sums)))

        _share(run, n)
        return sums

    def pick_along_graph(self, rows: Rows, links: Links, candidates: BoolArray, *, hubs: IntArray, n_points: int) -> Picks:
        """See `Kernels.pick_along_graph`."""
        v = len(candidates)
        from_hubs = self.sweep_times(links, n_vertices=v, sources=hubs)
        chosen, distances = np.empty(n_points, dtype=np.int32), np.zeros((n_points, n_points))
        radius, is_complete = ctypes.c_double(), ctypes.c_int32()
        hub_vertices = np.ascontiguousarray(hubs, dtype=np.int32)
        arrays = (_address(hub_vertices), _address(from_hubs), _address(candidates))
        outputs = (_address(chosen), _address(distances), ctypes.byref(is_complete), ctypes.byref(radius))
        m = _check(self._library.pick_maxmin(*_rows(rows), v, len(hubs), *arrays, n_points, *outputs))
        picked = chosen[:m].astype(np.int64)
        if not is_complete.value:
            del from_hubs
            batches = [self.sweep_times(links, n_vertices=v, sources=some)[picked] for some in np.split(picked, range(_LANES, m, _LANES))]
            return Picks(chosen=picked, distances=np.hstack(batches), cover_radius=radius.value)
        return Picks(chosen=picked, distances=distances[:m, :m].copy(), cover_radius=radius.value)

    def bracket(self, times: FloatArray, references: IntArray) -> tuple[FloatArray, FloatArray]:
        """See `Kernels.bracket`."""
        between = np.ascontiguousarray(times[references])
        n, n_places = times.shape
        middle, doubt = np.ascontiguousarray(times), np.empty(n)

        def run(begin: int, end: int) -> int:
            rows = (_address(middle[begin:end]), end - begin, n_places, _address(between), _address(doubt[begin:end]))
            return int(self._library.bracket(*rows))

        _share(run, n)
        return middle, doubt

    def pick_profiles(self, profiles: FloatArray, *, norm: ProfileNorm, n_points: int) -> Picks:
        """See `Kernels.pick_profiles`."""
        rows = np.ascontiguousarray(profiles)
        chosen, distances, radius = np.empty(n_points, dtype=np.int64), np.zeros((n_points, n_points)), ctypes.c_double()
        outputs = (_address(chosen), _address(distances), ctypes.byref(radius))
        m = _check(self._library.pick_profiles(_address(rows), *rows.shape, _NORM_NUMBERS[norm], n_points, *outputs))
        return Picks(chosen=chosen[:m], distances=distances[:m, :m].copy(), cover_radius=radius.value)

    def average_nearest(self, profiles: FloatArray, *, n_nearest: int) -> FloatArray:
        """See `Kernels.average_nearest`."""
        rows = np.ascontiguousarray(profiles)
        n, n_columns = rows.shape
        depth = ((n - 1) // _ROWS_OF_A_LEAF).bit_length()
        n_leaves = 2**depth
        slot = -(-n // (n_leaves * _SHADOW)) * _SHADOW
        centre, axes = _find_axes(rows[:: max(1, n // _ROWS_FOR_AXES)])
        order, scale, means = np.empty(n, dtype=np.int32), ctypes.c_double(), np.empty((n, n_columns))
        in_order = np.empty(n * (n_columns + 3))
        leaves, boxes = (np.empty(size * _SHADOW, dtype=np.float32) for size in (n_leaves * slot, 4 * n_leaves))
        shape = (_address(rows), n, n_columns, depth, slot)
        tree = (_address(order), _address(in_order), _address(leaves), _address(boxes))
        _check(self._library.plant_tree(*shape, _address(centre), _address(axes), len(axes), *tree, ctypes.byref(scale)))

        def run(begin: int, end: int) -> int:
            return int(self._library.average_nearest(*shape, *tree, scale, n_nearest, begin, end, _address(means)))

        _share(run, n_leaves, per_thread=_LEAVES_OF_A_THREAD)
        return means

    def settle_tracks(self, links: Links, start: FloatArray, pull: FloatArray, *, tension: Tension, rounds: int, steps: int) -> FloatArray:
        """See `Kernels.settle_tracks`."""
        first, pull, xy = np.ascontiguousarray(start), np.ascontiguousarray(pull), np.empty((len(start), 2))
        chain = (_address(links.sources), _address(links.targets), _address(links.before), _address(links.times))
        believed = (tension.blur, tension.swerve, tension.drift)
        fixed = (_address(pull), _address(first))
        _check(self._library.settle_tracks(len(xy), len(links.times), *chain, *fixed, *believed, rounds, steps, _address(xy)))
        return xy


def _find_axes(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the middle of some rows and the directions in which they spread most, shape (axes, columns)."""
    centre = rows.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(rows, rowvar=False, ddof=0).reshape(len(centre), len(centre)))
    return centre, np.ascontiguousarray(axes.T[::-1][: _SHADOW - 1])


def _address(array: NDArray[np.generic]) -> int:
    return int(array.ctypes.data)


def _rows(rows: Rows) -> tuple[int, int, int]:
    return _address(rows.starts), _address(rows.neighbours), _address(rows.times)


def _links(links: Links) -> tuple[int, int, int, int]:
    return len(links.times), _address(links.sources), _address(links.targets), _address(links.times)


def _spells(stands: Stands) -> NDArray[np.void]:
    spells = np.empty(len(stands.nodes), dtype=SPELL)
    spells["node"], spells["begin"], spells["end"] = stands.nodes, stands.begins, stands.ends
    return spells


def _check(outcome: int) -> int:
    if outcome < 0:
        raise MemoryError("no room for the working memory of a kernel; give the mapper fewer encounters (a window) or more memory")
    return outcome


def _share(run: Callable[[int, int], int], n: int, *, per_thread: int = _ROWS_OF_A_THREAD) -> None:
    """Run over all rows, in as many threads as there are processors and rows to make it worth while."""
    n_threads = max(1, min(len(os.sched_getaffinity(0)), n // per_thread))
    if n_threads == 1:
        _check(run(0, n))
        return
    bounds = [n * part // n_threads for part in range(n_threads + 1)]
    with ThreadPoolExecutor(n_threads) as pool:
        try:
            outcomes = pool.map(run, bounds[:-1], bounds[1:])
        except RuntimeError as error:
            raise MemoryError("no room for the stack of a thread of a kernel") from error
        for outcome in outcomes:
            _check(outcome)
