"""The golden vectors: the files are what the table says, and the codec says the same both ways."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.envelope import EnvelopeFault, decode_envelope, encode_envelope
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.layouts import DOWNLINK_LAYOUTS, ENVELOPE_LAYOUTS, UPLINK_LAYOUTS
from firmware_protocol.link import Link, LinkEvent, LinkLost, LinkOpened, PayloadConfirmed, PayloadReceived, Role
from firmware_protocol.message_codec import decode_downlink, decode_uplink, decode_uplink_fields, encode_downlink, encode_uplink
from firmware_protocol.messages import EncounterBatch, EncounterBatchWithPaths, MessageFault
from studies.vectors import FOLDER, all_vectors, main, text_of

Vector = dict[str, Any]
MS = 1_000_000
FILES = ("framing", "link", "link_sessions", "envelope", "uplink", "downlink")


def read(name: str) -> list[Vector]:
    vectors: list[Vector] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return vectors


def each(name: str) -> "pytest.MarkDecorator":
    vectors = read(name)
    return pytest.mark.parametrize("vector", vectors, ids=[vector["name"] for vector in vectors])


def test_the_files_are_what_the_table_says(tmp_path: Path) -> None:
    assert main([str(tmp_path)]) == 0
    assert sorted(path.name for path in FOLDER.glob("*.json")) == sorted(f"{name}.json" for name in FILES)
    for name, vectors in all_vectors().items():
        assert (FOLDER / f"{name}.json").read_text(encoding="utf-8") == text_of(vectors) == (tmp_path / f"{name}.json").read_text("utf-8")


def test_every_message_and_every_fault_has_a_vector() -> None:
    for name, layouts, faults in (
        ("uplink", UPLINK_LAYOUTS, set(MessageFault)),
        ("downlink", DOWNLINK_LAYOUTS, set(MessageFault)),
        ("envelope", ENVELOPE_LAYOUTS, set(EnvelopeFault)),
    ):
        vectors = read(name)
        assert {layout.name for layout in layouts} <= {vector["fields"]["message"] for vector in vectors if "fields" in vector}
        assert {fault.value for fault in faults} == {vector["fault"] for vector in vectors if "fault" in vector}
        assert len({vector["name"] for vector in vectors}) == len(vectors)
    told = {result.get("fault") for vector in read("framing") for result in vector["results"]}
    of_other_framings = {FrameFault.NOISE, FrameFault.INCOMPLETE}
    assert told == {None, *(fault.value for fault in FrameFault if fault not in of_other_framings)}


@each("framing")
def test_streams_give_their_bodies_and_faults(vector: Vector) -> None:
    results = CobsDecoder().feed(bytes.fromhex(vector["hex"]))

    assert [{"fault": one.value} if isinstance(one, FrameFault) else {"body": one.hex()} for one in results] == vector["results"]
    bodies = [bytes.fromhex(result["body"]) for result in vector["results"] if "body" in result]
    if len(bodies) == len(vector["results"]) == 1 and "is_one_way" not in vector:
        assert encode_frame(bodies[0]).hex() == vector["hex"]


@each("envelope")
def test_envelopes_decode_and_encode(vector: Vector) -> None:
    decoded = decode_envelope(bytes.fromhex(vector["hex"]))

    if "fault" in vector:
        assert decoded is EnvelopeFault(vector["fault"])
        return
    assert not isinstance(decoded, EnvelopeFault)
    fields = vector["fields"]
    assert type(decoded).__name__ == fields["message"]
    rest = {name: fields[name] for name in ("text",) if name in fields} | (
        {"payload": bytes.fromhex(fields["payload"])} if "payload" in fields else {}
    )
    assert {name: getattr(decoded, name) for name in decoded.__struct_fields__} == fields["values"] | rest
    assert (encode_envelope(decoded).hex() == vector["hex"]) is ("is_one_way" not in vector)


@each("uplink")
def test_uplinks_decode_and_encode(vector: Vector) -> None:
    payload = bytes.fromhex(vector["hex"])
    decoded, plain = decode_uplink(payload), decode_uplink_fields(payload)

    if "fault" in vector:
        assert decoded is plain is MessageFault(vector["fault"])
        return
    assert not isinstance(decoded, MessageFault)
    assert not isinstance(plain, MessageFault)
    header, message = decoded
    fields = vector["fields"]
    assert plain[0] == tuple(fields["header"].values())
    assert plain[1] == tuple(fields["values"].values())
    assert plain[2] == (
        fields["text"].encode() if "text" in fields else tuple(tuple(entry.values()) for entry in fields.get("entries", ()))
    )
    assert {name: getattr(header, name) for name in header.__struct_fields__} == {
        name: value for name, value in fields["header"].items() if name not in {"type", "version"}
    }
    assert type(message).__name__ == fields["message"]
    assert {name: getattr(message, name) for name in fields["values"]} == fields["values"]
    assert getattr(message, "text", "") == fields.get("text", "")
    if isinstance(message, EncounterBatch | EncounterBatchWithPaths):
        for entry, raw in zip(message.entries, fields["entries"], strict=True):
            assert (entry.peer, entry.start_ms, entry.rssi_dbm) == (raw["peer"], raw["start_ms"], raw["rssi_dbm"])
            assert entry.duration_ms == raw["duration_high"] % 64 * 65536 + raw["duration_low"]
            assert entry.is_ongoing is (raw["duration_high"] >= 128)
            assert entry.path_mm == (None if raw.get("path_mm", 0xFFFF) == 0xFFFF else raw["path_mm"])
    assert (encode_uplink(header, message).hex() == vector["hex"]) is ("is_one_way" not in vector)


@each("downlink")
def test_downlinks_decode_and_encode(vector: Vector) -> None:
    decoded = decode_downlink(bytes.fromhex(vector["hex"]))

    if "fault" in vector:
        assert decoded is MessageFault(vector["fault"])
        return
    assert not isinstance(decoded, MessageFault)
    sequence, message = decoded
    fields = vector["fields"]
    assert sequence == fields["header"]["sequence"]
    assert type(message).__name__ == fields["message"]
    assert {name: getattr(message, name) for name in message.__struct_fields__} == fields["values"]
    assert (encode_downlink(sequence, message).hex() == vector["hex"]) is ("is_one_way" not in vector)


@each("link_sessions")
def test_links_do_what_their_sessions_say(vector: Vector) -> None:
    link = Link(role=Role(vector["role"]))
    sent: dict[int, str] = {}

    for step in vector["steps"]:
        events = _do(link, step, sent)
        assert [frame.hex() for frame in link.take_frames()] == step["frames"], step
        assert [_told(event, sent) for event in events] == step["events"], step


@each("link")
def test_an_open_link_knows_each_frame_from_what_is_none(vector: Vector) -> None:
    """A responder in the frame's session takes all but what is too short or of no use: ACK of what it has not sent, NEED_RESET."""
    octets = bytes.fromhex(vector["hex"])
    fields = vector.get("fields")
    link = Link(role=Role.RESPONDER)
    if fields is not None:
        assert octets == bytes([fields["kind"], *fields["session"].to_bytes(2, "little"), fields["sequence"]]) + bytes.fromhex(
            fields["payload"]
        )
        link.receive(bytes([1, *octets[1:3], 0, 1]), now_ns=0)

    link.receive(octets, now_ns=0)

    assert (link.n_ignored == 0) is (fields is not None and fields["kind"] in {1, 2, 3, 5})


def _do(link: Link, step: Vector, sent: dict[int, str]) -> list[LinkEvent]:
    now_ns = step["at_ms"] * MS
    what: Any = step.get("what")
    actions: dict[str, Callable[[], list[LinkEvent] | int | None]] = {
        "open": lambda: link.open(session=what, now_ns=now_ns),
        "start": link.announce_restart,
        "receive": lambda: link.receive(bytes.fromhex(what), now_ns=now_ns),
        "send": lambda: link.send(bytes.fromhex(what), now_ns=now_ns),
        "confirm": lambda: link.confirm(what),
        "deadline": lambda: link.handle_deadline(now_ns=now_ns),
    }
    outcome = actions[step["do"]]()
    if isinstance(outcome, int):
        sent[outcome] = what
        return []
    return outcome or []


def _told(event: LinkEvent, sent: dict[int, str]) -> str:
    match event:
        case LinkOpened():
            return "opened"
        case PayloadReceived(payload=payload):
            return f"received {payload.hex()}"
        case PayloadConfirmed(ticket=ticket):
            return f"confirmed {sent[ticket]}"
        case LinkLost(reason=reason, dropped=dropped):
            return ", ".join([f"lost {reason.value}", *(f"dropped {sent[ticket]}" for ticket in dropped)])
