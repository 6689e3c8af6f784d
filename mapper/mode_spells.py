"""Who stood still and who walked, and when: mode records by row, and the spells they tell of.

Who was halted by a stop of all stands where it happened to be: to a map its spell is one of its own, for as landmarks the stands of a
whole swarm would take the places of those that were chosen (docs/stop.md).
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace

from firmware_protocol.contract.records import Cause, Mode, ModeRecord
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.record_columns import to_signed, wall_interval
from mapper.types import ModeSpell

_ONE_STOP_NS = 2 * NS_PER_S
"""Gateways that heard a biobot both tell of its stop at about the same time; their clocks are fitted."""


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
        halted_ns: int | None = None
        for record in records:
            begin, end = wall_interval(record)
            if before is not None:
                yield before if before.t_end_ns is not None and before.t_end_ns <= begin else replace(before, t_end_ns=begin)
            # Only the gateway that was told to stop all knows of it; another one that hears the biobot tells of the same stop.
            halted_ns = begin if record.is_halted else halted_ns if record.mode is Mode.S else None
            is_halted = record.is_halted or (halted_ns is not None and begin - halted_ns <= _ONE_STOP_NS)
            cause = Cause.NATURAL if is_halted and record.mode is Mode.S else record.cause
            before = ModeSpell(node=node, t_start_ns=begin, t_end_ns=end, mode=record.mode, cause=cause)
        if before is not None:
            yield before
