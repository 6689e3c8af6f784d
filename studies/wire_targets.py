"""What no bytes from a line may do to what reads them: raise, hang, or fill memory. One function a reader, for a fuzzer to call.

Each takes any bytes and raises AssertionError, or what a reader let through, where a law is broken. The laws: any chunking gives the
same; between two calls no more is held than the reader's bound; behind any bytes, good frames are found again; what was decoded encodes
to what decodes to the same. Hosts and dongles are driven by the bytes as a script: chunks, sound frames around chosen bodies, time, and
calls of their owner.
"""

from collections.abc import Callable, Iterator
from functools import partial

from firmware_protocol.crc import append_crc
from firmware_protocol.dialects.choice import DIALECTS, make_host
from firmware_protocol.dialects.interface import HostEvent, HostLost, PayloadHeard
from firmware_protocol.dialects.xbee_frames import XBeeFault, decode_xbee, encode_xbee
from firmware_protocol.envelope import EnvelopeFault, RadioReceived, RadioStatus, decode_envelope, encode_envelope
from firmware_protocol.errors import LinkFullError
from firmware_protocol.message_codec import decode_downlink, decode_uplink, decode_uplink_fields, encode_downlink, encode_uplink
from firmware_protocol.messages import MAX_RADIO_PAYLOAD, MessageFault
from firmware_protocol.units import RssiDbm, ShortAddress
from firmware_protocol.znp.codec import decode_command, encode_command, unpack_incoming
from firmware_protocol.znp.frames import IncomingMessage, ZnpFault
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from simulator.lines.faults import FaultConfig
from simulator.lines.faulty_dongle import with_faults
from studies.held_state import measure_held
from studies.wire_framings import FRAMINGS, WireFraming, framings_of
from studies.wire_pair import Pair

_MS = 1_000_000
_MOST_BYTES, _MOST_MEMBERS = 256 * 1024, 20_000
"""What a host or a dongle may hold: its queues are some hundred payloads, its tables some thousand addresses."""

_GOOD = b"a body that is found again"


def check_framing(framing: WireFraming, data: bytes) -> None:
    """Cut the stream in two ways, then see whether good frames behind it come through."""
    whole, cut = framing.make_decoder(), framing.make_decoder()
    found = whole.feed(data)
    step = 1 + len(data) // 7
    pieces = [result for at in range(0, len(data), step) for result in cut.feed(data[at : at + step])]
    assert found == pieces, (framing.name, found, pieces)
    if len(data) % 8 == 0:
        assert measure_held(whole).n_bytes <= framing.most_held, (framing.name, measure_held(whole))
        body = framing.body_of(_GOOD)
        frame = framing.encode(body)
        n_covered = 2 * framing.largest // len(frame) + 3  # what may be taken for the inside of a frame that noise began
        heard = [result for _ in range(n_covered) for result in whole.feed(frame)] + whole.feed(frame) + whole.feed(frame)
        assert heard[-2:] == [body, body], (framing.name, heard)


def check_uplink(data: bytes) -> None:
    """Decode a radio payload from a backpack, as it is and with a checksum that fits."""
    for payload in (data, append_crc(data)):
        decoded, fields = decode_uplink(payload), decode_uplink_fields(payload)
        if isinstance(decoded, MessageFault):
            assert fields == decoded
        else:
            assert not isinstance(fields, MessageFault)
            assert _is_mended(decoded[1]) or decode_uplink(encode_uplink(*decoded)) == decoded


def check_downlink(data: bytes) -> None:
    """Decode a radio payload from a base station, as it is and with a checksum that fits."""
    for payload in (data, append_crc(data)):
        decoded = decode_downlink(payload)
        if not isinstance(decoded, MessageFault):
            assert decode_downlink(encode_downlink(*decoded)) == decoded


def check_envelope(data: bytes) -> None:
    """Decode what base station and dongle say to each other in the native dialect."""
    decoded = decode_envelope(data)
    if not isinstance(decoded, EnvelopeFault) and not _is_mended(decoded):
        assert decode_envelope(encode_envelope(decoded)) == decoded


def check_xbee_body(data: bytes) -> None:
    """Decode the data of an XBee API frame."""
    decoded = decode_xbee(data)
    if not isinstance(decoded, XBeeFault):
        assert decode_xbee(encode_xbee(decoded)) == decoded


def check_znp_body(data: bytes) -> None:
    """Decode an MT command."""
    decoded = decode_command(data)
    if not isinstance(decoded, ZnpFault):
        assert decode_command(encode_command(decoded)) == decoded
    short = (decoded.cluster, decoded.source, decoded.lqi, decoded.data) if isinstance(decoded, IncomingMessage) else None
    assert unpack_incoming(data) == short


