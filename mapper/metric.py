"""How far apart encounters are: along the encounter graph, or by their distances to the landmarks.

A metric answers for the vertices of one connected encounter graph; a vertex stands for all its encounters. Distances are in ticks.
"""

from dataclasses import dataclass

import numpy as np

from mapper.encounter_graph import EncounterGraph
from mapper.types import FloatArray, IntArray, ProfileNorm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterMetric:
    """Shortest-path time along the encounter graph, d_GEL of [Dir16] eq. 8; d_GE where no landmark stands."""

    graph: EncounterGraph


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProfileMetric:
    """Distance between landmark profiles: the largest difference, or the root mean square of them.

    ``profiles`` holds the time from every vertex to every reference place [ticks], shape (v, l), finite: that of the shortest path, or a
    better estimate (`mapper.profiles`).

    Notes
    -----
    With shortest paths it bounds the encounter metric from below. Two encounters at one place but far apart in time have like
    profiles, which the encounter metric cannot offer.
    """

    graph: EncounterGraph
    profiles: FloatArray
    norm: ProfileNorm


Metric = EncounterMetric | ProfileMetric


def profile_metric(graph: EncounterGraph, references: IntArray, *, norm: ProfileNorm) -> ProfileMetric:
    """Describe every vertex by its shortest-path times to some reference vertices of a connected graph.

    Parameters
    ----------
    references
        Distinct vertices, shape (l,), at least one; usually ``graph.landmarks``.
    """
    return ProfileMetric(graph=graph, profiles=times_to(graph, references), norm=norm)


def distances_to(metric: Metric, vertices: IntArray, points: IntArray) -> FloatArray:
    """Measure how far some vertices, shape (k,), are from others, shape (m,): [ticks], shape (k, m)."""
    match metric:
        case EncounterMetric(graph=graph):
            sources, place = np.unique(vertices, return_inverse=True)
            return times_to(graph, sources)[points].T[place]
        case ProfileMetric(profiles=profiles, norm=norm):
            rows = [np.abs(profiles[points] - profiles[vertex]) for vertex in vertices]
            found = [row.max(axis=1) if norm is ProfileNorm.MAX else np.sqrt((row**2).mean(axis=1)) for row in rows]
            return np.array(found).reshape(len(vertices), len(points))


def times_to(graph: EncounterGraph, references: IntArray) -> FloatArray:
    """Measure the shortest paths from every vertex to each of some distinct ones: [ticks], shape (v, references)."""
    return graph.kernels.sweep_times(graph.links, n_vertices=graph.n_vertices, sources=references)
