"""Recordings of successive windows, or of sites that share biobots, as one: what is in two of them counts once.

All instants are of one clock once each recording is shifted as its owner says, and an id is one biobot wherever it occurs. Nothing here
depends on the order in which recordings are given.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from mapper.types import EncounterTable, IntArray, ModeSpell
from mapper.window import make_encounter_table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """What one file, or directory, tells; ``name`` is for messages."""

    name: str
    table: EncounterTable
    spells: tuple[ModeSpell, ...]

    @property
    def span_ns(self) -> tuple[int, int]:
        """From the first begin to the last end of its encounters [ns]; it has at least one."""
        return int(self.table.t_start_ns.min()), int(self.table.t_end_ns.max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pool:
    """One table of all. ``n_repeated`` rows told again, or on, what another recording tells; ``warnings`` say what looks wrong."""

    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    n_repeated: int
    warnings: tuple[str, ...]


def shift_recording(recording: Recording, *, shift_ns: int) -> Recording:
    """Add to every instant of a recording [ns]: its clock is that much behind the others'."""
    if shift_ns == 0:
        return recording
    table = recording.table
    moved = make_encounter_table(t_start_ns=table.t_start_ns + shift_ns, t_end_ns=table.t_end_ns + shift_ns, id1=table.id1, id2=table.id2)
    spells = tuple(
        replace(spell, t_start_ns=spell.t_start_ns + shift_ns, t_end_ns=None if spell.t_end_ns is None else spell.t_end_ns + shift_ns)
        for spell in recording.spells
    )
    return replace(recording, table=moved, spells=spells)


def pool_recordings(recordings: Sequence[Recording]) -> Pool:
    """Put recordings together.

    Parameters
    ----------
    recordings
        At least one, each with at least one encounter.

    Notes
    -----
    Encounters of one pair in two recordings are one where their times overlap, or where one recording ends with the one and the other
    begins with the other: it was cut there. Encounters that only one recording tells stay as they are, also where they touch.
    A spell that lasts at the end of its recording ends there, unless another recording tells on. Spells of one biobot that meet are one to
    the graph, so a landmark that stood on between two recordings is one place where either recording's spells say so.
    """
    rows = [
        (int(start), int(end), int(id1), int(id2), index)
        for index, recording in enumerate(recordings)
        for start, end, id1, id2 in zip(
            recording.table.t_start_ns.tolist(),
            recording.table.t_end_ns.tolist(),
            recording.table.id1.tolist(),
            recording.table.id2.tolist(),
            strict=True,
        )
    ]
    spans = [recording.span_ns for recording in recordings]
    by_pair: defaultdict[tuple[int, int], list[tuple[int, int, int]]] = defaultdict(list)
    for start, end, id1, id2, index in rows:
        by_pair[id1, id2].append((start, end, index))
    joined = [(start, end, *pair) for pair, told in by_pair.items() for start, end in _join_pair(told, spans)]
    columns = np.array(joined, dtype=np.int64).reshape(-1, 4).T
    table = make_encounter_table(t_start_ns=columns[0], t_end_ns=columns[1], id1=columns[2], id2=columns[3])
    spells = _join_spells([spell for recording in recordings for spell in _closed(recording)], last_ns=max(end for _, end in spans))
    return Pool(table=table, spells=spells, n_repeated=len(rows) - len(table), warnings=tuple(_doubts(recordings)))


