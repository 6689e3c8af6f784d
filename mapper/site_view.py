"""What the records of all gateways of a site amount to: encounters, modes and missions on one clock, each encounter once.

Derived from the records alone, and made again when a store is opened: what is in the file stays as the gateways sent it. With one gateway
the records are passed on as they are, and nothing of this costs more than remembering where each came from.
"""

from collections.abc import Callable, Collection, Iterable, Sequence

import msgspec.structs
import numpy as np

from firmware_protocol.contract.records import EncounterRecord, MissionRecord, ModeRecord
from mapper.clock_samples import SampledRows, number_pairs
from mapper.clock_votes import ClockDifference
from mapper.errors import StoreError
from mapper.gateway_clocks import GatewayClocks, Source, SourceClock
from mapper.joint_encounters import JointEncounters, ToldRows
from mapper.log import EventLog
from mapper.mode_spells import ModeSpells
from mapper.own_spans import ERRORS, N_NUMBERS, SETTLED_NS, ZEROS
from mapper.record_columns import (
    MAX_WALL_NS,
    EncounterColumns,
    EncounterOrigins,
    EncounterRows,
    make_origins,
    make_rows,
    wall_interval,
)
from mapper.row_loader import LoadedEncounters
from mapper.types import BoolArray, IntArray

_log = EventLog(__name__)

_FIRST_CAPACITY = 1024
_OWN = 9
_MANY = 0.1
"""Where more than this share of all encounters moves, joining all anew takes less time than one by one."""


