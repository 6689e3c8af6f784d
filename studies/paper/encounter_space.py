"""What the paper's method makes of a run, beside the truth: the metric between landmarks, and between the encounters of the subsample.

Lengths are those of the run: times are multiplied by its speed, and nothing is fitted.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from mapper.bottleneck import bottleneck_distance
from mapper.encounter_graph import EncounterGraph, build_components
from mapper.metric import EncounterMetric, times_to
from mapper.outliers import keep_inliers
from mapper.subsampling import subsample_maxmin
from mapper.types import TICKS_PER_S
from simulator.arenas.arena import Arena
from simulator.arenas.geodesics import geodesic_distances
from studies.paper.swarm_runs import Place, SwarmRun
from studies.samples import sample_arena
from studies.truth import Floats, Indices, Intervals, diagram_of

# [Dir16] VI: k = 10, q = 0.9, 150 points.
_K, _Q = 10, 0.9
_POINTS = 150


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterSpace:
    """Landmarks and subsample of one run by the paper's method.

    Parameters
    ----------
    landmarks
        Rows of ``run.landmark_ids`` whose communities are in the largest component, shape (l,).
    between_landmarks, true_between_landmarks
        d_GEL and d_M, shape (l, l) [length].
    encounters
        Rows of the table: the subsample, shape (m,).
    between_encounters, true_between_encounters
        d_GEL and d_M, shape (m, m) [length].
    to_landmarks, true_to_landmarks
        d_GEL and d_M from the subsample to the landmarks, shape (m, l) [length].
    """

    landmarks: Indices
    between_landmarks: Floats
    true_between_landmarks: Floats
    encounters: Indices
    between_encounters: Floats
    true_between_encounters: Floats
    to_landmarks: Floats
    true_to_landmarks: Floats

    @property
    def inflation(self) -> Floats:
        """By how much d_GEL exceeds d_M, as a share, for each pair of landmarks: shape (l (l - 1) / 2,)."""
        above = np.triu_indices(len(self.landmarks), 1)
        return np.asarray(self.between_landmarks[above] / self.true_between_landmarks[above] - 1.0)

    @property
    def next_landmark(self) -> float:
        """The largest distance from a landmark to the one nearest to it [length]: delta_l as Assumption 3 of [Dir16] has it."""
        others = self.true_between_landmarks + np.diag(np.full(len(self.landmarks), np.inf))
        return float(others.min(axis=1).max())

    @property
    def wait(self) -> float:
        """The largest d_GEL from an encounter to the landmark that is nearest to it in truth [length]."""
        nearest = self.true_to_landmarks.argmin(axis=1)
        return float(self.to_landmarks[np.arange(len(nearest)), nearest].max())


def measure_space(run: SwarmRun) -> EncounterSpace:
    """Make the encounter graph of a run, its metric and its subsample, as ``--method paper`` does, and measure the same in truth."""
    graph = build_components(run.table, run.spells, moving_time=False)[0]
    length = run.speed / TICKS_PER_S
    metric = EncounterMetric(graph=graph)
    sample = subsample_maxmin(metric, keep_inliers(metric, k=_K, q=_Q), n_points=_POINTS)
    landmarks, vertices = find_communities(run, graph)
    times = times_to(graph, vertices)
    encounters = graph.first_encounter[sample.vertices].astype(np.int64)
    places, stands = run.positions[encounters], run.landmark_positions[landmarks]
    return EncounterSpace(
        landmarks=landmarks,
        between_landmarks=length * times[vertices],
        true_between_landmarks=geodesic_distances(run.arena, stands),
        encounters=encounters,
        between_encounters=length * sample.distances,
        true_between_encounters=run.true_distances(encounters),
        to_landmarks=length * times[sample.vertices],
        true_to_landmarks=geodesic_distances(run.arena, places, stands),
    )


def find_communities(run: SwarmRun, graph: EncounterGraph) -> tuple[Indices, Indices]:
    """Find the vertex of each landmark's community.

    Returns
    -------
    landmarks, vertices
        Rows of ``run.landmark_ids`` that have met anyone in this component, and their vertices, shape (l,) each. Landmarks that met each
        other while standing share one.

    Notes
    -----
    A community's first encounter is its vertex's first. It is looked for among the landmarks that met, put together.
    """
    group = np.arange(len(run.landmark_ids))
    rows = [np.searchsorted(run.landmark_ids, ids) for ids in (run.table.id1, run.table.id2)]
    rows = [np.minimum(found, len(group) - 1) for found in rows]
    stands = [run.landmark_ids[found] == ids for found, ids in zip(rows, (run.table.id1, run.table.id2), strict=True)]
    for one, other in zip(rows[0][stands[0] & stands[1]].tolist(), rows[1][stands[0] & stands[1]].tolist(), strict=True):
        group[group == group[other]] = group[one]
    vertex_of = {int(graph.first_encounter[vertex]): int(vertex) for vertex in graph.landmarks}
    landmarks, vertices = [], []
    for landmark in range(len(group)):
        together = [np.flatnonzero(stand & (group[found] == group[landmark])) for found, stand in zip(rows, stands, strict=True)]
        met = np.concatenate(together)
        vertex = vertex_of.get(int(met.min())) if met.size else None
        if vertex is not None:
            landmarks.append(landmark)
            vertices.append(vertex)
    return np.array(landmarks, dtype=np.int64), np.array(vertices, dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArenaSample:
    """A fine sample of an arena: places, shape (p, 2) [length], their diagram, and the largest distance between two of them [length]."""

    arena: Arena
    places: Floats
    intervals: Intervals
    diameter: float

    def hausdorff(self, places: Floats) -> float:
        """Return the Hausdorff distance to other places, shape (q, 2), by geodesics [length]."""
        between = geodesic_distances(self.arena, self.places, places)
        return float(max(between.min(axis=0).max(), between.min(axis=1).max()))

    def covering_radius(self, places: Floats) -> float:
        """Return the largest geodesic distance from a place of the sample to the nearest of others, shape (q, 2) [length]."""
        return float(geodesic_distances(self.arena, self.places, places).min(axis=1).max())


@cache
def sample_scenario(scenario: str, *, n_points: int) -> ArenaSample:
    """Spread places over a scenario's arena, each as far as can be from those before."""
    arena = Place(scenario=scenario).build(seed=0)
    places, distances = sample_arena(arena, geodesic_distances, n_points=n_points, seed=0)
    return ArenaSample(arena=arena, places=places, intervals=diagram_of(distances), diameter=float(distances.max()))


def bottlenecks(one: Intervals, other: Intervals) -> tuple[float, float]:
    """Return the bottleneck distances of the finite intervals in dimensions 0 and 1."""
    finite = [[part[np.isfinite(part[:, 1])] for part in diagram] for diagram in (one, other)]
    return bottleneck_distance(finite[0][0], finite[1][0]), bottleneck_distance(finite[0][1], finite[1][1])