def _join_pair(told: list[tuple[int, int, int]], spans: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join what several recordings tell of one pair: begin, end and recording of each encounter; return begins and ends."""
    if len({index for _, _, index in told}) == 1:
        return [(start, end) for start, end, _ in told]
    sources: defaultdict[tuple[int, int], set[int]] = defaultdict(set)
    counts: defaultdict[tuple[int, int, int], int] = defaultdict(int)
    for start, end, index in told:
        sources[start, end].add(index)
        counts[start, end, index] += 1
    # What one recording tells twice is two encounters; what two tell is one.
    spans_told = [span for span in sorted(sources) for _ in range(max(counts[*span, index] for index in sources[span]))]
    joined: list[tuple[int, int, set[int]]] = []
    for start, end in spans_told:
        own = sources[start, end]
        if joined and _is_one(joined[-1], (start, end, own), spans):
            before = joined.pop()
            joined.append((before[0], max(before[1], end), before[2] | own))
        else:
            joined.append((start, end, own))
    return [(start, end) for start, end, _ in joined]


def _is_one(before: tuple[int, int, set[int]], after: tuple[int, int, set[int]], spans: Sequence[tuple[int, int]]) -> bool:
    """Say whether two encounters of a pair, the later one second, are one that different recordings tell of."""
    if before[2] & after[2]:  # who tells of both keeps them apart
        return False
    if after[0] < before[1]:
        return True
    return after[0] == before[1] and any(
        spans[one][1] == before[1] and spans[other][0] == after[0] for one in before[2] for other in after[2] if one != other
    )


def _closed(recording: Recording) -> list[ModeSpell]:
    """Return the spells of a recording, those that last ended with its last encounter."""
    last_ns = recording.span_ns[1]
    return [replace(spell, t_end_ns=max(last_ns, spell.t_start_ns)) if spell.t_end_ns is None else spell for spell in recording.spells]


def _join_spells(spells: Sequence[ModeSpell], *, last_ns: int) -> tuple[ModeSpell, ...]:
    """Join spells of one biobot, mode and cause that overlap or touch; those that last to the end of all are left open."""
    alike: defaultdict[tuple[int, str, str], list[ModeSpell]] = defaultdict(list)
    for spell in spells:
        alike[spell.node, spell.mode.value, spell.cause.value].append(spell)
    joined: list[ModeSpell] = []
    for key in sorted(alike):
        begin_of_kind = len(joined)
        for spell in sorted(alike[key], key=_interval):
            before = joined[-1] if len(joined) > begin_of_kind else None
            if before is not None and spell.t_start_ns <= _interval(before)[1]:
                joined[-1] = replace(before, t_end_ns=max(_interval(before)[1], _interval(spell)[1]))
            else:
                joined.append(spell)
    return tuple(replace(spell, t_end_ns=None) if spell.t_end_ns == last_ns else spell for spell in joined)


def _interval(spell: ModeSpell) -> tuple[int, int]:
    assert spell.t_end_ns is not None
    return spell.t_start_ns, spell.t_end_ns


def _doubts(recordings: Sequence[Recording]) -> list[str]:
    """Name pairs of recordings that have biobots and time in common, but no encounter: clocks or ids do not fit, or they are far apart."""
    doubts = []
    for later, one in enumerate(recordings):
        for other in recordings[:later]:
            begin, end = max(one.span_ns[0], other.span_ns[0]), min(one.span_ns[1], other.span_ns[1])
            shared = np.intersect1d(_nodes(one.table), _nodes(other.table))
            if begin < end and len(shared) and not _keys(one.table) & _keys(other.table):
                names = " and ".join(sorted([other.name, one.name]))
                doubts.append(
                    f"{names} have {len(shared)} biobots and {(end - begin) / 1e9:g} s of time in common, but no encounter; an id is taken "
                    "for one biobot everywhere, and instants for those of one clock: see --shift-s, or give the biobots of one other ids"
                )
    return sorted(doubts)


def _nodes(table: EncounterTable) -> IntArray:
    return np.union1d(table.id1, table.id2)


def _keys(table: EncounterTable) -> set[tuple[int, int, int]]:
    return set(zip(table.t_start_ns.tolist(), table.id1.tolist(), table.id2.tolist(), strict=True))


def count_shared_landmarks(recordings: Sequence[Recording]) -> int:
    """Count the biobots that by command stood still in more than one recording, at one time."""
    stands: defaultdict[int, list[tuple[int, int, int]]] = defaultdict(list)
    for index, recording in enumerate(recordings):
        for spell in _closed(recording):
            assert spell.t_end_ns is not None
            if spell.mode is Mode.S and spell.cause is Cause.COMMAND:
                stands[spell.node].append((spell.t_start_ns, spell.t_end_ns, index))
    return sum(_stand_together(told) for told in stands.values())


def _stand_together(told: Sequence[tuple[int, int, int]]) -> bool:
    """Say whether two stands, begin, end and recording of each, of different recordings meet."""
    return any(one[2] != other[2] and one[0] <= other[1] and other[0] <= one[1] for place, one in enumerate(told) for other in told[:place])
