"""Golden vectors of the serial line: frames, link frames, and whole sessions of a link (WIRE_FORMAT.md §2 and §3).

A framing vector is a stream of octets and the ``results`` it gives, bodies and faults in order. A link session is a row of ``steps`` done
to one end that has the constants of §3.4: what is done at ``at_ms``, and the frames and events it brings about. Sessions are written down
by hand, from the text of §3.
"""

from typing import Any, TypeAlias

from firmware_protocol.crc import append_crc
from firmware_protocol.framing.cobs import MAX_BODY_SIZE, MAX_ENCODED_SIZE

Vector: TypeAlias = dict[str, Any]


def framing_vectors() -> list[Vector]:
    """Return streams, good and damaged. The good ones were stuffed by hand or by the rule of [CB99] written out below."""
    longest = bytes(1 + index % 255 for index in range(MAX_BODY_SIZE))
    example = bytes.fromhex("0004013412040160670 0".replace(" ", ""))
    body = bytes.fromhex("0134120001")
    vectors = [
        _stream("the example of §2", example, [body]),
        _stream("all zeros", _framed(bytes(5)), [bytes(5)]),
        _stream("one octet", _framed(b"\x01"), [b"\x01"]),
        _stream("the longest body", _framed(longest), [longest]),
        _stream("the longest body of zeros", _framed(bytes(MAX_BODY_SIZE)), [bytes(MAX_BODY_SIZE)]),
        _stream("without the first delimiter", example[1:], [body], is_one_way=True),
        _stream("two frames that share a delimiter", example + example[1:], [body, body], is_one_way=True),
        _stream("delimiters alone", bytes(4), [], is_one_way=True),
        _stream("noise before a frame", b"\x55\xaa" + example, ["bad_stuffing", body], is_one_way=True),
        _stream("a bit flipped", _flipped(example, at=3, bit=0), ["bad_crc"]),
        _stream("a code octet that reaches past the end", _flipped(example, at=1, bit=6), ["bad_stuffing"]),
        _stream("an octet lost", example[:3] + example[4:], ["bad_stuffing"]),
        _stream("two octets are no body", bytes.fromhex("00 03 11 22 00"), ["too_short"]),
        _stream("a checksum of nothing", b"\x00" + _stuffed(append_crc(b"")) + b"\x00", ["too_short"]),
        _stream("one octet too many between delimiters", b"\x00" + b"\x01" * (MAX_ENCODED_SIZE + 1) + b"\x00", ["too_long"]),
        _stream("a torn frame and a good one", example[:6] + example, ["bad_stuffing", body], is_one_way=True),
        _stream("far too much noise and a good frame", b"\x07" * 1000 + example, ["too_long", body], is_one_way=True),
        _stream("a frame that never ends says nothing", example[:-1], [], is_one_way=True),
    ]
    return [vector | {"section": "2"} for vector in vectors]


def link_vectors() -> list[Vector]:
    """Return one link frame of each kind, and what is none."""
    rows: list[tuple[str, str, int, int, int, bytes]] = [
        ("RESET of link version 1", "3.1", 1, 0x1234, 0, b"\x01"),
        ("RESET of a first firmware's peer: no version means 1", "3.5", 1, 0x1234, 0, b""),
        ("RESET_ACK that chose version 1", "3.5", 2, 0x1234, 0, b"\x01"),
        ("DATA with nothing in it", "3.1", 3, 0xFFFF, 255, b""),
        ("DATA of 240 octets", "3.1", 3, 0x0001, 7, bytes(index % 256 for index in range(240))),
        ("ACK", "3.1", 4, 0x1234, 16, b""),
        ("PING", "3.1", 5, 0x1234, 0, b""),
        ("NEED_RESET", "3.1", 6, 0, 0, b""),
    ]
    vectors: list[Vector] = []
    for name, section, kind, session, sequence, payload in rows:
        octets = bytes([kind]) + session.to_bytes(2, "little") + bytes([sequence]) + payload
        fields = {"kind": kind, "session": session, "sequence": sequence, "payload": payload.hex()}
        vectors.append({"name": name, "section": section, "hex": octets.hex(), "fields": fields})
    vectors.append({"name": "three octets are no link frame", "section": "3.1", "hex": "013412", "fault": "too_short"})
    return vectors


