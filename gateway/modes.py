"""Reports of a biobot's mode become spells: one record for each, closed by a revision when the next one begins. Pure.

The spells of a biobot are in the order in which they began, whatever the order in which they were heard of. A report names a
spell by boot, tick of its beginning, mode and cause, so repeated reports of one spell make no new record.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from firmware_protocol.contract.records import Cause, Mode, ModeRecord
from firmware_protocol.units import BootId, Milliseconds, Nanoseconds, NodeId
from gateway.halts import Halts
from gateway.issuer import RecordIssuer

_MAX_SPELLS = 64
"""Spells of a biobot that can still be corrected; older ones are final."""

_SAME_SPELL_MS = 1_000
"""Two reports of one mode that began this close together mean one spell: a command's reply and the status after it differ by
the time the insect takes to obey."""

_SAME_SPELL_NS = 2_000_000_000
"""The same for a spell from before a restart of the gateway, whose tick is not known; the clock is fitted anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeReport:
    """A biobot is in a mode since a tick; from a status, or (less surely) from the reply to a command."""

    node: NodeId
    boot: BootId
    since_ms: Milliseconds
    t_start_ns: Nanoseconds
    error_ns: Nanoseconds
    mode: Mode
    cause: Cause
    is_from_reply: bool


@dataclass(slots=True, kw_only=True)
class _Spell:
    """One spell as published. ``node_boot`` and ``since_ms`` are None for one restored from the journal."""

    boot: BootId
    sequence: int
    revision: int
    mode: Mode
    cause: Cause
    t_start_ns: Nanoseconds
    t_end_ns: Nanoseconds | None
    error_ns: Nanoseconds
    node_boot: BootId | None
    since_ms: Milliseconds | None
    is_from_reply: bool
    is_halted: bool

    def means(self, report: ModeReport) -> bool:
        """Whether ``report`` speaks of this spell."""
        if self.mode is not report.mode:
            return False
        if self.cause is not report.cause and not self.is_from_reply and not report.is_from_reply:
            return False
        if self.node_boot is None or self.since_ms is None:
            return abs(self.t_start_ns - report.t_start_ns) <= _SAME_SPELL_NS + report.error_ns
        return self.node_boot == report.boot and abs(self.since_ms - report.since_ms) <= _SAME_SPELL_MS

    def began_before(self, report: ModeReport) -> bool:
        """Whether this spell comes before the one that ``report`` speaks of."""
        if self.node_boot == report.boot and self.since_ms is not None:
            return self.since_ms <= report.since_ms
        return self.t_start_ns <= report.t_start_ns


