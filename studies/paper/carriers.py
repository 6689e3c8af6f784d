"""Paths of encounters told biobot by biobot, so that each change from one to the next can be given a cost.

With no cost this is d_GEL of [Dir16] eq. 8 (or d_GE, without landmarks), written down in another way than the mapper's. With r_d a change
it bounds the true distance: an encounter's place is the middle between its two biobots, which are up to r_d apart.
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from studies.paper.swarm_runs import SwarmRun
from studies.truth import Floats, Indices

# Shortest way between two different nodes: a zero would be no edge at all.
_LEAST = 1e-9


def carried_distances(run: SwarmRun, sources: Indices, targets: Indices, *, handover: float, landmarks_stand: bool) -> Floats:
    """Measure shortest paths from biobot to biobot.

    Parameters
    ----------
    sources, targets
        What to measure between, shapes (p,) and (q,): from 0 on encounters, in the order of the table; -1, -2, ... are the landmarks, in
        the order of ``run.landmark_ids``.
    handover
        Cost of each change from one biobot to another, at an encounter [length]; half of it at an encounter that a path begins or ends at.
    landmarks_stand
        Whether a landmark is one place at all times, or a biobot like all others; then only encounters can be measured.

    Returns
    -------
    Floats
        Shape (p, q) [length]; inf where there is no path. Too long by some 1e-9 a step.

    Notes
    -----
    Each encounter is a vertex, and so is each biobot at each of its encounters; a landmark that stands is a single one.
    """
    table, n = run.table, len(run.table)
    length = run.speed * run.centre_s
    biobot = np.concatenate([table.id1, table.id2])
    event = np.tile(np.arange(n), 2)
    n_landmarks = len(run.landmark_ids)
    at = np.minimum(np.searchsorted(run.landmark_ids, biobot), n_landmarks - 1)
    is_standing = (run.landmark_ids[at] == biobot) & landmarks_stand
    node = np.where(is_standing, n + at, n + n_landmarks + np.arange(2 * n))
    order = np.lexsort((length[event], biobot))
    follows = (biobot[order][1:] == biobot[order][:-1]) & ~is_standing[order][1:]
    before, after = order[:-1][follows], order[1:][follows]
    heads = np.concatenate([event, node[before]])
    tails = np.concatenate([node, node[after]])
    steps = np.concatenate([np.full(2 * n, handover / 2.0), length[event[after]] - length[event[before]]])
    size = 3 * n + n_landmarks
    graph = csr_array((np.maximum(steps, _LEAST), (heads, tails)), shape=(size, size))
    found = dijkstra(graph, directed=False, indices=np.where(sources < 0, n - 1 - sources, sources))
    return np.asarray(found[:, np.where(targets < 0, n - 1 - targets, targets)])
