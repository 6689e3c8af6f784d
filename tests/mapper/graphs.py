"""Graphs by every kind of kernels, and whole distance matrices of them."""

import numpy as np

from mapper.encounter_graph import Components, EncounterGraph, build_components
from mapper.kernels import Kernels, choose_kernels
from mapper.metric import EncounterMetric, Metric, times_to
from mapper.types import FloatArray, IntArray, KernelsKind, ModeSpell, ProfileNorm
from tests.mapper.worlds import Row, table_of

KERNELS: tuple[Kernels, ...] = tuple(choose_kernels(kind) for kind in (KernelsKind.COMPILED, KernelsKind.PLAIN))
"""Compiled and plain; asking for the first fails where it was not built, so no test passes by testing one against itself."""

Spells = list[ModeSpell] | tuple[ModeSpell, ...]


def components_of(rows: list[Row], spells: Spells, kernels: Kernels, *, moving_time: bool = False) -> Components:
    return build_components(table_of(rows), spells, moving_time=moving_time, kernels=kernels)


def largest_of(rows: list[Row], spells: Spells, kernels: Kernels) -> EncounterGraph:
    return components_of(rows, spells, kernels)[0]


def all_times(graph: EncounterGraph) -> FloatArray:
    """Shortest-path times between all vertices of a graph."""
    return times_to(graph, np.arange(graph.n_vertices))


def joined_times(components: Components) -> tuple[FloatArray, IntArray, IntArray]:
    """Put all components together: times between vertices (inf between components), their first encounters and their multiplicities."""
    parts = list(components)
    first = np.concatenate([part.first_encounter for part in parts])
    order = np.argsort(first)
    times = np.full((len(first), len(first)), np.inf)
    at = 0
    for part in parts:
        here = slice(at, at + part.n_vertices)
        times[here, here] = all_times(part)
        at += part.n_vertices
    multiplicity = np.concatenate([part.multiplicity for part in parts])
    return times[np.ix_(order, order)], first[order], multiplicity[order]


def matrix_of(metric: Metric) -> FloatArray:
    """All distances of a metric, from its definition."""
    if isinstance(metric, EncounterMetric):
        return all_times(metric.graph)
    difference = np.abs(metric.profiles[:, None, :] - metric.profiles[None, :, :])
    if metric.norm is ProfileNorm.MAX:
        return np.asarray(difference.max(axis=2))
    squares = np.zeros(difference.shape[:2])
    for place in range(difference.shape[2]):
        squares += difference[:, :, place] ** 2
    return np.asarray(np.sqrt(squares / difference.shape[2]))
