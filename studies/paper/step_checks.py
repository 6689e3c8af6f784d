"""One run held against Theorems 1 and 2 of [Dir16], whose constants tau, epsilon and delta_e are measured.

Everything is of a set S of encounters: delta_e says how well S covers arena and time, tau how far in d_GE those are apart that are within
epsilon of each other. For S the proofs of the corrected bounds hold to the letter, so no violation may remain.
"""

from dataclasses import dataclass

import numpy as np

from mapper.encounter_graph import EncounterGraph, build_components
from mapper.metric import times_to
from mapper.types import TICKS_PER_S
from simulator.arenas.geodesics import geodesic_distances
from studies.cases import Study
from studies.paper import theorems
from studies.paper.carriers import carried_distances
from studies.paper.encounter_space import find_communities
from studies.paper.swarm_runs import SIDE, RunCase, SwarmRun, simulate_run
from studies.truth import Floats, Indices

_CELL = 1.0
"""Side of the cells that delta_e is measured over: all walls of the scenarios lie between cells."""
_EVENTS_OF_LANDMARK = 8
_SOURCES = 20  # encounters from which paths are followed biobot by biobot
_PRECISION = 0.05  # of delta_e [length]
_ABOVE = 1.0001  # epsilon over 4 delta_e, which it must exceed
_ROUNDING = 1e-6  # of lengths along paths of many steps


@dataclass(frozen=True, slots=True, kw_only=True)
class StepsCase:
    """A run, and about how many of its encounters the theorems are held against."""

    run: RunCase
    n_events: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StepsRun:
    """Constants of one run [length], and shares of pairs that break a bound.

    Parameters
    ----------
    n_events
        Size of S.
    delta_e, epsilon, tau, lambda_3
        Of the theorems; epsilon is as small as they allow.
    close_pairs_joined
        Share of the pairs of S within epsilon that share a biobot, which Assumption 2 says all do.
    below_1, below_1_handovers
        Theorem 1: share of the pairs with d_GE below d_MxT; and below it even with r_d added for each change of biobot.
    above_1, above_1_corrected
        Share with d_GE above the upper bound as published, and with tau added.
    below_2, below_2_handovers, above_2, above_2_corrected
        Theorem 2: the same of landmark communities.
    below_corollary, below_corollary_handovers
        Corollary 1: share of the pairs of encounters with d_GEL below d_M.
    tightness_1
        Median of the corrected upper bound over d_GE.
    """

    n_events: int
    delta_e: float
    epsilon: float
    tau: float
    lambda_3: float
    close_pairs_joined: float
    below_1: float
    below_1_handovers: float
    above_1: float
    above_1_corrected: float
    below_2: float
    below_2_handovers: float
    above_2: float
    above_2_corrected: float
    below_corollary: float
    below_corollary_handovers: float
    tightness_1: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """The set S of one run, and what was measured of it.

    Parameters
    ----------
    events
        Rows of the table, shape (s,), ascending.
    found, true
        d_GE and d_MxT, shape (s, s) [length].
    true_in_space
        d_M, shape (s, s) [length].
    delta_e, epsilon, tau
        As the theorems have them [length].
    """

    events: Indices
    found: Floats
    true: Floats
    true_in_space: Floats
    delta_e: float
    epsilon: float
    tau: float

    @property
    def inflation(self) -> float:
        """lambda_3 of Theorem 1."""
        return theorems.lambda_3(tau=self.tau, epsilon=self.epsilon, delta_e=self.delta_e)


def compute_steps(case: StepsCase) -> StepsRun:
    """Simulate a run, and hold it against the theorems."""
    run = simulate_run(case.run)
    return check_steps(run, measure_steps(run, n_events=case.n_events))


STEPS = Study(name="paper-convergence", compute=compute_steps, result_type=StepsRun)


def measure_steps(run: SwarmRun, *, n_events: int) -> Steps:
    """Choose about ``n_events`` encounters, evenly in time and some of each landmark, and measure the constants of Theorem 1."""
    graph = build_components(run.table, (), moving_time=False)[0]
    vertices = _choose(run, graph, n_events=n_events)
    events = graph.first_encounter[vertices].astype(np.int64)
    found = run.speed / TICKS_PER_S * times_to(graph, vertices)[vertices]
    in_space, at = run.true_distances(events), run.speed * run.centre_s[events]
    true = np.maximum(in_space, np.abs(at[:, None] - at))
    delta_e = cover_space_time(run, events)
    epsilon = _ABOVE * 4.0 * delta_e
    return Steps(
        events=events,
        found=found,
        true=true,
        true_in_space=in_space,
        delta_e=delta_e,
        epsilon=epsilon,
        tau=float(found[true <= epsilon].max()),
    )


def cover_space_time(run: SwarmRun, events: Indices) -> float:
    """Return a radius delta_e [length]: each place has at each time an encounter within it, in space and in time.

    Notes
    -----
    Every place is in a cell, less than half a diagonal from the middle. A middle is covered by a radius r if the encounters within r of it
    follow each other within 2 r, the first no later than r and the last no earlier than r before the end. The least such r is found by
    halving, to 0.05, from above.
    """
    middles = np.arange(_CELL / 2, SIDE, _CELL)
    x, y = (part.ravel() for part in np.meshgrid(middles, middles))
    cells = np.column_stack([x, y])[run.arena.has_room(np.column_stack([x, y]))]
    order = np.argsort(run.centre_s[events])
    distance = geodesic_distances(run.arena, cells, run.positions[events[order]])
    at = run.speed * (run.centre_s[events[order]] - run.start_s)
    end = run.speed * run.duration_s
    low, high = 0.0, float(max(end, distance.max()))
    while high - low > _PRECISION:
        radius = (low + high) / 2.0
        low, high = (low, radius) if _covers(distance <= radius, at, end=end, radius=radius) else (radius, high)
    return high + _CELL * float(np.sqrt(0.5))