def session_vectors() -> list[Vector]:
    """Return sessions of a responder and of an initiator, step by step."""
    reset, reset_ack = "01010000" + "01", "02010000" + "01"
    return [
        _session("a coordinator starts, is opened and pinged", "3.2", "responder", [
            _step(0, "start", frames=["06000000"]),
            _step(10, "receive", reset, frames=[reset_ack], events=["opened"]),
            _step(20, "receive", reset, frames=[reset_ack]),
            _step(30, "receive", "05010000", frames=["04010000"]),
        ]),
        _session("a newer base station is answered with version 1", "3.5", "responder", [
            _step(0, "receive", "0101000007", frames=[reset_ack], events=["opened"]),
        ]),
        _session("a RESET of version 0 is ignored", "3.5", "responder", [_step(0, "receive", "0101000000")]),
        _session("DATA and PING of an unknown session are answered with NEED_RESET, other frames are ignored", "3.2", "responder", [
            _step(0, "receive", "0305000041", frames=["06000000"]),
            _step(0, "receive", "05050000", frames=["06000000"]),
            _step(0, "receive", "04050000"),
            _step(0, "receive", "06050000"),
            _step(0, "receive", "09050000"),
            _step(0, "receive", "0305"),
        ]),
        _session("what comes out of order is not taken, and answered with the last ACK", "3.3", "responder", [
            _step(0, "receive", reset, frames=[reset_ack], events=["opened"]),
            _step(1, "receive", "0301000141", frames=["04010000"]),
            _step(2, "receive", "0301000041", events=["received 41"]),
            _step(3, "confirm", 1, frames=["04010001"]),
            _step(4, "receive", "0301000041", frames=["04010001"]),
            _step(5, "receive", "0301000142", events=["received 42"]),
            _step(6, "receive", "0301000142", frames=["04010001"]),
            _step(7, "confirm", 2, frames=["04010002"]),
        ]),
        _session("what is not acknowledged is repeated, and the time doubles", "3.3", "responder", [
            _step(0, "receive", reset, frames=[reset_ack], events=["opened"]),
            _step(0, "send", "41", frames=["0301000041"]),
            _step(10, "send", "42", frames=["0301000142"]),
            _step(300, "deadline", frames=["0301000041", "0301000142"]),
            _step(900, "deadline", frames=["0301000041", "0301000142"]),
            _step(1000, "receive", "04010001", events=["confirmed 41"]),
            _step(1300, "deadline", frames=["0301000142"]),
            _step(1400, "receive", "04010002", events=["confirmed 42"]),
        ]),
        _session("what is missing at the other end is repeated at once, and needless repetitions bring about no more", "3.3", "responder", [
            _step(0, "receive", reset, frames=[reset_ack], events=["opened"]),
            _step(0, "send", "41", frames=["0301000041"]),
            _step(0, "send", "42", frames=["0301000142"]),
            _step(0, "send", "43", frames=["0301000243"]),
            _step(50, "receive", "04010000", frames=["0301000041", "0301000142", "0301000243"]),
            _step(51, "receive", "04010000"),
            _step(52, "receive", "04010001", events=["confirmed 41"]),
            _step(53, "receive", "04010001"),
            _step(54, "receive", "04010003", events=["confirmed 42", "confirmed 43"]),
            _step(60, "send", "44", frames=["0301000344"]),
            _step(61, "receive", "04010003"),
            _step(62, "receive", "04010004", events=["confirmed 44"]),
            _step(70, "send", "45", frames=["0301000445"]),
            _step(71, "receive", "04010004", frames=["0301000445"]),
            _step(371, "deadline", frames=["0301000445"]),
            _step(380, "receive", "04010004"),
        ]),
        _session("an acknowledgement of what was not sent is ignored", "3.3", "responder", [
            _step(0, "receive", reset, frames=[reset_ack], events=["opened"]),
            _step(0, "send", "41", frames=["0301000041"]),
            _step(1, "receive", "04010002"),
            _step(2, "receive", "04010001", events=["confirmed 41"]),
        ]),
        _session("a coordinator sends again, in a new session, what was not acknowledged", "3.3", "responder", [
            _step(0, "receive", reset, frames=[reset_ack], events=["opened"]),
            _step(0, "send", "41", frames=["0301000041"]),
            _step(0, "send", "42", frames=["0301000142"]),
            _step(10, "receive", "04010001", events=["confirmed 41"]),
            _step(20, "receive", "0102000001", frames=["0202000001", "0302000042"], events=["opened"]),
        ]),
        _session("a window holds 16", "3.4", "responder", [
            _step(0, "receive", reset, frames=[reset_ack], events=["opened"]),
            *[_step(0, "send", f"{number:02x}", frames=[f"030100{number:02x}{number:02x}"]) for number in range(16)],
            _step(0, "send", "10"),
            _step(1, "receive", "04010001", frames=["0301001010"], events=["confirmed 00"]),
        ]),
        _session("a base station opens, pings and gives up", "3.4", "initiator", [
            _step(0, "open", 1, frames=[reset]),
            _step(500, "deadline", frames=[reset]),
            _step(600, "receive", reset_ack, events=["opened"]),
            _step(3600, "deadline", frames=["05010000"]),
            _step(3700, "receive", "04010000"),
            *[_step(6700 + 300 * number, "deadline", frames=["05010000"]) for number in range(5)],
            _step(8200, "deadline", events=["lost no_answer"]),
        ]),
        _session("while opening only its RESET_ACK counts, and RESET is repeated for ever", "3.6", "initiator", [
            _step(0, "open", 1, frames=[reset]),
            *[_step(100, "receive", octets) for octets in ("0301000041", "04010000", "05010000", "06010000", "09010000", "0201000002")],
            *[_step(500 * number, "deadline", frames=[reset]) for number in range(1, 12)],
            _step(5_600, "receive", reset_ack, events=["opened"]),
            _step(8_600, "deadline", frames=["05010000"]),
        ]),
        _session("a coordinator that talks but acknowledges nothing is given up", "3.3", "initiator", [
            _step(0, "open", 1, frames=[reset]),
            _step(0, "receive", reset_ack, events=["opened"]),
            _step(0, "send", "41", frames=["0301000041"]),
            *[
                step
                for at_ms in (300, 900, *range(2100, 18_000, 2000))
                for step in (
                    _step(at_ms, "deadline", frames=["0301000041"]),
                    _step(at_ms + 10, "receive", "05010000", frames=["04010000"]),
                )
            ],
            _step(18_100, "deadline", events=["lost no_progress, dropped 41"]),
        ]),
        _session("a base station whose disk stalls gives no coordinator up", "3.3", "initiator", [
            _step(0, "open", 1, frames=[reset]),
            _step(0, "receive", reset_ack, events=["opened"]),
            _step(0, "send", "41", frames=["0301000041"]),
            _step(10, "receive", "0301000061", events=["received 61"]),
            *[
                step
                for at_ms in (300, 900, *range(2100, 40_000, 2000))
                for step in (
                    _step(at_ms, "deadline", frames=["0301000041"]),
                    _step(at_ms + 10, "receive", "0301000061", frames=["04010000"]),
                )
            ],
            _step(40_000, "confirm", 1, frames=["04010001"]),
            _step(40_001, "receive", "04010001", events=["confirmed 41"]),
        ]),
        _session("a coordinator that restarted asks for a new session, and what was under way is dropped", "3.3", "initiator", [
            _step(0, "open", 1, frames=[reset]),
            _step(10, "receive", reset_ack, events=["opened"]),
            _step(20, "send", "41", frames=["0301000041"]),
            _step(30, "receive", "06000000", events=["lost peer_restarted, dropped 41"]),
            _step(40, "open", 2, frames=["0102000001"]),
            _step(50, "receive", "0202000001", events=["opened"]),
        ]),
    ]  # fmt: skip


