"""Z-Stack's commands: golden bodies, inverse, what is no command."""

from dataclasses import fields
from typing import get_args, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import EncodeError
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import _BY_KIND as ROWS
from firmware_protocol.znp.codec import Message, answered_command, command_of, decode_command, encode_command, unpack_incoming
from firmware_protocol.znp.frames import Reply, Request, ZnpFault
from firmware_protocol.znp.numbers import ANSWER, Command

# Field by field after SWRA198; the numbers are the project's.
GOLDEN: list[tuple[Message, str]] = [
    (znp.PingRequest(), "2101"),
    (znp.PingReply(capabilities=0x0659), "61015906"),
    (znp.ResetRequest(kind=1), "410001"),
    (znp.ResetIndication(reason=0, transport=2, product=1, major=2, minor=7, hardware=1), "4180000201020701"),
    (znp.VersionReply(transport=2, product=1, major=2, minor=7, maintenance=1, revision=20210708), "6102020102070114643401"),
    (znp.NvReadRequest(item=0x0087), "2108870000"),
    (znp.NvReadReply(status=0, value=b"\x00"), "6108000100"),
    (znp.NvWriteRequest(item=0x0083, value=b"\xff\xff"), "210983000002FFFF"),
    (znp.StatusReply(command=Command.SYS_OSAL_NV_WRITE, status=0), "610900"),
    (
        znp.RegisterRequest(
            endpoint=0xB1, profile=0xCB10, device=0, device_version=0, latency=0, in_clusters=(1,), out_clusters=(1,)
        ),
        "2400B110CB00000000010100010100",
    ),
    (
        znp.DataRequest(
            destination=0x1234, destination_endpoint=0xB1, source_endpoint=0xB1, cluster=1, transaction=7, options=0x20, radius=30,
            data=b"abc",
        ),
        "24013412B1B1010007201E03616263",
    ),
    (znp.DataConfirm(status=0xE9, endpoint=0xB1, transaction=7), "4480E9B107"),
    (
        znp.IncomingMessage(
            group=0, cluster=1, source=0x1234, source_endpoint=0xB1, destination_endpoint=0xB1, was_broadcast=0, lqi=90, security=0,
            timestamp=0x01020304, sequence=9, data=b"abc",
        ),
        "4481000001003412B1B1005A00040302010903616263",
    ),
    (znp.StartupRequest(delay_ms=100), "25406400"),
    (znp.StateChange(state=9), "45C009"),
    (znp.DeviceAnnounced(source=1, address=1, eui64=0x00124B0000000007, capabilities=0x80), "45C10100010007000000004B120080"),
    (znp.PermitJoinRequest(address_mode=0x0F, destination=0xFFFC, duration_s=254, trust_center=0), "25360FFCFFFE00"),
    (znp.RpcError(error=2, command=0x2749), "6000022749"),
    (znp.SetChannelRequest(is_primary=1, channels=1 << 20), "2F080100001000"),
    (znp.CommissioningRequest(mode=4), "2F0504"),
]  # fmt: skip

_STRATEGIES = {
    "B": st.integers(0, 0xFF), "H": st.integers(0, 0xFFFF), "I": st.integers(0, 0xFFFF_FFFF), "Q": st.integers(0, (1 << 64) - 1),
    "*": st.binary(max_size=60), "@": st.lists(st.integers(0, 0xFFFF), max_size=8).map(tuple), "~": st.binary(max_size=40),
}  # fmt: skip
_ANSWERED_BY_STATUS = [
    one for one in Command if one != Command.SYS_RESET_REQ and one | ANSWER not in {row.command for row in ROWS.values()}
]


def _commands(kind: type[Message]) -> st.SearchStrategy[Message]:
    codes = ROWS[kind].codes.replace("?", "")
    return st.builds(kind, **{one.name: _STRATEGIES[code] for one, code in zip(fields(kind), codes, strict=True)})


commands = st.one_of(
    *map(_commands, ROWS),
    st.builds(znp.StatusReply, command=st.sampled_from(_ANSWERED_BY_STATUS).map(int), status=_STRATEGIES["B"]),
    st.builds(znp.RpcError, error=_STRATEGIES["B"], command=_STRATEGIES["H"]),
)


@pytest.mark.parametrize(("message", "body"), GOLDEN)
def test_golden_bodies(message: Message, body: str) -> None:
    assert encode_command(message).hex().upper() == body
    assert decode_command(bytes.fromhex(body)) == message


@given(commands)
def test_decoding_inverts_encoding(message: Message) -> None:
    assert decode_command(encode_command(message)) == message


@given(commands, st.binary(min_size=1, max_size=8))
def test_what_a_newer_firmware_adds_is_ignored(message: Message, more: bytes) -> None:
    if isinstance(message, znp.AssociatedReply | znp.VersionReply):
        return  # the one goes to the end of the frame, the other may be without its last field
    assert decode_command(encode_command(message) + more) == message


@given(commands, st.data())
def test_a_command_that_ends_early_is_a_fault(message: Message, draw: st.DataObject) -> None:
    if isinstance(message, znp.AssociatedReply | znp.VersionReply):
        return
    body = encode_command(message)
    assert decode_command(body[: draw.draw(st.integers(0, len(body) - 1))]) is ZnpFault.BAD_LENGTH


@given(st.binary(max_size=260))
def test_no_body_raises(body: bytes) -> None:
    decode_command(body)


def test_an_older_firmware_tells_no_revision() -> None:
    assert decode_command(bytes.fromhex("61020200020603")) == znp.VersionReply(transport=2, product=0, major=2, minor=6, maintenance=3)


def test_an_unknown_command_is_a_fault() -> None:
    assert decode_command(b"\x21\x7f") is ZnpFault.UNKNOWN_COMMAND


def test_a_value_that_does_not_fit_is_refused() -> None:
    with pytest.raises(EncodeError):
        encode_command(znp.DataConfirm(status=256, endpoint=1, transaction=1))
    with pytest.raises(EncodeError):
        encode_command(znp.NvWriteRequest(item=1, value=bytes(256)))


def test_every_answer_names_its_request() -> None:
    requests = {command_of(kind.__new__(kind)) for kind in get_args(Request)}
    for kind in get_args(Reply):
        if kind is not znp.StatusReply and kind is not znp.RpcError:
            assert answered_command(kind.__new__(kind)) in requests


def test_every_command_has_a_row_with_a_code_for_each_field() -> None:
    for kind, row in ROWS.items():
        assert len(row.codes.replace("?", "")) == len(fields(kind)) == len(get_type_hints(kind))


def test_the_short_way_to_a_payload_says_what_the_long_one_says() -> None:
    message = znp.IncomingMessage(
        group=0, cluster=1, source=0x1234, source_endpoint=0xB1, destination_endpoint=0xB1, was_broadcast=0, lqi=99, security=0,
        timestamp=7, sequence=3, data=b"payload",
    )  # fmt: skip
    body = encode_command(message)
    assert unpack_incoming(body + b"beyond") == (1, 0x1234, 99, b"payload")
    assert unpack_incoming(body[:-1]) is None
    assert unpack_incoming(b"\x44\x80" + body[2:]) is None
