"""Radio messages and envelopes: inverse pairs, limits, hostile input."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.crc import append_crc
from firmware_protocol.envelope import Envelope, EnvelopeFault, RadioSend, decode_envelope, encode_envelope
from firmware_protocol.errors import EncodeError
from firmware_protocol.message_codec import (
    decode_downlink,
    decode_uplink,
    decode_uplink_fields,
    encode_downlink,
    encode_uplink,
    read_encounters,
)
from firmware_protocol.messages import (
    MAX_ENCOUNTER_MS,
    MAX_RADIO_PAYLOAD,
    Acknowledge,
    Downlink,
    EncounterBatch,
    EncounterBatchWithPaths,
    EncounterEntry,
    Hello,
    HelloRequest,
    MessageFault,
    Neighbours,
    Status,
    TimeSyncReply,
    Uplink,
    UplinkHeader,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm, ShortAddress
from tests.strategies import downlinks, envelopes, u16, uplink_headers, uplinks

HEADER = UplinkHeader(node=NodeId(0x0102), boot=BootId(3), sequence=4, sent_ms=Milliseconds(0x01020304))


@given(uplink_headers, uplinks)
def test_decoding_inverts_encoding_of_uplinks(header: UplinkHeader, message: Uplink) -> None:
    payload = encode_uplink(header, message)

    assert len(payload) <= MAX_RADIO_PAYLOAD
    assert decode_uplink(payload) == (header, message)


@given(uplink_headers, uplinks)
def test_encounters_read_as_numbers_are_those_of_the_message(header: UplinkHeader, message: Uplink) -> None:
    fields = decode_uplink_fields(encode_uplink(header, message))
    assert isinstance(fields, tuple)
    entries = message.entries if isinstance(message, EncounterBatch | EncounterBatchWithPaths) else None
    plain = [(one.peer, one.start_ms, one.duration_ms, one.rssi_dbm, one.is_ongoing, one.path_mm) for one in entries or ()]
    assert read_encounters(fields) == (None if entries is None else plain)


@given(u16, downlinks)
def test_decoding_inverts_encoding_of_downlinks(sequence: int, message: Downlink) -> None:
    payload = encode_downlink(sequence, message)

    assert len(payload) <= MAX_RADIO_PAYLOAD
    assert decode_downlink(payload) == (sequence, message)


@given(envelopes)
def test_decoding_inverts_encoding_of_envelopes(envelope: Envelope) -> None:
    assert decode_envelope(encode_envelope(envelope)) == envelope


@given(st.binary(max_size=80))
def test_no_bytes_crash_a_decoder(data: bytes) -> None:
    for payload in (data, append_crc(data)):
        assert isinstance(decode_uplink(payload), tuple | MessageFault)
        assert isinstance(decode_downlink(payload), tuple | MessageFault)
    decode_envelope(data)


@given(st.integers(0, 255), st.binary(max_size=50))
def test_bodies_of_every_type_with_a_good_checksum_decode_or_are_named(kind: int, body: bytes) -> None:
    results = (decode_uplink(append_crc(bytes([kind, 1]) + body)), decode_downlink(append_crc(bytes([kind, 1]) + body)))

    for result in results:
        assert isinstance(result, tuple | MessageFault)


def test_golden_encounter_batch() -> None:
    """Node 0x0102, boot 3, sequence 4; one encounter with node 5 at 6 ms for 0x2ABCDE ms at -70 dBm, ongoing."""
    entry = EncounterEntry(
        peer=NodeId(5), start_ms=Milliseconds(6), duration_ms=Milliseconds(0x2ABCDE), rssi_dbm=RssiDbm(-70), is_ongoing=True
    )

    payload = encode_uplink(HEADER, EncounterBatch(entries=(entry,)))

    assert payload[:-2] == bytes.fromhex("02 01 0201 0300 0400 04030201 0500 06000000 AA DEBC BA")


def test_golden_acknowledge() -> None:
    payload = encode_downlink(7, Acknowledge(boot=BootId(3), next_sequence=9, bitmap=1))

    assert payload[:-2] == bytes.fromhex("82 01 0700 0300 0900 01000000")


def test_golden_radio_send() -> None:
    assert encode_envelope(RadioSend(handle=1, destination=ShortAddress(0xFFFF), payload=b"ab")) == bytes.fromhex("20 0100 FFFF 6162")


def test_faults_are_named() -> None:
    good = encode_uplink(HEADER, TimeSyncReply(token=1, received_ms=Milliseconds(2)))
    body = good[:-2]

    assert decode_uplink(good[:-1]) is MessageFault.BAD_CRC
    assert decode_uplink(append_crc(body[:-1])) is MessageFault.BAD_LENGTH
    assert decode_uplink(append_crc(bytes([5, 2]) + body[2:])) is MessageFault.UNKNOWN_VERSION
    assert decode_uplink(append_crc(bytes([0x7F]) + body[1:])) is MessageFault.UNKNOWN_TYPE
    assert decode_uplink(append_crc(bytes(60))) is MessageFault.TOO_LONG
    assert decode_uplink(append_crc(b"\x05\x01")) is MessageFault.BAD_LENGTH
    status = Status(mode=WireMode.S, cause=WireCause.COMMAND, mode_since_ms=Milliseconds(0), battery_mv=0, buffered=0, dropped=0)
    wrong_mode = bytearray(encode_uplink(HEADER, status)[:-2])
    wrong_mode[12] = 9
    assert decode_uplink(append_crc(bytes(wrong_mode))) is MessageFault.BAD_VALUE
    assert decode_uplink(append_crc(bytes([2, 1]) + body[2:12])) is MessageFault.BAD_LENGTH
    assert decode_uplink(append_crc(bytes([4, 1]) + body[2:12] + bytes([1, 1]))) is MessageFault.BAD_VALUE
    assert decode_uplink(append_crc(bytes([4, 1]) + body[2:12] + bytes([0, 1, 9]))) is MessageFault.BAD_LENGTH
    assert decode_downlink(append_crc(b"\x83\x01\0\0\0")) is MessageFault.BAD_LENGTH
    assert decode_downlink(append_crc(b"\x81\x01\0\0\0")) is MessageFault.BAD_VALUE  # no version is 0
    assert decode_downlink(append_crc(b"\x10\x01\0\0")) is MessageFault.UNKNOWN_TYPE
    assert decode_downlink(b"\x00") is MessageFault.BAD_CRC
    assert decode_envelope(b"\x99") is EnvelopeFault.UNKNOWN_TYPE
    assert decode_envelope(b"\x20\x00") is EnvelopeFault.BAD_LENGTH
    assert decode_envelope(b"\x12\x04\0\0") is EnvelopeFault.BAD_VALUE
    assert decode_envelope(b"") is EnvelopeFault.UNKNOWN_TYPE


def test_what_does_not_fit_is_refused_with_value_and_limit() -> None:
    entry = EncounterEntry(
        peer=NodeId(5), start_ms=Milliseconds(6), duration_ms=Milliseconds(MAX_ENCOUNTER_MS + 1), rssi_dbm=RssiDbm(0), is_ongoing=False
    )
    with pytest.raises(EncodeError, match=str(MAX_ENCOUNTER_MS)):
        encode_uplink(HEADER, EncounterBatch(entries=(entry,)))
    with pytest.raises(EncodeError, match="1 to 4"):
        encode_uplink(HEADER, EncounterBatch(entries=()))
    with pytest.raises(EncodeError, match="n_parts"):
        encode_uplink(HEADER, Neighbours(part=2, n_parts=2, neighbours=()))
    with pytest.raises(EncodeError, match=r"Hello\.eui64"):
        encode_uplink(HEADER, Hello(eui64=-1, firmware=0, beacon_period_ms=0, capabilities=0))
    with pytest.raises(EncodeError, match="Header"):
        encode_downlink(-1, HelloRequest())
    with pytest.raises(EncodeError, match="RadioSend"):
        encode_envelope(RadioSend(handle=-1, destination=ShortAddress(0), payload=b""))
