"""The account: what backpacks reported, beside what the mapper's store holds. Slow and obvious on purpose; shares no code with the merger.

Reports of a pair at one gateway whose true intervals overlap, or nearly, are one encounter. The plan keeps others so far away that there is
no doubt; were there any, it would be counted as ``n_doubtful`` and fail the campaign. An encounter is to be in the store as exactly one
record that is not void; each side of it as exactly what its reports say:

- from the first beginning to the last end, each within the record's ``error_ns`` (its bound for the fitted clock) and a tick of the
  truth, which the yard knows: both are on the machine's one monotonic clock;
- just as long as was reported where there was one report, but for the rate of the backpack's clock: at most 200 ppm (40 ppm of the crystal
  and the 100 ppm that the gateway's fit may allow for, with room) and two ticks; where several reports were dated by different fits, both
  ends may move by the bound;
- with the strongest RSSI of its reports.
"""

import sqlite3
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from firmware_protocol.contract.records import Cause, EncounterRecord, EncounterSide, Mode, ModeRecord, decode_journal_record
from firmware_protocol.messages import WireCause, WireMode
from firmware_protocol.units import NS_PER_MS, NS_PER_S
from mapper.store import Kind, Store
from studies.campaign.ledger import Rows

_PAGE = 10_000
_TICK_NS = 2 * NS_PER_MS
_MAX_RATE_PPM = 200
_NEAR_NS = NS_PER_S // 4
"""Reports this close are one encounter: far more than the margins that the gateway gives settled clocks."""

_FAR_NS = 3 * NS_PER_S
"""Reports further apart than this are two encounters, for a margin is 1 s at most, where a clock is known badly; between the two is
doubt."""

_EXAMPLES = 20

_MODES = {WireMode.CRW.value: Mode.CRW, WireMode.S.value: Mode.S}
_CAUSES = {WireCause.NATURAL.value: Cause.NATURAL, WireCause.COMMAND.value: Cause.COMMAND}

_Place: TypeAlias = tuple[str, int, int]
"""Gateway and pair, the lower number first."""


@dataclass(slots=True, kw_only=True)
class Account:
    """What came of it. Lost, duplicated, altered and unreported ones are to be none."""

    n_entries: int = 0
    n_ongoing: int = 0
    n_encounters: int = 0
    n_reciprocal: int = 0
    n_records: int = 0
    n_void: int = 0
    n_lost: int = 0
    n_duplicated: int = 0
    n_altered: int = 0
    n_unreported: int = 0
    n_doubtful: int = 0
    n_modes: int = 0
    n_mode_records: int = 0
    n_modes_lost: int = 0
    n_modes_duplicated: int = 0
    n_modes_altered: int = 0
    n_modes_unreported: int = 0
    worst_error_ns: int = 0
    worst_bound_ns: int = 0
    examples: list[str] = field(default_factory=list)

    @property
    def is_sound(self) -> bool:
        """Whether everything that was reported is there, once, as it was, and nothing else."""
        faults = (self.n_lost, self.n_duplicated, self.n_altered, self.n_unreported, self.n_doubtful)
        modes = (self.n_modes_lost, self.n_modes_duplicated, self.n_modes_altered, self.n_modes_unreported)
        return self.n_entries > 0 and not any(faults) and not any(modes)

    def complain(self, what: str) -> None:
        """Keep an example of what is wrong."""
        if len(self.examples) < _EXAMPLES:
            self.examples.append(what)


@dataclass(slots=True, kw_only=True)
class _Side:
    """What a backpack said of one encounter."""

    start_ns: int
    end_ns: int
    duration_ns: int
    rssi_dbm: int
    n_reports: int = 1


@dataclass(slots=True, kw_only=True)
class _Encounter:
    """What is to be in the store."""

    start_ns: int
    end_ns: int
    last: tuple[int, bool]
    """End of the report that reaches furthest, and whether it was final."""
    sides: dict[int, _Side]


