"""The job of the process for orders: the map of a time, by a method, computed beside the live one and apart from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mapper.map_job import TooFew, write_map
from mapper.replica import Replica, StoreDelta
from mapper.window import clip_table

if TYPE_CHECKING:
    from mapper.named_pins import NamedPin
    from mapper.report import JsonObject
    from mapper.types import Recipe
    from mapper.worker import Progress

_NS_PER_S = 1e9


class PeriodMap(msgspec.Struct, frozen=True, kw_only=True):
    """A map as JSON, without who ordered it and when, and the operator's frame as JSON."""

    map_json: bytes
    frame_json: bytes
    n_encounters: int


def make_period_map(
    progress: Progress,
    delta: StoreDelta,
    recipe: Recipe,
    *,
    since_ns: int | None,
    until_ns: int | None,
    n_before: int,
    pins: tuple[NamedPin, ...],
) -> PeriodMap | TooFew:
    """Make the map of encounters that were not over at ``since_ns`` and had begun before ``until_ns`` [wall clock]; None: all.

    Parameters
    ----------
    progress
        Told of the stages.
    delta
        What the store has of that time.
    n_before
        Encounters that were over by then.
    """
    from mapper.map_framing import frame_map  # noqa: PLC0415  # the serving process needs this function only by name
    from mapper.pipeline import MIN_ENCOUNTERS, compute_map  # noqa: PLC0415  # same

    progress("taking in", 0.0)
    replica = Replica()
    replica.take(delta)
    table = clip_table(replica.encounters.table(), since_ns=since_ns, until_ns=until_ns)
    if len(table) < MIN_ENCOUNTERS:
        return TooFew(n_encounters=len(table), minimum=MIN_ENCOUNTERS, where="in that time", n_ahead=0, coverage_json=b"null")
    result = compute_map(table, replica.modes.spells(), recipe, progress=progress)
    progress("writing", 1.0)
    facts: JsonObject = {
        "window_s": None,
        "since_s": None if since_ns is None else since_ns / _NS_PER_S,
        "until_s": None if until_ns is None else until_ns / _NS_PER_S,
        "n_before": n_before,
        "n_ahead": 0,
        "last_encounter_s": int(table.t_end_ns.max()) / _NS_PER_S,
    }
    framing = frame_map(result, pins)
    return PeriodMap(map_json=write_map(result, facts), frame_json=framing.frame_json, n_encounters=result.n_encounters)
