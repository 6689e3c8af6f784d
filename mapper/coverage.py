"""How well the encounters so far cover the place: how fast they come, whose they are, whether they hang together, and what is missing."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from mapper.confidence import SURE_ENOUGH, WANTED_ENCOUNTERS, WANTED_LANDMARKS, WANTED_WALKERS
from mapper.groups import label_groups
from mapper.record_columns import to_unsigned
from mapper.report import JsonObject, JsonValue
from mapper.types import EncounterTable, IntArray, MapResult, ModeSpell
from mapper.wait_promise import RATE_MINUTES

MAX_MINUTES: Final = 1440
"""The series goes back so far before the newest encounter: a day."""
_NS_PER_S: Final = 1_000_000_000
_NS_PER_MIN: Final = 60 * _NS_PER_S


def describe_coverage(table: EncounterTable, spells: Sequence[ModeSpell], result: MapResult | None, *, minimum: int) -> JsonObject:
    """Describe how well encounters cover the place.

    Parameters
    ----------
    table, spells
        What the map is of, or would be.
    result
        The map; None: there are fewer than ``minimum`` encounters.

    Returns
    -------
    JsonObject
        ``per_minute``: ``begin_s`` of the first minute [s since 1970, null where there are no encounters] and encounters begun in each, a
        day at most; ``rate_per_min`` over the last five; ``biobots`` with id, encounters, their rate, and the last one's end;
        ``giant_share`` of encounters and ``giant_biobots`` in the largest group of biobots that encounters join; ``landmarks`` and those
        ``unmet_landmarks`` that nobody met; ``well_seen_share`` of the map's points; ``data``: whether that is enough, why not, what would
        help, and in how many seconds it is to be expected at this rate, null where waiting alone does not help or nobody can tell; whether
        anything arrives at all is judged when somebody asks (`mapper.wait_promise`).
    """
    ids, number = np.unique(np.concatenate([table.id1, table.id2]), return_inverse=True)
    first, second = number[: len(table)], number[len(table) :]
    last_ns = np.zeros(len(ids), dtype=np.int64)
    np.maximum.at(last_ns, first, table.t_end_ns)
    np.maximum.at(last_ns, second, table.t_end_ns)
    counts = np.bincount(number, minlength=len(ids))
    standing = sorted(
        {int(spell.node) for spell in spells if spell.mode is Mode.S and spell.cause is Cause.COMMAND and _lasts(spell, table)}
    )
    met = set(ids.tolist())
    n_lately, minutes = _last_minutes(table)
    lately = np.bincount(np.concatenate([first[-n_lately:], second[-n_lately:]]) if n_lately else number[:0], minlength=len(ids)) / minutes
    rate = n_lately / minutes
    seen = None if result is None or result.points.is_well_seen is None else float(result.points.is_well_seen.mean())
    return {
        "n_encounters": len(table),
        "per_minute": _per_minute(table),
        "rate_per_min": rate,
        "biobots": [
            {
                "id": to_unsigned(node),
                "key": str(to_unsigned(node)),
                "n_encounters": n,
                "per_minute": fresh,
                "last_encounter_wall_ns": end,
            }
            for node, n, fresh, end in zip(ids.tolist(), counts.tolist(), lately.tolist(), last_ns.tolist(), strict=True)
        ],
        **_giant(first, second, n_biobots=len(ids)),
        "n_components": None if result is None else result.n_components,
        "landmarks": [to_unsigned(node) for node in standing],
        "unmet_landmarks": [to_unsigned(node) for node in standing if node not in met],
        "well_seen_share": seen,
        "data": _judge(table, result, rate=rate, n_biobots=len(ids), n_standing=len(met & set(standing)), minimum=minimum),
    }


def _lasts(spell: ModeSpell, table: EncounterTable) -> bool:
    """Say whether a spell reaches into the time of the encounters, or lasts."""
    return spell.t_end_ns is None or (len(table) > 0 and spell.t_end_ns >= int(table.t_start_ns[0]))


def _per_minute(table: EncounterTable) -> JsonObject:
    if not len(table):
        return {"begin_s": None, "counts": []}
    minutes = table.t_start_ns // _NS_PER_MIN
    last = int(minutes[-1])
    first = max(int(minutes[0]), last - MAX_MINUTES + 1)
    counts = np.bincount((minutes[np.searchsorted(minutes, first) :] - first).astype(np.int64), minlength=last - first + 1)
    return {"begin_s": first * 60, "counts": counts.tolist()}


def _last_minutes(table: EncounterTable) -> tuple[int, float]:
    """Count encounters of the last minutes, or of all the time there is where that is less; and say how many minutes that is."""
    if not len(table):
        return 0, 1.0
    last = int(table.t_start_ns[-1])
    since = max(last - RATE_MINUTES * _NS_PER_MIN, int(table.t_start_ns[0]))
    n = len(table) - int(np.searchsorted(table.t_start_ns, since, side="left"))
    return n, max(last - since, _NS_PER_S) / _NS_PER_MIN


def _giant(first: IntArray, second: IntArray, *, n_biobots: int) -> JsonObject:
    if not n_biobots:
        return {"giant_share": None, "giant_biobots": 0}
    group = label_groups(first, second, n=n_biobots)
    encounters = np.bincount(group[first])
    largest = int(encounters.argmax())
    return {"giant_share": float(encounters[largest] / len(first)), "giant_biobots": int(np.count_nonzero(group == largest))}


def _judge(
    table: EncounterTable, result: MapResult | None, *, rate: float, n_biobots: int, n_standing: int, minimum: int
) -> JsonObject | None:
    """Say whether the encounters are enough, and when they will be."""
    if result is None:
        counted = "1 encounter" if len(table) == 1 else f"{len(table)} encounters"
        return {
            "is_enough": False,
            "reasons": [f"{counted}; a map needs at least {minimum}"],
            "remedies": ["let the biobots walk"],
            "expected_wait_s": _wait_s(max(minimum, WANTED_ENCOUNTERS * n_biobots // 2) - len(table), rate=rate),
            "nothing_arrives": None,
        }
    if result.data is None or result.hole_count is None:
        return None
    reasons: list[JsonValue] = list(result.data.reasons)
    remedies: list[JsonValue] = list(result.data.remedies)
    wanted = WANTED_ENCOUNTERS * n_biobots / 2.0
    if result.hole_count.probability < SURE_ENOUGH:
        # Twice the encounters are what the remedies ask for.
        wanted = max(wanted, 2.0 * len(table))
    lacks_biobots = result.components[0].n_landmarks < WANTED_LANDMARKS or n_biobots - n_standing < WANTED_WALKERS
    helps_to_wait = result.hole_count.is_known and not lacks_biobots
    expected = 0.0 if result.data.is_enough else None if not helps_to_wait else _wait_s(wanted - len(table), rate=rate)
    return {
        "is_enough": result.data.is_enough,
        "reasons": reasons,
        "remedies": remedies,
        "expected_wait_s": expected,
        "nothing_arrives": None,
    }


def _wait_s(n_missing: float, *, rate: float) -> float | None:
    """Say how long so many encounters take at a rate; None where none come, or where it is not encounters that are missing."""
    return 60.0 * n_missing / rate if rate > 0.0 and n_missing > 0 else None
