"""Records of a line as lines of text: one JSON object each for programs, one short line each for people.

What is printed depends on the records alone, so a replayed recording prints what was printed while it was made.
"""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime

from firmware_protocol.messages import MessageFault, UplinkHeader
from gateway.recordings.dissection import Dissection, LineDissector, decode_payload
from gateway.recordings.plain_values import fields_of
from gateway.transports.recording import LineRecord, RecordKind

_NS_PER_S = 1_000_000_000
_BYTES = (RecordKind.BYTES_IN, RecordKind.BYTES_OUT)


@dataclass(slots=True)
class LinePrinter:
    """Turns records into events, and counts them; ``as_json`` and ``as_text`` print an event."""

    dissector: LineDissector
    counts: Counter[str] = field(default_factory=Counter)
    """Frames by direction, messages by type, and faults by name."""

    def take(self, record: LineRecord) -> Iterator[dict[str, object]]:
        """Yield what a record says."""
        time = _iso(record.wall_ns)
        if record.kind not in _BYTES:
            if record.kind is RecordKind.OPENED:
                self.dissector.begin_anew()
            yield {"time": time, "line": record.kind.name.lower(), "detail": record.data.decode(errors="replace")}
            return
        is_outgoing = record.kind is RecordKind.BYTES_OUT
        self.counts["bytes.out" if is_outgoing else "bytes.in"] += len(record.data)
        for dissection in self.dissector.feed(record.data, is_outgoing=is_outgoing):
            yield {"time": time, **self._tell(dissection)}

    def _tell(self, dissection: Dissection) -> dict[str, object]:
        event: dict[str, object] = {
            "direction": "out" if dissection.is_outgoing else "in",
            "frame": dissection.name,
            "fields": dict(dissection.fields),
        }
        fault = dissection.fault
        payload = dissection.payload
        if payload is not None:
            event["address"] = payload.address
            if not dissection.is_outgoing:
                event |= {"rssi_dbm": payload.rssi_dbm, "lqi": payload.lqi}
            decoded = decode_payload(payload, is_outgoing=dissection.is_outgoing)
            if isinstance(decoded, MessageFault):
                fault = fault or f"message.{decoded.value}"
                event["payload"] = payload.data.hex()
            else:
                header, message = decoded
                name = type(message).__name__
                heading = fields_of(header) if isinstance(header, UplinkHeader) else {"sequence": header}
                event |= {"message": name, **heading, "says": fields_of(message)}
                self.counts[f"message.{name}"] += 1
        if fault:
            event["fault"] = fault
            self.counts[fault] += 1
        self.counts["frames.out" if dissection.is_outgoing else "frames.in"] += 1
        return event


def as_json(event: dict[str, object]) -> str:
    """Return an event as one line of JSON."""
    return json.dumps(event)


def as_text(event: dict[str, object]) -> str:
    """Return an event as one short line."""
    clock = str(event["time"])[11:]
    if "line" in event:
        return f"{clock} = {event['line']} {event['detail']}".rstrip()
    words = [clock, ">" if event["direction"] == "out" else "<", str(event["frame"]), _pairs(event.get("fields"))]
    if "address" in event:
        words.append(f"[{event['address']:04x}]")
    if event.get("rssi_dbm") is not None:
        words.append(f"{event['rssi_dbm']} dBm")
    if "message" in event:
        node = f"node {event['node']} boot {event['boot']} " if "node" in event else ""
        words.append(f"| {node}#{event['sequence']} {event['message']} {_pairs(event['says'])}")
    if "payload" in event:
        words.append(f"| {event['payload']}")
    if "fault" in event:
        words.append(f"! {event['fault']}")
    return " ".join(word for word in words if word).rstrip()


def summary(counts: Counter[str]) -> str:
    """Return what was seen in all, in one line."""
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "nothing came"


def _pairs(value: object) -> str:
    if not isinstance(value, dict):
        return ""
    return " ".join(f"{key}={_short(one)}" for key, one in value.items())


def _short(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_pairs(one) if isinstance(one, dict) else str(one) for one in value) + "]"
    return str(value)


def _iso(wall_ns: int) -> str:
    seconds, rest = divmod(wall_ns, _NS_PER_S)
    try:
        return f"{datetime.fromtimestamp(seconds, tz=UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"
    except (OverflowError, ValueError, OSError):
        return f"{wall_ns} ns"  # no date: a recording may say anything