def check_host(dialect: str, data: bytes) -> None:
    """Let a host live through a script."""
    host = make_host(dialect)
    framings = framings_of(dialect, to_dongle=False)
    now_ns, session, n_sent = 0, 1, 0
    tickets: list[int] = []

    def take(events: list[HostEvent]) -> None:
        nonlocal session
        for event in events:
            if isinstance(event, PayloadHeard):
                host.confirm(event.receipt)
            elif isinstance(event, HostLost):
                session += 1
                take(host.open(session=session, now_ns=now_ns))

    take(host.open(session=session, now_ns=now_ns))
    for code, argument in _script(data):
        match code % 6:
            case 0:
                take(host.feed(argument, now_ns=now_ns))
            case 1 | 2:
                framing = framings[code // 6 % len(framings)]
                take(host.feed(framing.frame_of(argument), now_ns=now_ns))
            case 3:
                now_ns += (1 + code) * len(argument) * _MS
                take(host.handle_deadline(now_ns=now_ns))
            case 4:
                try:
                    destination = ShortAddress(int.from_bytes(argument[:2], "little"))
                    tickets.append(host.send(destination=destination, payload=argument[:MAX_RADIO_PAYLOAD], now_ns=now_ns))
                except LinkFullError:
                    pass
            case _:
                n_sent += sum(map(len, host.take_frames()))
                if tickets:
                    host.forget(tickets.pop())
        due_ns = host.next_deadline_ns()
        assert due_ns is None or isinstance(due_ns, int)
    host.take_frames()
    held = measure_held(host)
    assert held.n_bytes <= _MOST_BYTES, (dialect, held)
    assert held.n_members <= _MOST_MEMBERS, (dialect, held)


def check_dongle(dialect: str, data: bytes, *, has_faults: bool = False) -> None:
    """Let a virtual dongle live through a script."""
    config = FaultConfig(reset=5.0, full=5.0, wrong_status=0.5) if has_faults else FaultConfig()
    dongle = with_faults(make_dongle(dialect, index=0), config, seed=1, line=0)
    framings = framings_of(dialect, to_dongle=True)
    now_ns = 0
    dongle.start(now_ns=now_ns)
    for code, argument in _script(data):
        match code % 6:
            case 0:
                dongle.feed(argument, now_ns=now_ns)
            case 1 | 2:
                framing = framings[code // 6 % len(framings)]
                dongle.feed(framing.frame_of(argument), now_ns=now_ns)
            case 3:
                now_ns += (1 + code) * len(argument) * _MS
                dongle.handle_deadline(now_ns=now_ns)
            case 4:
                source = ShortAddress(1 + code)
                dongle.node_joined(source, eui64=code, now_ns=now_ns)
                received = RadioReceived(source=source, rssi_dbm=RssiDbm(-60), lqi=code, payload=argument[:MAX_RADIO_PAYLOAD])
                dongle.take_from_radio(received, eui64=code, now_ns=now_ns)
            case _:
                dongle.take_bytes()
                _answer(dongle, code, now_ns=now_ns)
        due_ns = dongle.next_deadline_ns()
        assert due_ns is None or isinstance(due_ns, int)
    _answer(dongle, 0, now_ns=now_ns)
    dongle.take_bytes()
    held = measure_held(dongle)
    assert held.n_bytes <= _MOST_BYTES, (dialect, held)
    assert held.n_members <= _MOST_MEMBERS, (dialect, held)


def check_pair(dialect: str, data: bytes) -> None:
    """Let a host and a dongle talk over a line that a script harms; when it is left alone, both find each other again."""
    pair = Pair(dialect)
    for code, argument in _script(data):
        match code % 8:
            case 0:
                pair.step(1 + len(argument), status=code // 8)
            case 1:
                pair.step(20, harm=argument)
            case 2:
                pair.to_host(argument)
            case 3:
                pair.to_dongle(argument)
            case 4:
                pair.restart()
            case 5:
                pair.offer(argument)
            case 6:
                pair.send(argument)
            case _:
                pair.step(100 * (1 + len(argument)))
    assert pair.recovers(), dialect
    held = measure_held(pair)
    assert held.n_bytes <= 2 * _MOST_BYTES, (dialect, held)
    assert held.n_members <= 2 * _MOST_MEMBERS, (dialect, held)


def _answer(dongle: Dongle, code: int, *, now_ns: int) -> None:
    statuses = tuple(RadioStatus)
    while dongle.requests:
        dongle.confirm(dongle.requests.popleft().handle, statuses[code // 6 % len(statuses)], now_ns=now_ns)


def _script(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Cut bytes into (code, argument): a byte each for the code and the argument's length."""
    at = 0
    while at < len(data):
        size = data[at + 1] if at + 1 < len(data) else 0
        yield data[at], data[at + 2 : at + 2 + size]
        at += 2 + size


def _is_mended(decoded: object) -> bool:
    """Whether a text held octets that are no UTF-8: what stands for them takes more room, so that it may not fit a second time."""
    return "\ufffd" in getattr(decoded, "text", "")


TARGETS: dict[str, Callable[[bytes], None]] = {
    **{f"framing: {name}": partial(check_framing, framing) for name, framing in FRAMINGS.items()},
    "uplink messages": check_uplink,
    "downlink messages": check_downlink,
    "envelopes": check_envelope,
    "xbee frame data": check_xbee_body,
    "znp commands": check_znp_body,
    **{f"host: {dialect}": partial(check_host, dialect) for dialect in DIALECTS},
    **{f"dongle: {dialect}": partial(check_dongle, dialect) for dialect in DIALECTS},
    **{f"both ends: {dialect}": partial(check_pair, dialect) for dialect in DIALECTS},
    "dongle with faults: native": partial(check_dongle, "native", has_faults=True),
}
"""By name; each takes any bytes."""
