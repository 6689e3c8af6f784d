"""The encounter metric straight from its definition: every two encounters that share a biobot are joined, and all paths are tried.

Slow, and written without any of the mapper's shortcuts. Times are in half nanoseconds.
"""

from collections.abc import Sequence

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from mapper.types import EncounterTable, FloatArray, ModeSpell


def literal_distances(table: EncounterTable, spells: Sequence[ModeSpell], *, moving_time: bool) -> FloatArray:
    """All-pairs shortest paths, [Dir16] eq. 6-8, by Floyd and Warshall."""
    rows = list(zip(table.t_start_ns.tolist(), table.t_end_ns.tolist(), table.id1.tolist(), table.id2.tolist(), strict=True))
    n = len(rows)
    distances = np.full((n, n), np.inf)
    for i, (start_i, end_i, *ids_i) in enumerate(rows):
        for j, (start_j, end_j, *ids_j) in enumerate(rows):
            for biobot in set(ids_i) & set(ids_j):
                low, high = sorted((start_i + end_i, start_j + end_j))
                weight = literal_weight(biobot, low, high, spells, moving_time=moving_time)
                distances[i, j] = min(distances[i, j], weight)
    for k in range(n):
        distances = np.minimum(distances, distances[:, k, None] + distances[None, k, :])
    return distances


def literal_weight(biobot: int, low: int, high: int, spells: Sequence[ModeSpell], *, moving_time: bool) -> int:
    """Weigh the edge between two encounters of a biobot whose centres are ``low`` and ``high``."""
    is_one_stand = stopped(biobot, low, high, spells, causes=(Cause.COMMAND,)) == high - low
    if is_one_stand and is_in_community(biobot, low, spells) and is_in_community(biobot, high, spells):
        return 0
    return high - low - (stopped(biobot, low, high, spells, causes=tuple(Cause)) if moving_time else 0)


def is_in_community(biobot: int, at: int, spells: Sequence[ModeSpell]) -> bool:
    """Say whether a centre lies in a commanded static spell of a biobot."""
    return any(
        spell.node == biobot
        and spell.mode is Mode.S
        and spell.cause is Cause.COMMAND
        and 2 * spell.t_start_ns <= at
        and (spell.t_end_ns is None or at <= 2 * spell.t_end_ns)
        for spell in spells
    )


def stopped(biobot: int, low: int, high: int, spells: Sequence[ModeSpell], *, causes: Sequence[Cause]) -> int:
    """Count, one tick after the other, the time between two centres that a biobot was static."""
    mine = [spell for spell in spells if spell.node == biobot and spell.mode is Mode.S and spell.cause in causes]
    return sum(
        any(2 * spell.t_start_ns <= tick and (spell.t_end_ns is None or tick + 1 <= 2 * spell.t_end_ns) for spell in mine)
        for tick in range(low, high)
    )