def check_steps(run: SwarmRun, steps: Steps) -> StepsRun:
    """Count the pairs that break Theorem 1, Theorem 2 or the lower bound of Corollary 1, as published and as corrected."""
    above = np.triu_indices(len(steps.events), 1)
    found, true = steps.found[above], steps.true[above]
    published = theorems.theorem_1(true, inflation=steps.inflation)
    corrected = theorems.theorem_1(true, inflation=steps.inflation, tau=steps.tau)
    ids = np.stack([run.table.id1[steps.events], run.table.id2[steps.events]])
    joined = (ids[:, None, :, None] == ids[None, :, None, :]).any(axis=(0, 1))[above]
    is_close = true <= steps.epsilon
    chosen = np.arange(0, len(steps.events), max(1, len(steps.events) // _SOURCES))
    sources, wanted = steps.events[chosen], steps.true_in_space[chosen]
    walked = carried_distances(run, sources, steps.events, handover=run.reach, landmarks_stand=False)
    over_landmarks = [carried_distances(run, sources, steps.events, handover=cost, landmarks_stand=True) for cost in (0.0, run.reach)]
    communities = _check_communities(run, steps)
    return StepsRun(
        n_events=len(steps.events),
        delta_e=steps.delta_e,
        epsilon=steps.epsilon,
        tau=steps.tau,
        lambda_3=steps.inflation,
        close_pairs_joined=float(joined[is_close].mean()),
        below_1=_share(found < true - _ROUNDING),
        below_1_handovers=_share(walked < wanted - _ROUNDING),
        above_1=_share(found > published + _ROUNDING),
        above_1_corrected=_share(found > corrected + _ROUNDING),
        below_2=communities[0],
        below_2_handovers=communities[1],
        above_2=communities[2],
        above_2_corrected=communities[3],
        below_corollary=_share(over_landmarks[0] < wanted - _ROUNDING),
        below_corollary_handovers=_share(over_landmarks[1] < wanted - _ROUNDING),
        tightness_1=float(np.median(corrected / np.maximum(found, _ROUNDING))),
    )


def _choose(run: SwarmRun, graph: EncounterGraph, *, n_events: int) -> Indices:
    first = graph.first_encounter
    by_time = np.argsort(run.centre_s[first], kind="stable")
    chosen = [by_time[np.unique(np.linspace(0, len(by_time) - 1, n_events).astype(np.int64))]]
    for landmark in run.landmark_ids.tolist():
        own = by_time[((run.table.id1[first] == landmark) | (run.table.id2[first] == landmark))[by_time]]
        chosen.append(own[np.unique(np.linspace(0, len(own) - 1, min(_EVENTS_OF_LANDMARK, len(own))).astype(np.int64))])
    return np.unique(np.concatenate(chosen))


def _covers(is_near: "np.ndarray[tuple[int, int], np.dtype[np.bool_]]", at: Floats, *, end: float, radius: float) -> bool:
    """Say whether the encounters near each cell, in the order of their times, leave no gap longer than twice the radius."""
    if not is_near.any(axis=1).all():
        return False
    before = np.maximum.accumulate(np.where(is_near, at, -np.inf), axis=1)
    gaps = np.where(is_near[:, 1:] & np.isfinite(before[:, :-1]), at[1:] - before[:, :-1], 0.0)
    first = at[is_near.argmax(axis=1)]
    return bool(gaps.max(initial=0.0) <= 2.0 * radius and first.max() <= radius and before[:, -1].min() >= end - radius)


def _check_communities(run: SwarmRun, steps: Steps) -> tuple[float, float, float, float]:
    """Return the shares of pairs of landmarks that break Theorem 2: below, below with handovers, above, above as corrected."""
    graph = build_components(run.table, run.spells, moving_time=False)[0]
    landmarks, vertices = find_communities(run, graph)
    above = np.triu_indices(len(landmarks), 1)
    found = run.speed / TICKS_PER_S * times_to(graph, vertices)[vertices][above]
    true = geodesic_distances(run.arena, run.landmark_positions[landmarks])[above]
    walked = carried_distances(run, -1 - landmarks, -1 - landmarks, handover=run.reach, landmarks_stand=True)[above]
    ids = run.landmark_ids[landmarks]
    met = [np.flatnonzero((run.table.id1[steps.events] == one) | (run.table.id2[steps.events] == one)) for one in ids.tolist()]
    nearest = np.array([steps.true[np.ix_(met[i], met[j])].min(initial=np.inf) for i, j in zip(*above, strict=True)])
    return (
        _share(found < true - _ROUNDING),
        _share(walked < true - _ROUNDING),
        _share(found > theorems.theorem_1(true, inflation=steps.inflation) + _ROUNDING),
        _share(found > theorems.theorem_1(nearest, inflation=steps.inflation, tau=steps.tau) + _ROUNDING),
    )


def _share(is_broken: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]") -> float:
    return float(is_broken.mean())
