"""The stages of the mapper in their order: graph, components, one map each, put side by side."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NS_PER_S
from mapper.assembly import add_others, assemble
from mapper.betti import load_trained_rules
from mapper.component_map import MIN_LANDMARKS, PlacedComponent, draw_component, map_component
from mapper.confidence import (
    Doubt,
    Evidence,
    MapAgain,
    add_verdict,
    doubt_movement,
    gather_evidence,
    judge_components,
    load_models,
)
from mapper.contact_statistics import measure_walkers
from mapper.encounter_graph import Components, build_components
from mapper.errors import TooFewEncountersError
from mapper.joined_map import check_alike, join_maps
from mapper.kernels import Kernels, choose_kernels
from mapper.landmark_stands import Stands, find_stands
from mapper.map_file import MapFile
from mapper.types import (
    TICKS_PER_S,
    BoolArray,
    EncounterTable,
    IntArray,
    MapResult,
    ModeSpell,
    Recipe,
)
from mapper.window import make_encounter_table

Progress = Callable[[str, float], None]
"""Called with the stage that begins and the share of the work done so far, in [0, 1]."""

MIN_ENCOUNTERS = 2
_MIN_POINTS = 3  # of a component that is not the largest; with fewer there cannot be a loop
# Own choice: of 120 runs of 2,100 encounters 81 % were counted right with 100 points and 88 % with 150, before doubtful ones were dropped.
_MIN_SAMPLE = 100
_STAGES = ("metric", "outliers", "subsample", "persistence", "embedding")
_MAX_EXACT_TICKS = 2**53
_S_PER_DAY = 86_400


def compute_map(
    table: EncounterTable,
    spells: Sequence[ModeSpell],
    recipe: Recipe,
    *,
    progress: Progress | None = None,
    kernels: Kernels | None = None,
    also_place: IntArray | None = None,
    doubts: Sequence[Doubt] | None = None,
) -> MapResult:
    """Make the map of all encounters of a table.

    Every connected component with a fair share of the encounters is mapped by itself: one whose share of the
    ``n_points`` of the subsample is at least 3 points, and always the largest. What was left out is said in ``warnings``.
    The result depends neither on the order of rows nor on clocks' zero; on the biobots' names only where encounters tie exactly.

    Parameters
    ----------
    spells
        Times in which biobots stood still; those by command make landmarks. Of the same clock as ``table``.
    progress
        Told of each stage; called in this thread.
    kernels
        What computes on the graphs; None takes the best there are. The map is the same.
    also_place
        Rows of the table to place besides the points, as ``others``; those that have no place are left out.
    doubts
        What is unlike the runs on which probabilities were checked; None asks the encounters themselves (`doubt_movement`).

    Raises
    ------
    TooFewEncountersError
        Fewer than two encounters.
    EngineMissingError
        The persistence engine is not installed.
    """
    report = progress or (lambda _stage, _share: None)
    mapped = _map_components(table, spells, recipe, report=report, kernels=kernels, also_place=also_place)
    models = load_models(recipe.method, recipe.metric) if recipe.replicates else None
    report("confidence", 1.0 - 1.0 / ((len(_STAGES) + 1) * len(mapped.placed)))
    if models is None:
        result = mapped.draw([part.is_real for part in mapped.placed])
    else:
        gathered = gather_evidence(table, spells, mapped.placed, recipe, map_again=mapped.map_again)
        known = doubt_movement(measure_walkers(table, spells)) if doubts is None else doubts
        verdict = judge_components(models, gathered, table, n_components=mapped.n_components, doubts=known)
        result = add_verdict(mapped.draw(verdict.is_hole), mapped.placed, verdict)
    report("done", 1.0)
    return result


def compute_evidence(
    table: EncounterTable, spells: Sequence[ModeSpell], recipe: Recipe, *, kernels: Kernels | None = None
) -> tuple[MapResult, tuple[Evidence, ...]]:
    """Make the map by the rule alone, and what would tell how sure it is: the models are trained on it.

    Raises
    ------
    TooFewEncountersError
        Fewer than two encounters.
    EngineMissingError
        The persistence engine is not installed.
    """
    mapped = _map_components(table, spells, recipe, report=lambda _stage, _share: None, kernels=kernels, also_place=None)
    gathered = gather_evidence(table, spells, mapped.placed, recipe, map_again=mapped.map_again)
    return mapped.draw([part.is_real for part in mapped.placed]), gathered


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Mapped:
    """The components of a map, not drawn yet, and what maps the largest component of some of the encounters in the same way.

    ``rows``, ``component`` and ``stands`` are as `mapper.assembly.add_others` takes them.
    """

    table: EncounterTable
    recipe: Recipe
    placed: tuple[PlacedComponent, ...]
    n_components: int
    warnings: tuple[str, ...]
    rows: IntArray
    component: IntArray
    stands: Stands
    map_again: MapAgain

    def draw(self, is_hole: Sequence[BoolArray]) -> MapResult:
        """Draw the components with these loops as holes, and put them side by side."""
        drawn = [
            draw_component(part, self.recipe, index=index, is_hole=holes)
            for index, (part, holes) in enumerate(zip(self.placed, is_hole, strict=True))
        ]
        result = assemble(self.table, drawn, self.recipe, n_components=self.n_components, warnings=self.warnings)
        return add_others(result, self.table, drawn, rows=self.rows, component=self.component, stands=self.stands)


def _map_components(
    table: EncounterTable,
    spells: Sequence[ModeSpell],
    recipe: Recipe,
    *,
    report: Progress,
    kernels: Kernels | None,
    also_place: IntArray | None,
) -> _Mapped:
    if len(table) < MIN_ENCOUNTERS:
        raise TooFewEncountersError(n_encounters=len(table), minimum=MIN_ENCOUNTERS)
    report("graph", 0.0)
    rules = recipe.betti_rules or load_trained_rules(recipe.method, recipe.metric).rules
    parts = build_components(table, spells, moving_time=recipe.moving_time, kernels=kernels)
    shares = share_points(parts.sizes, n_points=count_points(len(table), recipe))
    ticks_per_length = TICKS_PER_S / (recipe.speed_mps or 1.0)
    stands = find_stands(table, spells)
    rows = np.concatenate([stands.rows, np.empty(0, dtype=np.int64) if also_place is None else also_place])
    component, vertex = parts.locate(rows)
    contact = float(np.median(table.t_end_ns - table.t_start_ns)) * TICKS_PER_S / NS_PER_S
    placed = []
    for index, n_points in enumerate(shares):

        def begin(stage: str, done: int = index) -> None:
            report(stage, (done + _STAGES.index(stage) / (len(_STAGES) + 1)) / len(shares))

        placed.append(
            map_component(
                parts[index],
                recipe,
                rules,
                index=index,
                n_points=n_points,
                others=vertex[component == index],
                ticks_per_length=ticks_per_length,
                contact=contact,
                origin_ns=int(table.t_start_ns.min()),
                begin=begin,
            )
        )
    warnings = [*_warn_of_span(table), *_warn_of_landmarks(parts, spells), *_warn_of_components(parts, n_mapped=len(placed))]
    warnings += _warn_of_anchors(placed)
    warnings += [warning for part in placed for warning in part.warnings]

    def map_again(some: EncounterTable) -> PlacedComponent | None:
        if len(some) < MIN_ENCOUNTERS:
            return None
        part = build_components(some, spells, moving_time=recipe.moving_time, kernels=kernels)[0]
        n_points = count_points(len(some), recipe)
        return map_component(
            part,
            recipe,
            rules,
            index=0,
            n_points=n_points,
            others=np.zeros(0, dtype=np.int64),
            ticks_per_length=ticks_per_length,
            contact=contact,
            origin_ns=int(table.t_start_ns.min()),
            begin=lambda _stage: None,
        )

    return _Mapped(
        table=table,
        recipe=replace(recipe, betti_rules=rules),
        placed=tuple(placed),
        n_components=len(parts),
        warnings=tuple(warnings),
        rows=rows,
        component=component,
        stands=stands,
        map_again=map_again,
    )


def join_finished_maps(maps: Sequence[MapFile], recipe: Recipe, *, kernels: Kernels | None = None) -> MapResult:
    """Make one map of several finished ones, by the landmarks and encounters that they share; see `mapper.joined_map`.

    Parameters
    ----------
    recipe
        By which the maps were made.

    Raises
    ------
    UnlikeMapsError
        They were not made in one way.
    """
    check_alike(maps)
    rules = recipe.betti_rules or load_trained_rules(recipe.method, recipe.metric).rules
    placed, points, warnings = join_maps(maps, recipe, rules, kernels=kernels or choose_kernels())
    table = make_encounter_table(t_start_ns=points[:, 0], t_end_ns=points[:, 0], id1=points[:, 1], id2=points[:, 2])
    result = assemble(table, placed, replace(recipe, betti_rules=rules), n_components=len(placed), warnings=tuple(warnings))
    return replace(result, n_encounters=sum(part.summary.n_encounters for part in placed))


def count_points(n_encounters: int, recipe: Recipe) -> int:
    """Say how many points the subsample gets: fewer than ``n_points`` where too few encounters would stand behind each.

    Notes
    -----
    More points show smaller holes, but a point that few encounters confirm adds more noise than shape.
    """
    if recipe.encounters_per_point == 0:
        return recipe.n_points
    return min(recipe.n_points, max(_MIN_SAMPLE, n_encounters // recipe.encounters_per_point))


def share_points(sizes: Sequence[int], *, n_points: int) -> list[int]:
    """Share the points of the subsample among the components worth mapping.

    Parameters
    ----------
    sizes
        Encounters in each component, largest first.

    Returns
    -------
    list of int
        One number for each component mapped, in the same order; they sum to ``n_points``, and each but the first is at least 3.

    Notes
    -----
    In proportion to the encounters, by largest remainder; ties go to the larger component, then to the earlier.
    """
    total = sum(sizes)
    mapped = [size for index, size in enumerate(sizes) if index == 0 or size * n_points >= _MIN_POINTS * total]
    shares = [size * n_points // sum(mapped) for size in mapped]
    by_remainder = sorted(range(len(mapped)), key=lambda i: (-(mapped[i] * n_points % sum(mapped)), i))
    for i in by_remainder[: n_points - sum(shares)]:
        shares[i] += 1
    return shares


def _warn_of_span(table: EncounterTable) -> list[str]:
    span_ns = int(table.t_end_ns.max()) - int(table.t_start_ns.min())
    if span_ns * TICKS_PER_S // NS_PER_S < _MAX_EXACT_TICKS:
        return []
    days, exact_days = span_ns / NS_PER_S / _S_PER_DAY, _MAX_EXACT_TICKS / TICKS_PER_S / _S_PER_DAY
    return [f"the encounters span {days:.0f} days; times beyond {exact_days:.0f} are rounded; is a clock wrong?"]


def _warn_of_landmarks(parts: Components, spells: Sequence[ModeSpell]) -> list[str]:
    if parts.has_landmarks:
        return []
    if any(spell.mode is Mode.S and spell.cause is Cause.COMMAND for spell in spells):
        return [
            "no encounter lies in a commanded S spell, so there are no landmarks; do encounters and modes count time from the same instant?"
        ]
    return [
        "no landmarks: with nothing that stands still, distances measure time as much as place; name static biobots or give their modes"
    ]


def _warn_of_components(parts: Components, *, n_mapped: int) -> list[str]:
    if len(parts) == 1:
        return []
    left_out = sum(parts.sizes[n_mapped:])
    text = f"the encounters fall into {len(parts)} components that no biobot joins; {n_mapped} mapped apart, betti_numbers are summed"
    if left_out:
        text += f"; {len(parts) - n_mapped} with too few encounters ({left_out} in all) left out"
    return [text]


def _warn_of_anchors(placed: Sequence[PlacedComponent]) -> list[str]:
    lacking = [(index, part) for index, part in enumerate(placed) if part.n_anchors]
    if not lacking:
        return []
    next_step = "let 10-20 % of the biobots stand still"
    if len(lacking) > 1:
        counted = f"{len(lacking)} of the {len(placed)} components mapped have fewer than {MIN_LANDMARKS} landmarks, which profiles need"
        return [f"{counted}, so encounters serve as references there; {next_step}"]
    index, part = lacking[0]
    counted = f"component {index} has {part.summary.n_landmarks} of the {MIN_LANDMARKS} landmarks that profiles need"
    return [f"{counted}, so {part.n_anchors} of its encounters serve as references too; {next_step}"]
