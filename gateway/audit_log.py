"""What is on record besides the stages of commands: who started, ordered and changed what (docs/audit.md).

An entry waits for the disk like every other write; nobody waits for it. The journal chains it to the entries before.
"""

import asyncio
import sqlite3
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import msgspec

from firmware_protocol.contract.commands import StimulationRequest
from firmware_protocol.contract.records import BackpackLimits
from firmware_protocol.messages import Limits
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.errors import JournalFullError
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import AuditEntry, JournalReader, JournalWrite
from gateway.log import EventLog
from gateway.log_ration import LogRation

_log = EventLog(__name__)

GATEWAY, LIMITS, ANNOUNCED = "gateway", "limits", "announced"
"""Kinds: start and stop of the gateway; the table of limits; limits that a backpack announced."""

REPEATED, TURNED_AWAY, LOST = "repeated", "turned_away", "lost"
"""Kinds: requests whose id was known; queries that were no commands; entries that could not be taken."""

_MAX_FACTS_SIZE = 64 * 1024
_MAX_OPERATOR = 64
_MAX_SHOWN = 32
"""Octets of what was turned away that are kept."""

_TURNED_AWAY_PERIOD_S = 60.0
_HEAD_PERIOD_S = 3600.0
_TICK_S = 1.0


@dataclass(slots=True)
class _TurnedAway:
    """Queries of which no row was written yet: how many, and the first of them."""

    n: int = 0
    reason: str = ""
    octets: bytes = b""
    size: int = 0


class AuditLog:
    """Notes down what must be on record; see the module's description. Belongs to one event loop, but for ``turn_away``."""

    def __init__(
        self,
        *,
        journal: Journal,
        reader: JournalReader,
        health: Health,
        wall_clock: Callable[[], int] = time.time_ns,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._journal = journal
        self._reader = reader
        self._health = health
        self._wall_clock = wall_clock
        self._clock = clock
        self._n_lost = 0
        self._announced: dict[NodeId, bytes] = {}
        self._repeated = LogRation(n_lines=60, period_s=60.0)
        self._turned_away = _TurnedAway()
        self._lock = threading.Lock()

    def note(self, kind: str, *, facts: Mapping[str, object], operator: str = "", node: NodeId | None = None) -> None:
        """Put something on record; never raises and never waits. Too much to keep is cut; where too much waits for the disk, it is lost.

        ``operator`` and ``facts`` may come from outside. What is lost is counted, and a later entry says how much it was.
        """
        if self._n_lost and self._append(LOST, {"n": self._n_lost}):
            self._n_lost = 0
        if not self._append(kind, facts, operator=operator, node=node):
            self._n_lost += 1
            self._health.count("audit.lost")

    def note_limits(self, table: StimulationTable) -> None:
        """Put the limits on record that hold from now on, where they are not those that were put there last."""
        facts = msgspec.to_builtins(table)
        body = self._last_body(LIMITS)
        before = facts_of(body) if body else {}
        if facts != before:
            changed = sorted(name for name in facts if name not in before or facts[name] != before[name])
            _log.info("audit.limits", changed=" ".join(changed) if before else "first")
            self.note(LIMITS, facts=facts)

    def note_announced(self, node: NodeId, limits: Limits) -> None:
        """Put the limits on record that a backpack announced, where they are not those that it announced before."""
        facts = {name: getattr(limits, name) for name in BackpackLimits.__struct_fields__}
        body = _encode(facts)
        if node not in self._announced:  # bounded by the numbers that biobots can have
            self._announced[node] = self._last_body(ANNOUNCED, node=node)
        if self._announced[node] != body:
            self._announced[node] = body
            self.note(ANNOUNCED, facts=facts, node=node)

    def note_repeated(self, request: StimulationRequest) -> None:
        """Put a request on record whose id was known; of a flood of them some rows a minute, the others counted."""
        n_others = self._repeated.ask(now_ns=self._clock())
        if n_others is not None:
            facts = {"command_id": request.command_id, "action": request.action.value, "issued_wall_ns": request.issued_wall_ns}
            self.note(REPEATED, facts={**facts, "others_before": n_others}, operator=request.operator, node=request.node)

    def turn_away(self, octets: bytes, reason: str) -> None:
        """Count a query that was no command, or one too many; from any thread. A row of it is written at most once a minute."""
        with self._lock:
            if not self._turned_away.n:
                self._turned_away = _TurnedAway(reason=reason[:200], octets=octets[:_MAX_SHOWN], size=len(octets))
            self._turned_away.n += 1

    def begin(self, facts: Mapping[str, object]) -> None:
        """Put the start of the gateway on record."""
        self.note(GATEWAY, facts={"event": "started", **facts})
        self._tell_head()

    def end(self, reason: str) -> None:
        """Put the end of the gateway on record, and what was not written yet."""
        self._write_turned_away()
        self.note(GATEWAY, facts={"event": "stopping", "reason": reason})

    async def run(self) -> None:
        """Write what was turned away, and tell the chain's head in the log every hour, until cancelled."""
        turned_away_at = -_TURNED_AWAY_PERIOD_S * NS_PER_S
        told_at = self._clock()
        while True:
            await asyncio.sleep(_TICK_S)
            now_ns = self._clock()
            if now_ns - turned_away_at >= _TURNED_AWAY_PERIOD_S * NS_PER_S and self._write_turned_away():
                turned_away_at = now_ns
            if now_ns - told_at >= _HEAD_PERIOD_S * NS_PER_S:
                told_at = now_ns
                self._tell_head()

    def _write_turned_away(self) -> bool:
        with self._lock:
            waiting, self._turned_away = self._turned_away, _TurnedAway()
        if not waiting.n:
            return False
        self.note(TURNED_AWAY, facts={"n": waiting.n, "reason": waiting.reason, "octets": waiting.octets, "size": waiting.size})
        return True

    def _tell_head(self) -> None:
        head = self._journal.audit_head
        _log.info("audit.head", rows=head.n_rows, head=head.chain.hex())

    def _last_body(self, kind: str, *, node: NodeId | None = None) -> bytes:
        try:
            last = self._reader.read_last_audit(kind=kind, node=node)
        except (sqlite3.Error, msgspec.ValidationError) as error:  # then it is put there once more
            _log.warning("audit.unread_journal", kind=kind, reason=str(error))
            return b""
        return b"" if last is None else last.body

    def _append(self, kind: str, facts: Mapping[str, object], *, operator: str = "", node: NodeId | None = None) -> bool:
        # Names come from outside: what is no UTF-8 would be refused by the disk.
        named = operator.encode("utf-8", "backslashreplace").decode()[:_MAX_OPERATOR]
        entry = AuditEntry(wall_ns=self._wall_clock(), mono_ns=self._clock(), kind=kind, operator=named, node=node, body=_encode(facts))
        try:
            self._journal.append(JournalWrite(audit=entry))
        except JournalFullError as error:
            _log.error("audit.lost", kind=kind, reason=str(error))
            return False
        return True


def facts_of(body: bytes) -> dict[str, object]:
    """Return the facts of an entry's body; of what is no map, its octets."""
    if not body:
        return {}
    try:
        return msgspec.msgpack.decode(body, type=dict[str, object])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return {"octets": body}


def _encode(facts: Mapping[str, object]) -> bytes:
    try:
        body = msgspec.msgpack.encode(dict(facts), enc_hook=str)
    except (ValueError, TypeError, OverflowError, RecursionError):
        body = None
    if body is None or len(body) > _MAX_FACTS_SIZE:
        return msgspec.msgpack.encode({"cut": ascii(facts)[: _MAX_FACTS_SIZE // 2]})
    return body
