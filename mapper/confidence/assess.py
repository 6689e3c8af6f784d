"""Say how sure a finished map is: gather the evidence, ask the models, and write the answers into the map."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.component_map import PlacedComponent
from mapper.confidence.counting import count_holes, describe_numbers
from mapper.confidence.evidence import N_LOOPS, Evidence, Sighting, Track, mean_change, reach_of
from mapper.confidence.model import Models, load_models
from mapper.confidence.sufficiency import Facts, judge_data
from mapper.outlines import outline_holes
from mapper.types import BoolArray, EncounterTable, FloatArray, Hole, HoleCount, IntArray, MapResult, ModeSpell, read_only
from mapper.window import select_rows

MapAgain = Callable[[EncounterTable], PlacedComponent | None]
"""Maps the largest component of some encounters; None where they are too few."""

LEAST_PROBABILITY: Final = 0.05
"""A loop that is not called real and is a hole with less than this is not told of."""
WELL_SEEN: Final = 0.8
"""A point is well seen when its distances are right with this probability."""

_NS_PER_S = 1e9


def assess_map(
    result: MapResult,
    table: EncounterTable,
    spells: Sequence[ModeSpell],
    placed: Sequence[PlacedComponent],
    *,
    map_again: MapAgain,
    models: Models | None = None,
) -> MapResult:
    """Add to a map how sure it is; it stays as it is where ``recipe.replicates`` is 0 or nobody trained models for its method.

    Parameters
    ----------
    table, spells
        All encounters that the map is of, and when biobots stood still.
    placed
        The components of the map, in its order.
    models
        What to ask; None takes those that the package ships.

    Notes
    -----
    Parts of the time of each component are mapped again: encounters in their order, cut into ``recipe.replicates`` blocks of equal size, of
    which each replica lacks one (of two blocks: it has one). So replicas are cut where time is, and neither by biobots' names nor
    by chance: encounters close in time share their errors, and single ones left out would take little away.
    """
    models = models or load_models(result.recipe.method, result.recipe.metric)
    if result.recipe.replicates == 0 or models is None:
        return result
    gathered = gather_evidence(result, table, spells, placed, map_again=map_again)
    loops = [loop_probabilities(models, one) for one in gathered]
    distribution = count_distribution(models, gathered, loops)
    is_well_seen: BoolArray = np.concatenate([point_probabilities(models, one) >= WELL_SEEN for one in gathered])
    count = tell_count(len(result.holes), distribution)
    facts = Facts(
        encounters_each=2.0 * len(table) / len(np.unique(np.concatenate([table.id1, table.id2]))),
        n_landmarks=result.components[0].n_landmarks,
        n_components=result.n_components,
        apart=1.0 - result.components[0].n_encounters / result.n_encounters,
        count=count,
        well_seen=float(is_well_seen.mean()),
        span_s=(int(table.t_end_ns.max()) - int(table.t_start_ns.min())) / _NS_PER_S,
    )
    return replace(
        result,
        holes=_add_probabilities(result, loops),
        possible_holes=_outline_possible(result, placed, loops),
        hole_count=count,
        components=tuple(
            replace(part, stability_band=stability_band(models, one)) for part, one in zip(result.components, gathered, strict=True)
        ),
        points=replace(result.points, is_well_seen=read_only(is_well_seen)),
        data=judge_data(facts),
    )


def gather_evidence(
    result: MapResult, table: EncounterTable, spells: Sequence[ModeSpell], placed: Sequence[PlacedComponent], *, map_again: MapAgain
) -> tuple[Evidence, ...]:
    """Map parts of the time of each component again, and gather what is known of it; ``replicates`` is at least 1."""
    landmarks = {spell.node for spell in spells if spell.mode is Mode.S and spell.cause is Cause.COMMAND}
    left_out = 1.0 - sum(part.n_encounters for part in result.components) / result.n_encounters
    length_per_s = result.recipe.speed_mps or 1.0
    gathered = []
    for one, rows in zip(placed, _rows_of_components(table, placed), strict=True):
        own = select_rows(table, rows) if rows is not None else table
        duration_s = float(np.median(own.t_end_ns - own.t_start_ns)) / _NS_PER_S
        replicas = [
            (again, part) if (again := map_again(part)) is not None else None for part in cut_time(own, replicates=result.recipe.replicates)
        ]
        factor = length_per_s if one.summary.scale is None else length_per_s * one.summary.scale.factor
        track = Track(n_biobots=len(np.unique(np.concatenate([own.id1, own.id2]))), median_duration=duration_s * factor, left_out=left_out)
        seen_again = tuple(again and _sight(again[0], again[1], landmarks) for again in replicas)
        gathered.append(
            Evidence(
                sighting=_sight(one, table, landmarks),
                replicas=seen_again,
                change=mean_change(one.summary, seen_again),
                doubt=one.doubt,
                track=track,
            )
        )
    return tuple(gathered)


def cut_time(table: EncounterTable, *, replicates: int) -> list[EncounterTable]:
    """Cut encounters in their order into blocks of equal size, and leave each out in turn; one replica is the first half alone."""
    n = len(table)
    block = np.arange(n) * max(2, replicates) // max(1, n)
    return [select_rows(table, block != left_out) for left_out in range(max(2, replicates) - 1, -1, -1)][:replicates]


def loop_probabilities(models: Models, evidence: Evidence) -> FloatArray:
    """Say of the longest loops of a component how likely each is a hole, shape (n_judged,), in the order of the intervals."""
    return models.loop.probability(evidence.loop_columns())


def count_distribution(models: Models, gathered: Sequence[Evidence], loops: Sequence[FloatArray]) -> FloatArray:
    """Say how likely there are 0, 1, 2, ... holes in all components; of the run, the largest of them tells."""
    counted = sum(one.part.betti_numbers[1] for one in gathered)
    columns = describe_numbers(np.concatenate(loops), counted=counted, replicas=replica_counts(gathered), run=gathered[0].run_columns())
    return count_holes(models.count, columns)


def replica_counts(gathered: Sequence[Evidence]) -> IntArray:
    """Say how many holes each replica shows, shape (replicates,): those of all components, none where it has no map."""
    counts = [[0 if one is None else one.part.betti_numbers[1] for one in evidence.replicas] for evidence in gathered]
    return np.asarray(np.array(counts, dtype=np.int64).sum(axis=0))


def stability_band(models: Models, evidence: Evidence) -> float:
    """Say how far the diagram of loops is from the true one in no more than 5 of 100 maps [unit of lengths]."""
    share = float(np.exp(models.band.score(evidence.run_columns())))
    # With no point matched to any other, the bottleneck distance is half the longest interval.
    return reach_of(evidence.part) * min(share, 0.5)


def point_probabilities(models: Models, evidence: Evidence) -> FloatArray:
    """Say of each point how likely its distances are right, shape (n_points,)."""
    return models.point.probability(evidence.point_columns())


def _sight(placed: PlacedComponent, table: EncounterTable, landmarks: set[NodeId]) -> Sighting:
    """Say where the longest loops are: each in the middle of the edge that fills it, where its last way across is shortest."""
    diagram = placed.diagram
    edges = diagram.birth_edges[: max(N_LOOPS, placed.summary.betti_numbers[1])]
    closing = diagram.filtration.between(*edges.T)
    filling = diagram.loop_ranks[np.searchsorted(diagram.loop_ranks[:, 0], closing), 1]
    ends = diagram.filtration.ends(filling)
    # Of two landmarks that met while standing either names their one place.
    first, second = (ids[placed.landmark_encounters].tolist() for ids in (table.id1, table.id2))
    names = tuple(one if one in landmarks else other for one, other in zip(first, second, strict=True))
    return Sighting(part=placed.summary, centres=placed.to_landmarks[ends].mean(axis=1), landmarks=names)


def _rows_of_components(table: EncounterTable, placed: Sequence[PlacedComponent]) -> list[BoolArray | None]:
    """Say which encounters are in each component; None for all. Two encounters are in one if a chain of biobots joins them."""
    ids, compact = np.unique(np.concatenate([table.id1, table.id2]), return_inverse=True)
    first, second = compact.reshape(2, -1)
    joined = csr_array((np.ones(len(table), dtype=bool), (first, second)), shape=(len(ids), len(ids)))
    n_components, label = connected_components(joined, directed=False)
    if n_components == 1:
        return [None] * len(placed)
    of_row = label[first]
    return [of_row == of_row[one.encounters[0]] for one in placed]


def _add_probabilities(result: MapResult, loops: Sequence[FloatArray]) -> tuple[Hole, ...]:
    """Give every hole its probability: holes of a component are in the order of its longest intervals."""
    rank = [0] * len(loops)
    told = []
    for hole in result.holes:
        intervals = result.components[hole.component].intervals[1]
        while tuple(intervals[rank[hole.component]].tolist()) != (hole.birth, hole.death):
            rank[hole.component] += 1
        told.append(replace(hole, probability=float(loops[hole.component][rank[hole.component]])))
        rank[hole.component] += 1
    return tuple(told)


def _outline_possible(result: MapResult, placed: Sequence[PlacedComponent], loops: Sequence[FloatArray]) -> tuple[Hole, ...]:
    """Draw the loops that are not called real and may be holes, the likeliest first."""
    called = {(hole.component, hole.birth, hole.death) for hole in result.holes}
    possible = []
    for index, (one, probabilities) in enumerate(zip(placed, loops, strict=True)):
        first_point = int(np.argmax(result.points.component == index))
        intervals = one.summary.intervals[1]
        rows = [
            row
            for row, probability in enumerate(probabilities.tolist())
            if probability >= LEAST_PROBABILITY and (index, *intervals[row].tolist()) not in called
        ]
        outlines = outline_holes(one.summary.distances, one.diagram, np.array(rows, dtype=np.int64)) if rows else ()
        for row, outline in zip(rows, outlines, strict=True):
            birth, death = intervals[row].tolist()
            points, probability = read_only(outline + first_point), float(probabilities[row])
            possible.append(Hole(component=index, birth=birth, death=death, outline=points, probability=probability))
    return tuple(sorted(possible, key=lambda hole: (-(hole.probability or 0.0), hole.component, hole.birth - hole.death)))


def tell_count(value: int, distribution: FloatArray) -> HoleCount:
    """Say how sure a number of holes is, by the distribution of the true number from 0 on, shape (k,)."""
    told = distribution.tolist()
    return HoleCount(value=value, probability=told[value] if value < len(told) else 0.0, probabilities=tuple(told))