def settle(ledgers: Mapping[str, Rows], store: Path) -> Account:
    """Compare each gateway's ledger of reports with the store of a mapper that has ended."""
    account = Account()
    encounters: dict[_Place, list[_Encounter]] = {}
    modes: dict[tuple[str, int], list[tuple[int, int, int]]] = {}
    for gateway, rows in ledgers.items():
        encounters |= _encounters_of(gateway, rows, account)
        modes |= _modes_of(gateway, rows, account)
    stored: dict[_Place, list[EncounterRecord]] = defaultdict(list)
    for record in _stored_encounters(store):
        if record.is_void:
            account.n_void += 1
        else:
            stored[record.gateway, record.node_a, record.node_b].append(record)
    for place in encounters.keys() | stored.keys():
        _compare(place, encounters.get(place, []), stored.get(place, []), account)
    stored_modes: dict[tuple[str, int], list[ModeRecord]] = defaultdict(list)
    for mode in _stored_modes(store):
        stored_modes[mode.gateway, mode.node].append(mode)
    for key in modes.keys() | stored_modes.keys():
        _compare_modes(key, modes.get(key, []), stored_modes.get(key, []), account)
    return account


def _encounters_of(gateway: str, rows: Rows, account: Account) -> dict[_Place, list[_Encounter]]:
    reports: dict[_Place, list[tuple[int, int, int, int, int, bool]]] = defaultdict(list)
    kept = rows[rows["is_mode"] == 0]
    for row in kept.tolist():
        _, node, _, _, peer, rssi_dbm, is_ongoing, _, duration_ms, start_ns, end_ns = row
        place = (gateway, min(node, peer), max(node, peer))
        reports[place].append((start_ns, end_ns, node, duration_ms * NS_PER_MS, rssi_dbm, bool(is_ongoing)))
        account.n_ongoing += is_ongoing
    account.n_entries += len(kept)
    return {place: list(_join(sorted(members), account)) for place, members in reports.items()}


def _join(reports: Iterable[tuple[int, int, int, int, int, bool]], account: Account) -> Iterator[_Encounter]:
    """Put reports of a pair, in the order of their beginnings, together where they overlap."""
    current: _Encounter | None = None
    for start_ns, end_ns, node, duration_ns, rssi_dbm, is_ongoing in reports:
        if current is None or start_ns > current.end_ns + _NEAR_NS:
            if current is not None:
                account.n_doubtful += start_ns < current.end_ns + _FAR_NS
                yield current
            current = _Encounter(start_ns=start_ns, end_ns=end_ns, last=(end_ns, not is_ongoing), sides={})
        current.end_ns = max(current.end_ns, end_ns)
        current.last = max(current.last, (end_ns, not is_ongoing))
        side = current.sides.get(node)
        if side is None:
            current.sides[node] = _Side(start_ns=start_ns, end_ns=end_ns, duration_ns=duration_ns, rssi_dbm=rssi_dbm)
        else:
            side.end_ns, side.rssi_dbm, side.n_reports = max(side.end_ns, end_ns), max(side.rssi_dbm, rssi_dbm), side.n_reports + 1
    if current is not None:
        yield current


def _compare(place: _Place, encounters: Sequence[_Encounter], records: Sequence[EncounterRecord], account: Account) -> None:
    """Find for each encounter the records of its pair that overlap it; what is left over was reported by nobody."""
    account.n_encounters += len(encounters)
    account.n_records += len(records)
    left = sorted(records, key=_start_of)
    for encounter in encounters:
        account.n_reciprocal += len(encounter.sides) == 2
        found = [record for record in left if _meets(record, encounter)]
        if not found:
            account.n_lost += 1
            account.complain(f"lost: {place} {encounter}")
            continue
        left = [record for record in left if record not in found]
        account.n_duplicated += len(found) - 1
        if len(found) > 1:
            account.complain(f"duplicated: {place} {encounter} is in {found}")
            continue
        problem = _what_differs(encounter, found[0], account)
        if problem:
            account.n_altered += 1
            account.complain(f"altered ({problem}): {place} {encounter} is in {found[0]}")
    account.n_unreported += len(left)
    for record in left:
        account.complain(f"unreported: {place} {record}")


def _start_of(record: EncounterRecord) -> int:
    return min(side.t_start_ns for side in record.sides)


