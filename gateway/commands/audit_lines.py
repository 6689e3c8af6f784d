"""An entry of the audit log as a line for people, as JSON, and as a row of a table. What came from outside is escaped."""

import json
import math
from collections.abc import Mapping
from datetime import UTC, datetime

import msgspec

from firmware_protocol.contract.commands import CommandStage, StimulationRequest
from firmware_protocol.contract.records import decode_record
from firmware_protocol.errors import RecordError
from firmware_protocol.units import EVERYBODY, NS_PER_S
from gateway.audit_log import facts_of
from gateway.journal_file import AuditEntry, Dose

_MAX_SHOWN = 300
"""Characters of a value in a line; JSON has all of it."""

COLUMNS: Mapping[str, type] = {
    "id": int,
    "time": str,
    "kind": str,
    "operator": str,
    "node": int,
    "command_id": str,
    "action": str,
    "stage": str,
    "reason": str,
    "train_ms": int,
    "wire_command": int,
    "gateway_boot": int,
    "facts": str,
    "hash": str,
    "frequency_hz": int,
    "pulse_width_us": int,
    "amplitude_mv": int,
    "duration_ms": int,
    "channel": int,
    "waveform": str,
    "hold_ms": int,
    "commander": str,
    "ttl_ms": int,
    "issued_wall_ns": int,
}
"""Of an exported table."""

Shown = dict[str, object]


def shown(entry: AuditEntry) -> Shown:
    """Return an entry with all that is in it, as JSON can have it; what it has nothing of is left out."""
    request, stage = _request_of(entry), _stage_of(entry)
    facts = None if entry.command_id else _plain(facts_of(entry.body))
    values: Shown = {
        "id": entry.id,
        "time": utc(entry.wall_ns),
        "kind": entry.kind,
        "operator": entry.operator,
        "node": entry.node,
        "command_id": entry.command_id,
        "action": None if request is None else request.action.value,
        "stage": entry.stage,
        "reason": None if stage is None else stage.reason,
        "refusal": None if stage is None or stage.refusal is None else stage.refusal.value,
        "part_of": None if stage is None else stage.part_of,
        "mode": None if stage is None or stage.mode is None else stage.mode.value,
        "train_ms": entry.train_ms or None,
        "hold_ms": (request.hold_ms or None) if request is not None else None,
        "commander": None if request is None else request.commander,
        "ttl_ms": None if request is None else request.ttl_ms,
        "issued_wall_ns": None if request is None else request.issued_wall_ns,
        **_pulse_of(request),
        "wire_command": entry.wire_command,
        "gateway_boot": entry.boot or None,
        "ran_s": entry.ran_ns / NS_PER_S,
        "facts": facts,
        "hash": entry.chain.hex(),
    }
    return {name: value for name, value in values.items() if value is not None and value != ""}


def line_of(entry: AuditEntry) -> str:
    """Return an entry as one line: when, its number, who, what, of which biobot, and what became of it."""
    values = shown(entry)
    who = f"{escaped(entry.operator)}: " if entry.operator else ""
    whom = "" if entry.node is None else " everybody" if entry.node == EVERYBODY else f" biobot {entry.node}"
    head = f"{values['time']} {entry.id:>6} {who}"
    if not entry.command_id:
        facts = facts_of(entry.body)
        said = [f"{escaped(name)}={_value(value)}" for name, value in facts.items()]
        return " ".join((f"{head}{escaped(entry.kind)}{whom}", *([escaped(entry.stage)] if entry.stage else ()), *said))
    parts = [f"{head}{values.get('action', 'command')}{whom} {escaped(entry.stage).replace('_', ' ')}"]
    if entry.train_ms:
        parts.append(f"{entry.train_ms} ms of stimulation")
    parts += [f"{name} {values[name]}" for name in ("mode", "hold_ms") if name in values]
    parts += [f"{name} {escaped(str(values[name]))}" for name in ("commander", "part_of") if name in values]
    reason = f": {escaped(str(values['reason']))}" if "reason" in values else ""
    return f"{', '.join(parts)} [{escaped(entry.command_id)}]{reason}"


def table_row(entry: AuditEntry) -> tuple[int | str | None, ...]:
    """Return an entry as a row of ``COLUMNS``. Texts are escaped, and none begins as a spreadsheet's formula does."""
    values = shown(entry)
    facts = values.get("facts")
    cells = {**values, "facts": None if facts is None else json.dumps(facts)}
    return tuple(_cell(cells.get(name), kind) for name, kind in COLUMNS.items())


def dose_line(dose: Dose) -> str:
    """Return a biobot's dose as a line under ``DOSE_HEAD``."""
    last = "-" if dose.last_train_wall_ns is None else utc(dose.last_train_wall_ns)
    counts = (dose.n_trains, f"{dose.on_ms / 1000:.1f}", dose.n_accepted, dose.n_confirmed, dose.n_refused, dose.n_failed, dose.n_unknown)
    who = "all" if dose.node == EVERYBODY else str(dose.node)
    return f"{who:>6} " + " ".join(f"{count:>9}" for count in counts) + f"  {last}"


DOSE_HEAD = "biobot    trains   time [s]  accepted confirmed   refused    failed   unknown  last train"


def utc(wall_ns: int) -> str:
    """Return an instant as people read it, in UTC; one that no calendar has, as nanoseconds."""
    try:
        return datetime.fromtimestamp(wall_ns // NS_PER_S, tz=UTC).strftime("%Y-%m-%dT%H:%M:%S.") + f"{wall_ns // 1_000_000 % 1000:03}Z"
    except (ValueError, OverflowError, OSError):
        return f"{wall_ns}ns"


def escaped(text: str) -> str:
    """Return text of which nothing moves a terminal's cursor, turns its writing round, or ends the line."""
    return _printable(text[:_MAX_SHOWN]) + ("..." if len(text) > _MAX_SHOWN else "")


def _printable(text: str) -> str:
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in text)


def _value(value: object) -> str:
    text = value if isinstance(value, str) else value.hex() if isinstance(value, bytes) else json.dumps(_plain(value))
    text = escaped(text)
    return repr(text) if " " in text and isinstance(value, str) else text


def _plain(value: object) -> object:
    """Return a decoded MessagePack value as JSON has it: octets as hexadecimal digits."""
    match value:
        case bytes():
            return value.hex()
        case dict():
            return {str(name): _plain(one) for name, one in value.items()}
        case list() | tuple():
            return [_plain(one) for one in value]
        case float() if not math.isfinite(value):
            return str(value)
        case None | bool() | int() | float() | str():
            return value
        case _:
            return str(value)


def _cell(value: object, kind: type) -> int | str | None:
    if value is None or kind is int:
        return value if isinstance(value, int) else None
    text = _printable(str(value))
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text


def _request_of(entry: AuditEntry) -> StimulationRequest | None:
    try:
        return decode_record(entry.request, StimulationRequest) if entry.request else None
    except RecordError:
        return None


def _pulse_of(request: StimulationRequest | None) -> Shown:
    """Return what a command asked of its train; what it left open is as the table says that was in force (kind ``limits``)."""
    if request is None or request.pulse is None:
        return {}
    asked: Shown = msgspec.to_builtins(request.pulse)
    return {name: value for name, value in asked.items() if value is not None}


def _stage_of(entry: AuditEntry) -> CommandStage | None:
    try:
        return decode_record(entry.body, CommandStage) if entry.command_id and entry.body else None
    except RecordError:
        return None