def _stream(name: str, stream: bytes, results: list[bytes | str], *, is_one_way: bool = False) -> Vector:
    told = [{"fault": one} if isinstance(one, str) else {"body": one.hex()} for one in results]
    return {"name": name, "section": "2", "hex": stream.hex(), "results": told} | ({"is_one_way": True} if is_one_way else {})


def _session(name: str, section: str, role: str, steps: list[Vector]) -> Vector:
    return {"name": name, "section": section, "role": role, "steps": steps}


def _step(
    at_ms: int, do: str, what: str | int | None = None, *, frames: list[str] | None = None, events: list[str] | None = None
) -> Vector:
    given = {} if what is None else {"what": what}
    return {"at_ms": at_ms, "do": do} | given | {"frames": frames or [], "events": events or []}


def _framed(body: bytes) -> bytes:
    return b"\x00" + _stuffed(append_crc(body)) + b"\x00"


def _stuffed(data: bytes) -> bytes:
    """Stuff less than 254 octets: each run without a zero is led by its length and one."""
    return b"".join(bytes([len(run) + 1]) + run for run in data.split(b"\x00"))


def _flipped(stream: bytes, *, at: int, bit: int) -> bytes:
    return stream[:at] + bytes([stream[at] ^ 1 << bit]) + stream[at + 1 :]
