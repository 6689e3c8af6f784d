"""Where and when biobots stood by command: one encounter of each such stand, which tells its place, and the landmarks made of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.types import BoolArray, EncounterTable, FloatArray, IntArray, Landmark, ModeSpell


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stands:
    """Commanded static spells in which somebody was met; ``rows``, shape (k,), is the first encounter in each.

    They are in the order of their begins, then of those encounters.
    """

    spells: tuple[ModeSpell, ...]
    rows: IntArray


def find_stands(table: EncounterTable, spells: Sequence[ModeSpell]) -> Stands:
    """Find the commanded static spells that hold the centre of an encounter of their biobot.

    Those that touch or overlap are one. They are cut to the time of the encounters; one that lasts to its end has no end.
    """
    commanded = _merge([spell for spell in spells if spell.mode is Mode.S and spell.cause is Cause.COMMAND])
    if not commanded or not len(table):
        return Stands(spells=(), rows=np.empty(0, dtype=np.int64))
    nodes = np.unique(np.array([spell.node for spell in commanded], dtype=np.int64))
    rows, who = _rows_of(table, nodes)
    centres = table.t_start_ns[rows] + (table.t_end_ns[rows] - table.t_start_ns[rows]) // 2
    begins, ends = np.searchsorted(who, nodes), np.searchsorted(who, nodes, side="right")
    first_ns, last_ns = int(table.t_start_ns[0]), int(table.t_end_ns.max())
    found = []
    for spell in commanded:
        own = slice(*(int(bounds[np.searchsorted(nodes, spell.node)]) for bounds in (begins, ends)))
        end_ns = np.iinfo(np.int64).max if spell.t_end_ns is None else spell.t_end_ns
        inside = rows[own][(centres[own] >= spell.t_start_ns) & (centres[own] <= end_ns)]
        if len(inside):
            begin_ns = max(spell.t_start_ns, first_ns)
            own_end_ns = None if end_ns >= last_ns else end_ns
            found.append((begin_ns, int(inside[0]), replace(spell, t_start_ns=begin_ns, t_end_ns=own_end_ns)))
    found.sort(key=lambda stand: (*stand[:2], stand[2].node))
    return Stands(spells=tuple(spell for _, _, spell in found), rows=np.array([row for _, row, _ in found], dtype=np.int64))


def make_landmarks(stands: Stands, *, is_placed: BoolArray, places: FloatArray, component: IntArray) -> tuple[Landmark, ...]:
    """Make landmarks of the stands that have a place.

    Parameters
    ----------
    is_placed
        Which stands have one, shape (k,).
    places, component
        Of those that do, in their order: shapes (p, 2) and (p,).
    """
    spells = [spell for spell, has_place in zip(stands.spells, is_placed.tolist(), strict=True) if has_place]
    return tuple(
        Landmark(node=NodeId(int(spell.node)), t_start_ns=spell.t_start_ns, t_end_ns=spell.t_end_ns, x=x, y=y, component=part)
        for spell, (x, y), part in zip(spells, places.tolist(), component.tolist(), strict=True)
    )


def _merge(spells: list[ModeSpell]) -> list[ModeSpell]:
    merged: list[ModeSpell] = []
    for spell in sorted(spells, key=lambda spell: (spell.node, spell.t_start_ns)):
        last = merged[-1] if merged and merged[-1].node == spell.node else None
        if last is not None and (last.t_end_ns is None or spell.t_start_ns <= last.t_end_ns):
            is_open = last.t_end_ns is None or spell.t_end_ns is None
            end_ns = None if is_open else max(last.t_end_ns or spell.t_start_ns, spell.t_end_ns or spell.t_start_ns)
            merged[-1] = replace(last, t_end_ns=end_ns)
        else:
            merged.append(spell)
    return merged


def _rows_of(table: EncounterTable, nodes: IntArray) -> tuple[IntArray, IntArray]:
    """Return the rows of some biobots, sorted by biobot, then row, and the biobot of each; a row of two of them is there twice."""
    is_first, is_second = np.isin(table.id1, nodes), np.isin(table.id2, nodes)
    rows = np.concatenate([np.flatnonzero(is_first), np.flatnonzero(is_second)])
    who = np.concatenate([table.id1[is_first], table.id2[is_second]])
    order = np.lexsort((rows, who))
    return rows[order], who[order]
