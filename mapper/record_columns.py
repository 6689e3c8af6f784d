"""The store's memory: records as columns of numbers, ready to become a table of encounters and mode spells.

Node ids are unsigned 64-bit numbers (an EUI-64 is), but columns and tables hold signed ones: ids from 2**63 on are kept as
negative numbers, by `to_signed`, and named properly again, by `to_unsigned`, where people see them.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, MissionRecord, ModeRecord
from firmware_protocol.units import NodeId
from mapper.types import EncounterTable, IntArray, ModeSpell
from mapper.window import make_encounter_table

_MAX_INTEGER = 2**63 - 1
# Year 2116: any two instants below differ by less than a table can span.
_MAX_WALL_NS = 2**62
_FIRST_CAPACITY = 1024


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoreSnapshot:
    """What a map is made of, at one moment.

    ``since_ns`` is time 0, the moment the landmarks were set [wall clock]; None where no mission did that. The ``n_before`` encounters
    that were over by then are not in ``table``. ``n_encounters_of`` counts all encounters of each biobot (unsigned ids).
    """

    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    since_ns: int | None
    n_before: int
    n_encounters_of: Mapping[NodeId, int]


def to_signed(node: int) -> NodeId:
    """Return the 64-bit two's complement number of an unsigned id."""
    return NodeId(node - 2**64 if node > _MAX_INTEGER else node)


def to_unsigned(node: int) -> NodeId:
    """Invert `to_signed`."""
    return NodeId(node + 2**64 if node < 0 else node)


def wall_interval(record: JournalRecord) -> tuple[int, int | None]:
    """Return begin and end of what is recorded on the wall clock [ns since 1970, UTC]."""
    end = record.t_start_ns if isinstance(record, MissionRecord) else record.t_end_ns
    return record.t_start_ns + record.wall_anchor_ns, None if end is None else end + record.wall_anchor_ns


def is_fit(record: JournalRecord) -> bool:
    """Say whether a record can be meant: it ends after it begins, between 1970 and 2116, and nobody meets itself."""
    begin, end = wall_interval(record)
    if not 0 <= begin <= (begin if end is None else end) < _MAX_WALL_NS:
        return False
    if isinstance(record, EncounterRecord) and record.node_a == record.node_b:
        return False
    return record.boot >= 0 and max(record.boot, record.sequence, record.revision) <= _MAX_INTEGER


class EncounterColumns:
    """Encounters by row number; a row that holds none, or a void one, does not count."""

    def __init__(self) -> None:
        # Rows: begin, end [ns, wall clock], the two ids (signed), and whether it counts.
        self._columns: IntArray = np.zeros((5, _FIRST_CAPACITY), dtype=np.int64)
        self._n_rows = 0
        self.n_counting = 0

    def put(self, row: int, record: EncounterRecord) -> None:
        """Set a row; a later record of the same row takes its place."""
        capacity = self._columns.shape[1]
        if row >= capacity:
            grown = np.zeros((5, max(2 * capacity, row + 1)), dtype=np.int64)
            grown[:, :capacity] = self._columns
            self._columns = grown
        begin, end = record.t_start_ns + record.wall_anchor_ns, record.t_end_ns + record.wall_anchor_ns
        self.n_counting += (not record.is_void) - int(self._columns[4, row])
        self._columns[:, row] = (begin, end, to_signed(record.node_a), to_signed(record.node_b), int(not record.is_void))
        self._n_rows = max(self._n_rows, row + 1)

    def table(self, *, since_ns: int | None) -> EncounterTable:
        """Return the encounters that count in canonical order; those over at ``since_ns`` do not, those under way then begin there."""
        begin, end, id1, id2, counts = self._columns[:, : self._n_rows]
        chosen = counts.astype(np.bool_)
        if since_ns is not None:
            chosen &= end > since_ns
            begin = np.maximum(begin, since_ns)
        return make_encounter_table(t_start_ns=begin[chosen], t_end_ns=end[chosen], id1=id1[chosen], id2=id2[chosen])

    def count_by_node(self) -> Mapping[NodeId, int]:
        """Count the encounters of each biobot."""
        _, _, id1, id2, counts = self._columns[:, : self._n_rows]
        chosen = counts.astype(np.bool_)
        nodes, numbers = np.unique(np.concatenate([id1[chosen], id2[chosen]]), return_counts=True)
        return {to_unsigned(node): number for node, number in zip(nodes.tolist(), numbers.tolist(), strict=True)}


class ModeSpells:
    """Mode records by row number."""

    def __init__(self) -> None:
        self._records: dict[int, ModeRecord] = {}

    def put(self, row: int, record: ModeRecord) -> None:
        """Set a row; a later record of the same row takes its place."""
        self._records[row] = record

    def spells(self) -> tuple[ModeSpell, ...]:
        """Return all spells by biobot and begin; one ends at the latest where the next of the same biobot begins."""
        spells: list[ModeSpell] = []
        for node, records in sorted(self._by_node().items()):
            for record in records:
                begin, end = wall_interval(record)
                if spells and spells[-1].node == node:
                    before = spells[-1]
                    if before.t_end_ns is None or before.t_end_ns > begin:
                        spells[-1] = replace(before, t_end_ns=begin)
                spells.append(ModeSpell(node=node, t_start_ns=begin, t_end_ns=end, mode=record.mode, cause=record.cause))
        return tuple(spells)

    def latest(self) -> tuple[ModeRecord, ...]:
        """Return the record that began last for every biobot."""
        return tuple(records[-1] for records in self._by_node().values())

    def _by_node(self) -> dict[NodeId, list[ModeRecord]]:
        by_node: defaultdict[NodeId, list[ModeRecord]] = defaultdict(list)
        for record in sorted(self._records.values(), key=lambda record: (wall_interval(record)[0], record.identity)):
            by_node[to_signed(record.node)].append(record)
        return by_node
