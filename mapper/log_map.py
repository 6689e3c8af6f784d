"""From a log to its map, with who stands still and what cannot be concluded."""

from collections.abc import Sequence
from dataclasses import replace

from mapper.assumptions import judge_assumptions
from mapper.confidence import doubt_movement, doubt_repeats, doubt_times
from mapper.contact_statistics import ContactStatistics, measure_walkers
from mapper.kernels import Kernels
from mapper.pipeline import compute_map
from mapper.reading import ProximityLog
from mapper.standing import choose_standing, number_given
from mapper.time_doubts import doubt_modes, doubt_unit
from mapper.types import DataVerdict, EncounterTable, IntArray, MapResult, ModeSpell, Recipe, StandingSource
from mapper.window import stationary_spells


def map_log(
    log: ProximityLog,
    table: EncounterTable,
    recipe: Recipe,
    *,
    spells: Sequence[ModeSpell] | None,
    stationary: Sequence[str] | None,
    searches: bool | None,
    kernels: Kernels,
    also_place: IntArray | None = None,
) -> MapResult:
    """Map the encounters of a log.

    Parameters
    ----------
    table
        The log's encounters, or those of a part of its time.
    spells
        Modes of its nodes, None where there are none.
    stationary
        Ids, as the log has them, that a person says stand still; None where nobody says so.
    searches
        Whether to look for them; None does so where neither modes nor a person tell.
    also_place
        As for `mapper.pipeline.compute_map`.

    Raises
    ------
    UnknownBiobotError
        None of ``stationary`` is in any encounter.
    TooFewEncountersError, EngineMissingError
        As for `mapper.pipeline.compute_map`.
    """
    given, absent = (None, ()) if stationary is None else number_given(table, log.names, stationary)
    standing = choose_standing(
        table,
        given=given,
        has_modes=spells is not None,
        places=log.places,
        place_column=log.place_column,
        searches=searches,
        kernels=kernels,
    )
    still = (*(spells or ()), *stationary_spells(table, standing.nodes))
    statistics = measure_walkers(table, still)
    doubts = (*doubt_movement(statistics), *doubt_times(statistics, tick_ns=log.tick_ns))
    result = compute_map(table, still, recipe, kernels=kernels, also_place=also_place, doubts=doubts)
    warnings = [*log.warnings, *doubt_unit(log.table), *_repeats(statistics), *doubt_modes(log.table, spells or ()), *result.warnings]
    if absent:
        warnings.append(f"stationary biobots {', '.join(absent)} are in no encounter")
    if standing.source in {StandingSource.COLUMN, StandingSource.FOUND}:
        warnings.append(f"{len(standing.nodes)} nodes are taken to stand still: {standing.reason}")
    result = replace(result, warnings=tuple(warnings), node_names=log.names.text_of, standing=standing)
    return _agreeing(replace(result, assumptions=judge_assumptions(log, result, standing, statistics)))


def _repeats(statistics: ContactStatistics) -> tuple[str, ...]:
    return tuple(f"{doubt.reason}; {doubt.remedy}" for doubt in doubt_repeats(statistics))


def _agreeing(result: MapResult) -> MapResult:
    """Say that the data are not enough where the log says that the count of holes is not to be trusted, whatever else they say."""
    (count,) = (one for one in result.assumptions if one.name == "hole_count")
    if count.holds is not False or result.data is None or not result.data.is_enough:
        return result
    return replace(result, data=DataVerdict(is_enough=False, reasons=(count.text,), remedies=()))