def _meets(record: EncounterRecord, encounter: _Encounter) -> bool:
    slack_ns = record.error_ns + _TICK_NS
    end_ns = max(side.t_end_ns for side in record.sides)
    return _start_of(record) - slack_ns <= encounter.end_ns and end_ns + slack_ns >= encounter.start_ns


def _what_differs(encounter: _Encounter, record: EncounterRecord, account: Account) -> str:
    sides: dict[int, EncounterSide] = {side.node: side for side in record.sides}
    account.worst_bound_ns = max(account.worst_bound_ns, record.error_ns)
    if sides.keys() != encounter.sides.keys():
        return f"sides {sorted(sides)}"
    if record.is_reciprocal is not (len(sides) == 2):
        return "is_reciprocal"
    if record.is_ongoing is encounter.last[1] and not _is_close_call(encounter):
        return "is_ongoing"
    for node, told in encounter.sides.items():
        side = sides[node]
        start_error_ns, end_error_ns = abs(side.t_start_ns - told.start_ns), abs(side.t_end_ns - told.end_ns)
        account.worst_error_ns = max(account.worst_error_ns, start_error_ns, end_error_ns)
        if max(start_error_ns, end_error_ns) > record.error_ns + _TICK_NS:
            return f"time of {node} by {max(start_error_ns, end_error_ns) / 1e6:.1f} ms, bound {record.error_ns / 1e6:.1f} ms"
        if told.n_reports == 1:
            off_ns = abs(side.t_end_ns - side.t_start_ns - told.duration_ns)
            if off_ns > _TICK_NS + told.duration_ns * _MAX_RATE_PPM // 1_000_000:
                return f"duration of {node} by {off_ns / 1e6:.1f} ms"
        if side.rssi_dbm != told.rssi_dbm:
            return f"RSSI of {node}"
    return ""


def _is_close_call(encounter: _Encounter) -> bool:
    """Whether a side's provisional report reaches about as far as the other's final one: which is further is then up to the clocks."""
    ends = [side.end_ns for side in encounter.sides.values()]
    return len(ends) == 2 and abs(ends[0] - ends[1]) < NS_PER_S


def _modes_of(gateway: str, rows: Rows, account: Account) -> dict[tuple[str, int], list[tuple[int, int, int]]]:
    """Return the modes that each biobot told: when each truly began, the mode and its cause. A mode told again is the same."""
    told: dict[tuple[str, int], set[tuple[int, int, int]]] = defaultdict(set)
    for _, node, _, _, mode, _, cause, _, _, start_ns, _ in rows[rows["is_mode"] == 1].tolist():
        told[gateway, node].add((start_ns, mode, cause))
    account.n_modes += sum(map(len, told.values()))
    return {key: sorted(members) for key, members in told.items()}


def _compare_modes(key: tuple[str, int], told: Sequence[tuple[int, int, int]], records: Sequence[ModeRecord], account: Account) -> None:
    account.n_mode_records += len(records)
    left = list(records)
    for start_ns, mode, cause in told:
        found = [one for one in left if abs(one.t_start_ns - start_ns) <= one.error_ns + _TICK_NS and one.mode is _MODES[mode]]
        left = [one for one in left if one not in found]
        if not found:
            account.n_modes_lost += 1
            account.complain(f"mode lost: {key} {(start_ns, mode, cause)}")
        elif len(found) > 1:
            account.n_modes_duplicated += len(found) - 1
            account.complain(f"mode duplicated: {key} {found}")
        elif found[0].cause is not _CAUSES[cause]:
            account.n_modes_altered += 1
            account.complain(f"mode altered: {key} {found[0]}")
    account.n_modes_unreported += len(left)
    for one in left:
        account.complain(f"mode unreported: {key} {one}")


def _stored_encounters(path: Path) -> Iterator[EncounterRecord]:
    with closing(Store(path)) as store:
        after, has_more = 0, True
        while has_more:
            page = store.encounters(after=after, limit=_PAGE)
            after, has_more = page.cursor, page.has_more
            yield from page.records


def _stored_modes(path: Path) -> Iterator[ModeRecord]:
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
        for (body,) in database.execute("SELECT body FROM record WHERE kind = ?", (Kind.MODE,)):
            record = decode_journal_record(body)
            assert isinstance(record, ModeRecord), "its kind says so"
            yield record
