"""Who stood still and who walked, and when: mode records by row, and the spells they tell of."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace

from firmware_protocol.contract.records import ModeRecord
from firmware_protocol.units import NodeId
from mapper.record_columns import to_signed, wall_interval
from mapper.types import ModeSpell


class ModeSpells:
    """Mode records by row number, each with the number of the change that set it."""

    def __init__(self) -> None:
        # In the order of changes: the newest is last.
        self._records: dict[int, tuple[int, ModeRecord]] = {}
        self._spells: tuple[ModeSpell, ...] | None = None

    def put(self, row: int, record: ModeRecord, *, change: int) -> None:
        """Set a row; changes come in ascending order."""
        self._records.pop(row, None)
        self._records[row] = (change, record)
        self._spells = None

    def changed_after(self, change: int) -> tuple[tuple[int, int, ModeRecord], ...]:
        """Return row, change and record of those set after a change, in the order of changes."""
        news: list[tuple[int, int, ModeRecord]] = []
        for row, (number, record) in reversed(self._records.items()):
            if number <= change:
                break
            news.append((row, number, record))
        return tuple(reversed(news))

    def spells(self) -> tuple[ModeSpell, ...]:
        """Return all spells by biobot and begin; one ends at the latest where the next of the same biobot begins."""
        if self._spells is None:
            self._spells = tuple(_cut(self._by_node()))
        return self._spells

    def latest(self) -> tuple[ModeRecord, ...]:
        """Return the record that began last for every biobot."""
        return tuple(records[-1] for records in self._by_node().values())

    def _by_node(self) -> dict[NodeId, list[ModeRecord]]:
        by_node: defaultdict[NodeId, list[ModeRecord]] = defaultdict(list)
        for _, record in sorted(self._records.values(), key=lambda item: (wall_interval(item[1])[0], item[1].identity)):
            by_node[to_signed(record.node)].append(record)
        return by_node


def _cut(by_node: dict[NodeId, list[ModeRecord]]) -> Iterable[ModeSpell]:
    for node, records in sorted(by_node.items()):
        before: ModeSpell | None = None
        for record in records:
            begin, end = wall_interval(record)
            if before is not None:
                yield before if before.t_end_ns is not None and before.t_end_ns <= begin else replace(before, t_end_ns=begin)
            before = ModeSpell(node=node, t_start_ns=begin, t_end_ns=end, mode=record.mode, cause=record.cause)
        if before is not None:
            yield before