class SiteView:
    """Encounters, modes and missions of a site by row of the store. ``encounters`` and ``modes`` are what maps are made of.

    Parameters
    ----------
    load
        Reads all encounters in the store: when it is opened, and once more when a second gateway comes. What it raises as ``StoreError``
        then is tried again later.
    """

    def __init__(self, load: Callable[[], Iterable[LoadedEncounters]]) -> None:
        self._load = load
        self._known: set[str] = set()
        self.encounters = EncounterColumns()
        self.modes = ModeSpells()
        self.missions: dict[int, MissionRecord] = {}
        self._clocks = GatewayClocks()
        self._joint = JointEncounters()
        self._sources: dict[tuple[str, int], int] = {}
        self._gateways: dict[str, int] = {}
        self._names: dict[int, str] = {}
        self._gateway_of: list[int] = []
        self._raw_others: dict[int, ModeRecord | MissionRecord] = {}
        # Rows: begin, end [ns, gateway's wall clock], the two ids, whether it counts, margin [ns], source, whether its end is final,
        # error [ns], and what both biobots told on their own clocks (`mapper.own_spans`).
        self._raw: IntArray = np.zeros((_OWN + N_NUMBERS, _FIRST_CAPACITY), dtype=np.int64)
        self._n_rows = 0
        self._is_joining = False
        self._is_unread = False

    def number_source(self, gateway: str, anchor_ns: int) -> int:
        """Return the number of one start of a gateway, a new one for a new one."""
        known = self._sources.get((gateway, anchor_ns))
        if known is None:
            known = self._sources[gateway, anchor_ns] = self._clocks.number(Source(gateway=gateway, anchor_ns=anchor_ns))
            number = self._gateways.setdefault(gateway, len(self._gateways))
            self._names[number] = gateway
            self._gateway_of.append(number)
        return known

    @property
    def is_joining(self) -> bool:
        """Say whether there is more than one gateway."""
        return self._is_joining

    def open(self, *, gateways: Collection[str], change: int) -> None:
        """Take in all that is in the store; ``change`` is the newest there, ``gateways`` all that have sent anything."""
        self._known.update(gateways)
        if len(self._known) > 1:
            self._begin_joining(change=change, with_changes=True)
            return
        for loaded in self._load():
            self.encounters.put(loaded.rows, changes=loaded.changes)

    def take_encounters(self, rows: Sequence[int], records: Sequence[EncounterRecord], *, changes: IntArray) -> None:
        """Take records that are new or have changed, and are in the store; ``changes``, shape (m,), says by which change each was set.

        Notes
        -----
        Rows that stand for something else because of them are set by the newest of these changes.
        """
        self._known.update([record.gateway for record in records])
        change = int(changes[-1])
        if self._is_joining:
            encounters = make_rows(rows, records)
            self._remember(encounters, make_origins(records, number_source=self.number_source))
            self._note(encounters.row)
            self._take(encounters.row, change=change)
            if self._clocks.is_overfull:
                self.settle(change=change)
            return
        self.encounters.put(make_rows(rows, records), changes=changes)
        if len(self._known) > 1:
            self._try_to_join(change=change)

    def take_other(self, row: int, record: ModeRecord | MissionRecord, *, change: int) -> None:
        """Take a mode or a phase of a mission; changes come in ascending order."""
        self.number_source(record.gateway, record.wall_anchor_ns)
        self._raw_others[row] = record
        self._put_other(row, record, change=change)

    def settle(self, *, change: int) -> None:
        """Judge the gateways' clocks anew; where a shift is another one now, all that is of that gateway is set by ``change``."""
        if not self._is_joining and len(self._known) > 1:
            self._try_to_join(change=change)
        moved = self._clocks.settle(self._read) if self._is_joining else frozenset()
        if not moved:
            return
        self._move(change=change)
        for row, record in self._raw_others.items():
            if self._sources[record.gateway, record.wall_anchor_ns] in moved:
                self._put_other(row, record, change=change)

    def clock_bound(self, gateway: str, anchor_ns: int) -> int:
        """Return how wrong the shift of one start of a gateway may be [ns]; 0 where nothing is shifted."""
        number = self._sources.get((gateway, anchor_ns))
        shift = None if number is None else self._clocks.shift(number)
        return 0 if shift is None else shift.bound_ns

    def clocks(self) -> tuple[SourceClock, ...]:
        """Say how each start of each gateway stands to the site's clock, as last settled."""
        return self._clocks.report()

    def members(self, row: int) -> tuple[int, ...]:
        """Return the rows of the encounter that a row tells of, that which stands for it first."""
        return self._joint.members(row)

    def _try_to_join(self, *, change: int) -> None:
        """Begin to join; where the store cannot be read, each gateway's encounters count by themselves until it can."""
        try:
            self._begin_joining(change=change, with_changes=False)
        except StoreError as error:
            if not self._is_unread:
                _log.error("site.unjoined", reason=str(error))
            self._is_unread = True
            return
        if self._is_unread:
            _log.warning("site.joined")
            self._is_unread = False

    def _begin_joining(self, *, change: int, with_changes: bool) -> None:
        """Load all that the store has, to make up for what one gateway alone did not need."""
        for loaded in self._load():
            if len(loaded.rows):
                self._remember(loaded.rows, loaded.origins(number_source=self.number_source))
                if with_changes:
                    self.encounters.put(loaded.rows, changes=loaded.changes)
        self._is_joining = True
        self._note(self._present())
        self._rebuild(change=change)

    def _present(self) -> IntArray:
        return np.flatnonzero(self._raw[7, : self._n_rows] >= 0)

    def _remember(self, rows: EncounterRows, origins: EncounterOrigins) -> None:
        n = 1 + int(rows.row.max())
        if n > self._raw.shape[1]:
            grown = np.zeros((len(self._raw), max(n, 2 * self._raw.shape[1])), dtype=np.int64)
            grown[:, : self._n_rows] = self._raw[:, : self._n_rows]
            self._raw = grown
        if n > self._n_rows:
            self._raw[7, self._n_rows : n] = -1
            self._n_rows = n
        values = (rows.t_start_ns, rows.t_end_ns, rows.id1, rows.id2, rows.counts)
        others = (origins.margin_ns, origins.source, origins.is_final, origins.error_ns)
        for column, numbers in enumerate((*values, *others, *origins.own)):
            self._raw[column, rows.row] = numbers

    def _note(self, rows: IntArray) -> None:
        pairs = self._pairs(rows)
        self._clocks.note(rows, sources=self._raw[6, rows], pairs=pairs)

    def _pairs(self, rows: IntArray) -> IntArray:
        id1, id2 = self._raw[2, rows], self._raw[3, rows]
        return number_pairs(np.minimum(id1, id2), np.maximum(id1, id2))

    def _read(self, rows: IntArray) -> SampledRows:
        begin, end, _, _, counts, _, source, is_final, _ = self._raw[:_OWN, rows]
        is_dated_well = (self._raw[_OWN:, rows][ERRORS] <= SETTLED_NS).all(axis=0)  # badly dated ones are all late
        return SampledRows(
            source=source,
            pair=self._pairs(rows),
            middle_ns=(begin + end) // 2,
            length_ns=end - begin,
            is_usable=(counts == 1) & (is_final == 1) & is_dated_well,
        )

    def _gateways_of(self, rows: IntArray) -> IntArray:
        gateways: IntArray = np.array(self._gateway_of, dtype=np.int64)[self._raw[6, rows]]
        return gateways

    def _shifted(self, rows: IntArray) -> EncounterRows:
        """Return records on the site's clock."""
        begin, end, id1, id2, counts, _, source, _, _ = self._raw[:_OWN, rows]
        for number in np.unique(source).tolist():
            shift = self._clocks.shift(number)
            if shift is not None:
                is_of = source == number
                added = shift.at((begin[is_of] + end[is_of]) // 2)
                begin[is_of] = np.clip(begin[is_of] + added, 0, MAX_WALL_NS - 1)
                end[is_of] = np.clip(end[is_of] + added, 0, MAX_WALL_NS - 1)
        return EncounterRows(row=rows, t_start_ns=begin, t_end_ns=end, id1=id1, id2=id2, counts=counts.astype(np.bool_))

    def _rebuild(self, *, change: int) -> None:
        """Join all encounters anew; those that come out otherwise are set by ``change``."""
        rows = self._present()
        self._publish(self._joint.rebuild(self._told(rows), names=self._names), change=change)

    def _move(self, *, change: int) -> None:
        """Put all encounters where the clocks have them now."""
        rows = self._present()
        rows = rows[self._joint.differs(self._shifted(rows))]
        if len(rows) > _MANY * self._n_rows:
            self._rebuild(change=change)
        else:
            self._take(rows, change=change)

    def _take(self, rows: IntArray, *, change: int) -> None:
        self._publish(self._joint.take(self._told(rows), names=self._names), change=change)

    def _told(self, rows: IntArray) -> ToldRows:
        """Return records on the site's clock with what joins them.

        Their errors are without that of the shift, which may become another one while no record moves: what is joined would depend on when.
        """
        margin_ns, error_ns, own = self._raw[5, rows], self._raw[8, rows], self._raw[_OWN:, rows]
        shifted = self._shifted(rows)
        own[ZEROS] += shifted.t_start_ns - self._raw[0, rows]
        return ToldRows(rows=shifted, margin_ns=margin_ns, error_ns=error_ns, gateway=self._gateways_of(rows), own=own)

    def _publish(self, amount: EncounterRows, *, change: int) -> None:
        differs = self.encounters.differs(amount)
        self.encounters.put(_choose(amount, differs), changes=np.full(int(np.count_nonzero(differs)), change, dtype=np.int64))

    def _put_other(self, row: int, record: ModeRecord | MissionRecord, *, change: int) -> None:
        moved = _move(record, self._clocks.shift(self._sources[record.gateway, record.wall_anchor_ns]))
        if isinstance(moved, ModeRecord):
            self.modes.put(row, moved, change=change)
        else:
            self.missions[row] = moved


def _move(record: ModeRecord | MissionRecord, shift: ClockDifference | None) -> ModeRecord | MissionRecord:
    """Put a record on the site's clock: by what is added where it begins."""
    if shift is None:
        return record
    begin, end = wall_interval(record)
    added = int(shift.at(np.array([begin]))[0])
    # Between 1970 and 2116, as everything in columns is.
    added = max(-begin, min(added, MAX_WALL_NS - 1 - (begin if end is None else end)))
    return msgspec.structs.replace(record, wall_anchor_ns=record.wall_anchor_ns + added)


def _choose(rows: EncounterRows, chosen: BoolArray) -> EncounterRows:
    return EncounterRows(
        row=rows.row[chosen],
        t_start_ns=rows.t_start_ns[chosen],
        t_end_ns=rows.t_end_ns[chosen],
        id1=rows.id1[chosen],
        id2=rows.id2[chosen],
        counts=rows.counts[chosen],
    )