@dataclass(slots=True, kw_only=True)
class ModeTracker:
    """Turns reports of modes into mode records and their revisions."""

    issuer: RecordIssuer
    halts: Halts = field(default_factory=Halts)
    _spells: dict[NodeId, list[_Spell]] = field(default_factory=dict)

    def observe(self, report: ModeReport) -> list[ModeRecord]:
        """Take a report; return the records it brings about, none where it says nothing new.

        Records carry a provisional offset; the journal gives the real one.
        """
        spells = self._spells.setdefault(report.node, [])
        at = sum(1 for spell in spells if spell.began_before(report))
        for known in spells[max(0, at - 1) : at + 1]:
            if known.means(report):
                return self._refine(known, report, before=next((one for one in reversed(spells[:at]) if one is not known), None))
        if report.is_from_reply and at and spells[at - 1].mode is report.mode:
            return []  # started while it walked: the mode has not changed, and its status will tell the cause
        following = spells[at] if at < len(spells) else None
        spell = _Spell(
            boot=self.issuer.boot,
            sequence=self.issuer.take_sequence(),
            revision=0,
            mode=report.mode,
            cause=report.cause,
            t_start_ns=report.t_start_ns,
            t_end_ns=Nanoseconds(max(report.t_start_ns, following.t_start_ns)) if following else None,
            error_ns=report.error_ns,
            node_boot=report.boot,
            since_ms=report.since_ms,
            is_from_reply=report.is_from_reply,
            is_halted=self._is_halted(report, since=report.t_start_ns, before=spells[at - 1] if at else None),
        )
        changed = [spell]
        if at:
            before = spells[at - 1]
            before.t_end_ns = Nanoseconds(max(before.t_start_ns, report.t_start_ns))
            before.revision += 1
            changed.insert(0, before)
        spells.insert(at, spell)
        del spells[:-_MAX_SPELLS]
        return [self._record(report.node, one) for one in changed]

    def newest_record(self, node: NodeId) -> ModeRecord | None:
        """Return the last record of a biobot's newest spell, as far as any is known."""
        spells = self._spells.get(node)
        return self._record(node, spells[-1]) if spells else None

    def restore(self, records: Iterable[ModeRecord]) -> None:
        """Remember records of the journal, given in the order of their offsets, before any report is taken.

        One of an earlier name of the journal is another history's, and is not revised in this one.
        """
        newest = {(record.boot, record.sequence): record for record in records if record.journal == self.issuer.journal}

        def start_of(record: ModeRecord) -> int:
            return self.issuer.to_own_monotonic_ns(record.t_start_ns, anchor_ns=record.wall_anchor_ns)

        for record in sorted(newest.values(), key=start_of):
            end_ns = record.t_end_ns
            anchor_ns = record.wall_anchor_ns
            spells = self._spells.setdefault(record.node, [])
            spells.append(
                _Spell(
                    boot=record.boot,
                    sequence=record.sequence,
                    revision=record.revision,
                    mode=record.mode,
                    cause=record.cause,
                    t_start_ns=Nanoseconds(start_of(record)),
                    t_end_ns=None if end_ns is None else self.issuer.to_own_monotonic_ns(end_ns, anchor_ns=anchor_ns),
                    error_ns=record.error_ns,
                    node_boot=None,
                    since_ms=None,
                    is_from_reply=False,
                    is_halted=record.is_halted,
                )
            )
            del spells[:-_MAX_SPELLS]

    def _refine(self, spell: _Spell, report: ModeReport, *, before: _Spell | None) -> list[ModeRecord]:
        """Correct a spell by a further report of it: its cause, and that a stop of the biobot alone came after the stop of all."""
        was = spell.cause, spell.is_halted
        if not report.is_from_reply:
            if spell.is_from_reply:
                spell.cause = report.cause
            spell.node_boot, spell.since_ms, spell.is_from_reply = report.boot, report.since_ms, False
        if spell.is_halted:
            since_ns = spell.t_start_ns if before is None else before.t_start_ns
            spell.is_halted = spell.cause is Cause.COMMAND and not self.halts.was_stopped_alone(report.node, since_ns=since_ns)
        if (spell.cause, spell.is_halted) == was:
            return []
        spell.revision += 1
        return [self._record(report.node, spell)]

    def _is_halted(self, report: ModeReport, *, since: int, before: _Spell | None) -> bool:
        if report.mode is not Mode.S or report.cause is not Cause.COMMAND:
            return False
        return self.halts.is_halted(report.node, stands_since_ns=since, walked_since_ns=None if before is None else before.t_start_ns)

    def _record(self, node: NodeId, spell: _Spell) -> ModeRecord:
        return ModeRecord(
            gateway=self.issuer.gateway,
            journal=self.issuer.journal,
            offset=1,
            boot=spell.boot,
            sequence=spell.sequence,
            revision=spell.revision,
            wall_anchor_ns=self.issuer.wall_anchor_ns,
            node=node,
            mode=spell.mode,
            cause=spell.cause,
            t_start_ns=spell.t_start_ns,
            t_end_ns=spell.t_end_ns,
            error_ns=spell.error_ns,
            is_halted=spell.is_halted,
        )
