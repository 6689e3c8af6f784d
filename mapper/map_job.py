"""The jobs of the computing process: from what has changed in the store to the documents that are served.

The process keeps its own copy of the encounters, so that each map costs the serving process no more than what is new. The pipeline is
imported where it runs: the serving process needs these functions only by name.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from mapper.errors import MapDocumentError
from mapper.named_pins import Framing, NamedPin
from mapper.record_columns import to_unsigned
from mapper.replica import Replica, StoreDelta
from mapper.window import clip_table, rows_dated_ahead, select_rows, window_begin

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mapper.report import JsonObject, JsonValue
    from mapper.types import MapResult, Recipe

_NS_PER_S = 1e9

_replica: Final = Replica()
"""This process's copy; the serving process has one too, and leaves it empty."""


class OutOfStep(msgspec.Struct, frozen=True):
    """The process does not have what the delta builds on; it wants everything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TooFew:
    """There are fewer encounters than a map needs; ``where``, in words; ``n_ahead`` and ``coverage_json`` as in `MapDocuments`."""

    n_encounters: int
    minimum: int
    where: str
    n_ahead: int
    coverage_json: bytes


class MapDocuments(msgspec.Struct, frozen=True, kw_only=True):
    """A finished map: JSON objects, the result for pictures as `encode_map` writes it, and what stands behind it.

    The map is of ``n_encounters``, the last of which ended at ``last_encounter_ns`` [wall clock]; ``n_before`` were over at ``since_ns``:
    when the landmarks were set or the window begins, whichever is later; None where there is neither. ``n_ahead`` of all that are known
    were dated ahead of this machine's clock. ``framing``: where the pins known then are on it. ``lengths``: between its points, as
    `encode_lengths` writes them; None where they were not kept.
    """

    map_json: bytes
    diagram_json: bytes
    barcode_json: bytes
    coverage_json: bytes
    drawing: bytes
    framing: Framing
    n_encounters: int
    n_before: int
    since_ns: int | None
    last_encounter_ns: int
    n_ahead: int
    lengths: bytes | None = None


def make_map(
    delta: StoreDelta,
    recipe: Recipe,
    *,
    window_ns: int | None,
    now_ns: int,
    pins: tuple[NamedPin, ...] = (),
    previous: bytes | None = None,
) -> MapDocuments | TooFew | OutOfStep:
    """Bring this process's copy up to date, compute the map of what counts, and put it into JSON.

    Parameters
    ----------
    now_ns
        The time of this machine's wall clock. A window ends at the newest encounter that is not dated ahead of it, and those that are
        dated ahead are left out: one wrong clock would take the window away from all others. Where all are, it is this machine's
        clock that is wrong, and nothing is left out for that.
    pins
        Places that the operator named.
    previous
        JSON of the map before: this one is laid over it, so that what stands still stands still in the picture. None: there is none.
    """
    from mapper.coverage import describe_coverage  # noqa: PLC0415  # see the module's docstring
    from mapper.interval_lists import describe_barcode, describe_diagram  # noqa: PLC0415  # same
    from mapper.length_shares import encode_lengths  # noqa: PLC0415  # same
    from mapper.map_alignment import align_map  # noqa: PLC0415  # same
    from mapper.map_codec import encode_map  # noqa: PLC0415  # same
    from mapper.map_framing import frame_map  # noqa: PLC0415  # same
    from mapper.map_marks import read_marks  # noqa: PLC0415  # same
    from mapper.pipeline import MIN_ENCOUNTERS, compute_map  # noqa: PLC0415  # same

    if not _replica.take(delta):
        return OutOfStep()
    whole, spells = _replica.encounters.table(), _replica.modes.spells()
    is_ahead = rows_dated_ahead(whole, now_ns=now_ns)
    n_ahead = int(np.count_nonzero(is_ahead))
    known = whole if window_ns is None or n_ahead in {0, len(whole)} else select_rows(whole, ~is_ahead)
    since_ns = window_begin(known, window_ns=window_ns, since_ns=_replica.since_ns)
    table = clip_table(known, since_ns=since_ns)
    if len(table) < MIN_ENCOUNTERS:
        where = "yet" if since_ns is None else "since time 0 of the mission" if since_ns == _replica.since_ns else "in the window"
        coverage = msgspec.json.encode(describe_coverage(table, spells, None, minimum=MIN_ENCOUNTERS))
        return TooFew(n_encounters=len(table), minimum=MIN_ENCOUNTERS, where=where, n_ahead=n_ahead, coverage_json=coverage)
    result, fit = compute_map(table, spells, recipe), None
    if previous is not None:
        with suppress(MapDocumentError):  # another version of the program may have written it in another form
            result, fit = align_map(result, read_marks(previous, source="the map before"))
    n_before, last_encounter_ns = len(known) - len(table), int(table.t_end_ns.max())
    facts: JsonObject = {
        "window_s": None if window_ns is None else window_ns / _NS_PER_S,
        "since_s": None if since_ns is None else since_ns / _NS_PER_S,
        "until_s": None,
        "n_before": n_before,
        "n_ahead": n_ahead,
        "aligned": None if fit is None else {"n_shared": fit.n_shared, "rms": fit.rms},
        "last_encounter_s": last_encounter_ns / _NS_PER_S,
    }
    return MapDocuments(
        map_json=write_map(result, facts),
        diagram_json=msgspec.json.encode(describe_diagram(result)),
        barcode_json=msgspec.json.encode(describe_barcode(result)),
        coverage_json=msgspec.json.encode(describe_coverage(table, spells, result, minimum=MIN_ENCOUNTERS)),
        drawing=encode_map(result),
        framing=frame_map(result, pins),
        n_encounters=result.n_encounters,
        n_before=n_before,
        since_ns=since_ns,
        last_encounter_ns=last_encounter_ns,
        n_ahead=n_ahead,
        lengths=encode_lengths(result),
    )


def write_map(result: MapResult, facts: JsonObject) -> bytes:
    """Write the map of a store as JSON, its ids as they are on the air; ``facts`` are members besides."""
    from mapper.report import to_json_object  # noqa: PLC0415  # see the module's docstring

    document = to_json_object(result)
    for point, id1, id2 in zip(_objects(document["points"]), result.points.id1.tolist(), result.points.id2.tolist(), strict=True):
        point["id1"], point["id2"] = to_unsigned(id1), to_unsigned(id2)
    return msgspec.json.encode(document | facts)


def _objects(value: JsonValue) -> Iterable[JsonObject]:
    return (item for item in value if isinstance(item, dict)) if isinstance(value, list) else ()
