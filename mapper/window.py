"""The records that count: encounters in canonical order, and who stood still for how long."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.errors import UnknownBiobotError
from mapper.types import EncounterTable, ModeSpell, read_only

# A centre in half nanoseconds must fit 63 bits.
_MAX_SPAN_NS = 2**62 - 1


def make_encounter_table(*, t_start_ns: ArrayLike, t_end_ns: ArrayLike, id1: ArrayLike, id2: ArrayLike) -> EncounterTable:
    """Put encounters in canonical order: by start, end, then ids; ``id1`` becomes the lower id.

    Parameters
    ----------
    t_start_ns, t_end_ns
        When each encounter began and ended [ns], shape (n,), of one clock; whole numbers of magnitude below 4e18.
    id1, id2
        Its biobots, shape (n,), in either order.

    Raises
    ------
    ValueError
        Shapes differ, an encounter ends before it begins, a biobot meets itself, or the whole record spans more than 2**62 ns (146 years).
    """
    start, end, first, second = (np.asarray(column, dtype=np.int64) for column in (t_start_ns, t_end_ns, id1, id2))
    if not (start.ndim == 1 and start.shape == end.shape == first.shape == second.shape):
        raise ValueError(f"columns have shapes {start.shape}, {end.shape}, {first.shape}, {second.shape}; wanted one length for all")
    if np.any(end < start) or np.any(first == second):
        raise ValueError("an encounter ends before it begins, or a biobot meets itself; check rows where they enter")
    if len(start) and int(end.max()) - int(start.min()) > _MAX_SPAN_NS:
        raise ValueError(f"encounters span {int(end.max()) - int(start.min())} ns; wanted at most {_MAX_SPAN_NS}; are two clocks mixed?")
    low, high = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((high, low, end, start))
    return EncounterTable(
        t_start_ns=read_only(start[order]),
        t_end_ns=read_only(end[order]),
        id1=read_only(low[order]),
        id2=read_only(high[order]),
        source_row=read_only(order.astype(np.int64)),
    )


def stationary_spells(table: EncounterTable, ids: Sequence[int]) -> tuple[ModeSpell, ...]:
    """Make one commanded static spell over the whole record for each biobot named, in ascending order of ids."""
    if len(table) == 0:
        return ()
    begin = int(table.t_start_ns[0])
    return tuple(
        ModeSpell(node=NodeId(node), t_start_ns=begin, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for node in sorted(set(ids))
    )


def absent_biobots(table: EncounterTable, ids: Sequence[int]) -> tuple[int, ...]:
    """List those of some biobots that are in no encounter, ascending.

    Raises
    ------
    UnknownBiobotError
        None of them is in any; with no ids nothing is raised.
    """
    present = set(table.id1.tolist()) | set(table.id2.tolist())
    absent = tuple(sorted(set(ids) - present))
    if absent and len(absent) == len(set(ids)):
        raise UnknownBiobotError(ids=absent)
    return absent
