"""From a log to its map, with who stands still and what cannot be concluded."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from mapper.assumptions import judge_assumptions, walks_at_random
from mapper.contact_statistics import measure_contacts
from mapper.kernels import Kernels
from mapper.pipeline import compute_map
from mapper.reading import ProximityLog
from mapper.standing import choose_standing, number_given
from mapper.types import EncounterTable, IntArray, MapResult, ModeSpell, Recipe, StandingSource
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
    stood = {int(spell.node) for spell in still if spell.mode is Mode.S and spell.cause is Cause.COMMAND}
    statistics = measure_contacts(table, np.array(sorted(stood), dtype=np.int64))
    result = compute_map(table, still, recipe, kernels=kernels, also_place=also_place, walks_at_random=walks_at_random(statistics))
    warnings = [*log.warnings, *result.warnings]
    if absent:
        warnings.append(f"stationary biobots {', '.join(absent)} are in no encounter")
    if standing.source in {StandingSource.COLUMN, StandingSource.FOUND}:
        warnings.append(f"{len(standing.nodes)} nodes are taken to stand still: {standing.reason}")
    result = replace(result, warnings=tuple(warnings), node_names=log.names.text_of, standing=standing)
    return replace(result, assumptions=judge_assumptions(log, result, standing, statistics))
