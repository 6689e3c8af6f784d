"""Say how sure a map is, and so which of its loops are holes: gather the evidence, ask the models, write the answers into the map."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.component_map import PlacedComponent
from mapper.confidence.coarse_contacts import COARSE_SHARE, doubt_reach
from mapper.confidence.counting import count_holes, describe_numbers, is_telling, mix_with
from mapper.confidence.evidence import N_LOOPS, Evidence, Sighting, Track, mean_change, reach_of
from mapper.confidence.model import Models
from mapper.confidence.sufficiency import Doubt, Facts, judge_data
from mapper.groups import label_groups
from mapper.outlines import outline_holes
from mapper.types import (
    BoolArray,
    DataVerdict,
    EncounterTable,
    FloatArray,
    Hole,
    HoleCount,
    IntArray,
    MapResult,
    ModeSpell,
    Recipe,
    read_only,
)
from mapper.window import select_rows

MapAgain = Callable[[EncounterTable], PlacedComponent | None]
"""Maps the largest component of some encounters; None where they are too few."""

LEAST_PROBABILITY: Final = 0.05
"""A loop that is not called real and is a hole with less than this is not told of."""
LEAST_CLAIMED: Final = 0.6
"""A loop that is a hole with less than this is not claimed, only called possible: a wrong claim is the worst failure."""
MOST_OF_OTHERS: Final = 0.24
"""No loop of nodes that do not walk at random, as those of the runs of training did, is a hole with more than this: of the loops that the
models call holes with 90 % or more so many are there (``studies.other_walkers``, docs/confidence.md)."""
WELL_SEEN: Final = 0.8
"""A point is well seen when its distances are right with this probability."""

_NS_PER_S = 1e9
_ALWAYS = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """How sure a map is.

    For each component: ``chances`` of its longest loops, ``is_hole`` of all its loops, and the ``bands``. ``count``, from 0 on, is the
    distribution of the number of holes; ``is_well_seen`` is of the points of all components.
    """

    chances: tuple[FloatArray, ...]
    is_hole: tuple[BoolArray, ...]
    bands: tuple[float, ...]
    count: HoleCount
    is_well_seen: BoolArray
    data: DataVerdict


def judge_components(
    models: Models, gathered: Sequence[Evidence], table: EncounterTable, *, n_components: int, doubts: Sequence[Doubt] = ()
) -> Verdict:
    """Say how sure a map of encounters is, and which of its loops are holes; none is that is less probable than `LEAST_CLAIMED`.

    Parameters
    ----------
    doubts
        What in the contacts is unlike the runs that the models were trained and checked on. If there is anything, no more is told of any
        loop than `MOST_OF_OTHERS`, and nothing of their number.

    Notes
    -----
    There are as many holes as is most probable, less those that are too unlikely by themselves, and they are the likeliest loops: the rule
    of the recipe only takes part in the evidence. Where the map tells nothing (`is_telling`) no loop is told of.
    """
    encounters_each = 2.0 * len(table) / len(np.unique(np.concatenate([table.id1, table.id2])))
    is_known = _is_telling(gathered) and not doubts
    coarse = doubt_reach(gathered[0], encounters_each=encounters_each) if is_known else ()
    most = MOST_OF_OTHERS if doubts else 1.0
    chances = tuple(np.minimum(loop_probabilities(models, one), most if _is_telling(gathered) else 0.0) for one in gathered)
    distribution = count_distribution(models, gathered, chances, is_known=is_known)
    if coarse:
        distribution = mix_with(distribution, models.prior, share=COARSE_SHARE)
    chosen = choose_holes(np.concatenate(chances), distribution, is_telling=is_known)
    ends = np.cumsum([len(some) for some in chances])[:-1]
    is_hole = tuple(
        np.pad(some, (0, len(one.part.intervals[1]) - len(some))) for some, one in zip(np.split(chosen, ends), gathered, strict=True)
    )
    is_well_seen: BoolArray = np.concatenate([point_probabilities(models, one) >= WELL_SEEN for one in gathered])
    count = tell_count(int(chosen.sum()), distribution, is_known=is_known)
    facts = Facts(
        encounters_each=encounters_each,
        n_landmarks=gathered[0].part.n_landmarks,
        n_walkers=gathered[0].track.n_walkers,
        n_components=n_components,
        apart=1.0 - gathered[0].part.n_encounters / len(table),
        count=count,
        well_seen=float(is_well_seen.mean()),
        has_moved_on=_has_moved_on(gathered),
        span_s=(int(table.t_end_ns.max()) - int(table.t_start_ns.min())) / _NS_PER_S,
        doubts=(*doubts, *coarse),
    )
    return Verdict(
        chances=chances,
        is_hole=is_hole,
        bands=tuple(stability_band(models, one) for one in gathered),
        count=count,
        is_well_seen=is_well_seen,
        data=judge_data(facts),
    )


def add_verdict(result: MapResult, placed: Sequence[PlacedComponent], verdict: Verdict) -> MapResult:
    """Write into a map, drawn with the holes of a verdict, how sure it is; ``placed`` are its components."""
    return replace(
        result,
        holes=_add_probabilities(result, verdict.chances),
        possible_holes=_outline_possible(result, placed, verdict),
        hole_count=verdict.count,
        components=tuple(replace(part, stability_band=band) for part, band in zip(result.components, verdict.bands, strict=True)),
        points=replace(result.points, is_well_seen=read_only(verdict.is_well_seen)),
        data=verdict.data,
    )


def choose_holes(chances: FloatArray, distribution: FloatArray, *, is_telling: bool) -> BoolArray:
    """Say which loops are holes: the likeliest, as many as is most probable, but none below `LEAST_CLAIMED`; ties go to the earlier.

    None are where the map tells nothing.

    Parameters
    ----------
    chances
        That each loop is a hole, shape (k,).
    distribution
        Probabilities of 0, 1, 2, ... holes.
    """
    is_hole = np.zeros(len(chances), dtype=bool)
    number = int(np.argmax(distribution[: len(chances) + 1])) if is_telling else 0
    is_hole[np.argsort(-chances, kind="stable")[:number]] = True
    return is_hole & (chances >= LEAST_CLAIMED)


def gather_evidence(
    table: EncounterTable,
    spells: Sequence[ModeSpell],
    placed: Sequence[PlacedComponent],
    recipe: Recipe,
    *,
    map_again: MapAgain,
) -> tuple[Evidence, ...]:
    """Map parts of the time of each component again, and gather what is known of it; ``recipe.replicates`` is at least 1.

    Notes
    -----
    Encounters in their order are cut into ``recipe.replicates`` blocks of equal size, of which each replica lacks one (of two blocks: it
    has one). So replicas are cut where time is, and neither by biobots' names nor by chance: encounters close in time share their errors,
    and single ones left out would take little away.
    """
    landmarks = {spell.node for spell in spells if spell.mode is Mode.S and spell.cause is Cause.COMMAND}
    standing = _always_standing(table, spells)
    left_out = 1.0 - sum(part.summary.n_encounters for part in placed) / len(table)
    length_per_s = recipe.speed_mps or 1.0
    gathered = []
    for one, rows in zip(placed, _rows_of_components(table, placed), strict=True):
        own = select_rows(table, rows) if rows is not None else table
        duration_s = float(np.median(own.t_end_ns - own.t_start_ns)) / _NS_PER_S
        replicas = [
            (again, part) if (again := map_again(part)) is not None else None for part in cut_time(own, replicates=recipe.replicates)
        ]
        factor = length_per_s if one.summary.scale is None else length_per_s * one.summary.scale.factor
        biobots = np.unique(np.concatenate([own.id1, own.id2])).tolist()
        track = Track(
            n_biobots=len(biobots),
            n_walkers=len(set(biobots) - standing),
            median_duration=duration_s * factor,
            left_out=left_out,
        )
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


def count_distribution(models: Models, gathered: Sequence[Evidence], loops: Sequence[FloatArray], *, is_known: bool) -> FloatArray:
    """Say how likely there are 0, 1, 2, ... holes in all components; of the run, the largest of them tells.

    Where nothing of it is known, only how many the runs of training had.
    """
    counted = sum(one.part.betti_numbers[1] for one in gathered)
    columns = describe_numbers(np.concatenate(loops), counted=counted, replicas=replica_counts(gathered), run=gathered[0].run_columns())
    alone = np.concatenate(loops) if is_beyond_training(models, counted, has_moved_on=_has_moved_on(gathered)) else None
    return count_holes(models.count, columns, prior=models.prior, is_telling=is_known, alone=alone)


def is_beyond_training(models: Models, counted: int, *, has_moved_on: bool) -> bool:
    """Say whether a map is unlike those of training: it has more holes than any had, or the swarm moved on, which none did."""
    return has_moved_on or counted >= len(models.prior)


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


def _always_standing(table: EncounterTable, spells: Sequence[ModeSpell]) -> set[int]:
    """List the biobots that stand by command in nearly all of the time of some encounters."""
    begin, end = int(table.t_start_ns.min()), int(table.t_end_ns.max())
    stood: defaultdict[int, int] = defaultdict(int)
    for spell in spells:
        if spell.mode is Mode.S and spell.cause is Cause.COMMAND:
            until = end if spell.t_end_ns is None else min(spell.t_end_ns, end)
            stood[spell.node] += max(0, until - max(spell.t_start_ns, begin))
    return {node for node, time_ns in stood.items() if time_ns >= _ALWAYS * (end - begin)}


def _has_moved_on(gathered: Sequence[Evidence]) -> bool:
    return any(reach_of(one.part) < one.part.diameter for one in gathered)


def _is_telling(gathered: Sequence[Evidence]) -> bool:
    largest = gathered[0]
    return is_telling(n_points=largest.part.n_points, n_landmarks=largest.part.n_landmarks, n_walkers=largest.track.n_walkers)


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
    label = label_groups(first, second, n=len(ids))
    if not label.any():
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


def _outline_possible(result: MapResult, placed: Sequence[PlacedComponent], verdict: Verdict) -> tuple[Hole, ...]:
    """Draw the loops that are not called holes and may be, the likeliest first."""
    possible = []
    for index, (one, chances, is_hole) in enumerate(zip(placed, verdict.chances, verdict.is_hole, strict=True)):
        first_point = int(np.argmax(result.points.component == index))
        rows = np.flatnonzero((chances >= LEAST_PROBABILITY) & ~is_hole[: len(chances)])
        outlines = outline_holes(one.summary.distances, one.diagram, rows) if len(rows) else ()
        for row, outline in zip(rows.tolist(), outlines, strict=True):
            birth, death = one.summary.intervals[1][row].tolist()
            points = read_only(outline + first_point)
            possible.append(Hole(component=index, birth=birth, death=death, outline=points, probability=float(chances[row])))
    return tuple(sorted(possible, key=lambda hole: (-(hole.probability or 0.0), hole.component, hole.birth - hole.death)))


def tell_count(value: int, distribution: FloatArray, *, is_known: bool) -> HoleCount:
    """Say how sure a number of holes is, by the distribution of the true number from 0 on, shape (k,)."""
    told = distribution.tolist()
    return HoleCount(value=value, probability=told[value] if value < len(told) else 0.0, probabilities=tuple(told), is_known=is_known)
