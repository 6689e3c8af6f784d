"""The golden vectors, which Python is held to as well, run against C."""

import json
from pathlib import Path
from typing import Any

import pytest

import firmware_protocol
from firmware_protocol.envelope import EnvelopeFault
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.layouts import CARRIER_LAYOUTS, DOWNLINK_LAYOUTS, ENVELOPE_LAYOUTS, UPLINK_LAYOUTS
from firmware_protocol.messages import MessageFault
from studies.c_link import CLink, LinkEvent, LinkEventKind
from studies.c_wire import Decoded, Wire

Vector = dict[str, Any]
FOLDER = Path(firmware_protocol.__file__).parent / "vectors"
KINDS = {layout.name: layout.kind for layout in (*UPLINK_LAYOUTS, *DOWNLINK_LAYOUTS, *ENVELOPE_LAYOUTS, *CARRIER_LAYOUTS)}
REASONS = ("no_answer", "peer_restarted", "peer_reset", "no_progress")


def each(name: str) -> "pytest.MarkDecorator":
    vectors: list[Vector] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return pytest.mark.parametrize("vector", vectors, ids=[vector["name"] for vector in vectors])


def told(fields: Vector) -> Decoded:
    """Return what a vector says, as C decodes it."""
    rest: tuple[tuple[int, ...], ...] | bytes = tuple(tuple(entry.values()) for entry in fields.get("entries", ()))
    if "text" in fields:
        rest = fields["text"].encode()
    if "payload" in fields:
        rest = bytes.fromhex(fields["payload"])
    header = tuple(fields["header"].values()) if "header" in fields else (KINDS[fields["message"]],)
    return header, tuple(fields["values"].values()), rest


@each("framing")
def test_streams_give_their_bodies_and_faults(vector: Vector, wire: Wire) -> None:
    results = wire.frame_decoder().feed(bytes.fromhex(vector["hex"]))

    assert [{"fault": one.value} if isinstance(one, FrameFault) else {"body": one.hex()} for one in results] == vector["results"]
    bodies = [bytes.fromhex(result["body"]) for result in vector["results"] if "body" in result]
    if len(bodies) == len(vector["results"]) == 1 and "is_one_way" not in vector:
        assert wire.encode_frame(bodies[0]).hex() == vector["hex"]


@each("uplink")
def test_uplinks_decode_and_encode(vector: Vector, wire: Wire) -> None:
    decoded = wire.decode_uplink(bytes.fromhex(vector["hex"]))

    if "fault" in vector:
        assert decoded is MessageFault(vector["fault"])
        return
    assert not isinstance(decoded, MessageFault)
    assert decoded[:2] == told(vector["fields"])[:2]
    if "is_one_way" not in vector:
        assert decoded == told(vector["fields"])
        assert wire.encode_again("uplink").hex() == vector["hex"]


@each("downlink")
def test_downlinks_decode_and_encode(vector: Vector, wire: Wire) -> None:
    decoded = wire.decode_downlink(bytes.fromhex(vector["hex"]))

    if "fault" in vector:
        assert decoded is MessageFault(vector["fault"])
        return
    assert decoded == told(vector["fields"])
    assert (wire.encode_again("downlink").hex() == vector["hex"]) is ("is_one_way" not in vector)


@each("envelope")
def test_envelopes_decode_and_encode(vector: Vector, wire: Wire) -> None:
    decoded = wire.decode_envelope(bytes.fromhex(vector["hex"]))

    if "fault" in vector:
        assert decoded is EnvelopeFault(vector["fault"])
        return
    assert not isinstance(decoded, EnvelopeFault)
    assert decoded[:2] == told(vector["fields"])[:2]
    if "is_one_way" not in vector:
        assert decoded == told(vector["fields"])
        assert wire.encode_again("envelope").hex() == vector["hex"]


@each("link_sessions")
def test_sessions_go_as_they_are_told(vector: Vector, wire: Wire) -> None:
    link = CLink(wire, is_initiator=vector["role"] == "initiator")
    sent: list[str] = []
    receipts: list[int] = []
    for step in vector["steps"]:
        now_ms, what = step["at_ms"], step.get("what")
        event = LinkEvent(kind=LinkEventKind.NOTHING)
        match step["do"]:
            case "start":
                link.announce_restart()
            case "open":
                link.open(session=what, now_ms=now_ms)
            case "receive":
                event = link.receive(bytes.fromhex(what), now_ms=now_ms)
            case "send":
                assert link.send(bytes.fromhex(what), tag=len(sent))
                sent.append(what)
            case "confirm":
                link.confirm(receipts[what - 1])
            case "deadline":
                event = link.poll(now_ms=now_ms)
            case other:
                pytest.fail(f"no such step: {other}")
        if event.kind is LinkEventKind.PAYLOAD:
            receipts.append(event.receipt)
        # The C link tells how many were dropped, not which: its owner gave them their tags, and knows which are left.
        assert say(event, sent) == [told.split(", dropped")[0] for told in step["events"]]
        assert [frame.hex() for frame in link.take_frames(now_ms=now_ms)] == step["frames"]


def say(event: LinkEvent, sent: list[str]) -> list[str]:
    match event.kind:
        case LinkEventKind.NOTHING:
            return []
        case LinkEventKind.OPENED:
            return ["opened"]
        case LinkEventKind.PAYLOAD:
            return [f"received {event.payload.hex()}"]
        case LinkEventKind.CONFIRMED:
            return [f"confirmed {sent[tag]}" for tag in event.tags]
        case LinkEventKind.LOST:
            return [f"lost {REASONS[event.reason]}"]
