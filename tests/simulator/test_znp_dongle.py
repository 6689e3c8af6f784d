"""The virtual Z-Stack chip alone: its memory, its endpoints, its bounds, what it refuses."""

from collections import Counter
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.znp_opening import ZnpHostConfig
from firmware_protocol.envelope import RadioReceived
from firmware_protocol.framing.znp import encode_frame
from firmware_protocol.units import RssiDbm
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.frames import Request
from firmware_protocol.znp.numbers import BIOBOT_CLUSTER, BIOBOT_ENDPOINT, Command, NvItem, ZnpStatus
from tests.simulator.znp_bench import (
    CC2531,
    EUI64,
    NODE,
    S,
    a_running_dongle,
    ask,
    frame,
    opened,
)


def test_what_is_not_understood_is_answered_as_zstack_does() -> None:
    dongle = a_running_dongle()
    for body, answer in (("277F", "600002277F"), ("3F00", "6000013F00"), ("2109", "6000042109")):
        dongle.feed(encode_frame(bytes.fromhex(body)), now_ns=S)
        assert dongle.take_bytes() == encode_frame(bytes.fromhex(answer))
    dongle.feed(encode_frame(bytes.fromhex("477F")), now_ns=S)
    assert not dongle.take_bytes(), "what wants no answer gets none"


def test_zstack_1_2_knows_no_commissioning() -> None:
    (answer,) = ask(a_running_dongle(CC2531), znp.CommissioningRequest(mode=4))
    assert answer == znp.RpcError(error=2, command=Command.APP_CNF_BDB_START_COMMISSIONING)


@given(st.integers(0x0401, 0x0FFF), st.binary(min_size=1, max_size=60), st.data())
def test_memory_holds_what_is_written_through_a_reset(item: int, value: bytes, draw: st.DataObject) -> None:
    dongle = a_running_dongle()
    status = [
        one.status for one in ask(dongle, znp.NvInitRequest(item=item, length=len(value), value=value)) if isinstance(one, znp.StatusReply)
    ]
    assert status == [ZnpStatus.NV_ITEM_UNINITIALIZED], "it was made"
    offset = draw.draw(st.integers(0, len(value) - 1))
    ask(dongle, znp.NvWriteRequest(item=item, offset=offset, value=b"\xaa"))
    dongle.start(now_ns=2 * S)
    dongle.handle_deadline(now_ns=3 * S)
    dongle.take_bytes()
    expected = value[:offset] + b"\xaa" + value[offset + 1 :]
    assert ask(dongle, znp.NvReadRequest(item=item)) == [znp.NvReadReply(status=0, value=expected)]
    assert ask(dongle, znp.NvLengthRequest(item=item)) == [znp.NvLengthReply(length=len(value))]
    ask(dongle, znp.NvDeleteRequest(item=item, length=len(value)))
    assert ask(dongle, znp.NvLengthRequest(item=item)) == [znp.NvLengthReply(length=0)]


def test_memory_is_bounded_and_says_so() -> None:
    dongle = a_running_dongle()
    made = Counter(
        one.status
        for item in range(0x0401, 0x0601)
        for one in ask(dongle, znp.NvInitRequest(item=item, length=1, value=b"\x00"))
        if isinstance(one, znp.StatusReply)
    )
    assert made[ZnpStatus.NV_ITEM_UNINITIALIZED] <= 256
    assert made[ZnpStatus.NV_OPERATION_FAILED] >= 256
    beyond = ask(dongle, znp.NvWriteRequest(item=NvItem.PANID, offset=1, value=b"ab"))
    assert beyond == [znp.StatusReply(command=Command.SYS_OSAL_NV_WRITE, status=ZnpStatus.INVALID_PARAMETER)]


def test_data_for_an_endpoint_that_no_backpack_has_goes_unacknowledged() -> None:
    bench = opened()
    request = znp.DataRequest(
        destination=NODE, destination_endpoint=1, source_endpoint=BIOBOT_ENDPOINT, cluster=6, transaction=9, options=0, radius=1, data=b"x"
    )  # fmt: skip
    assert ask(bench.dongle, request) == [
        znp.StatusReply(command=Command.AF_DATA_REQUEST, status=0),
        znp.DataConfirm(status=ZnpStatus.APS_NO_ACK, endpoint=BIOBOT_ENDPOINT, transaction=9),
    ]
    assert not bench.dongle.requests


def test_the_line_holds_only_so_much() -> None:
    bench = opened()
    received = RadioReceived(source=NODE, rssi_dbm=RssiDbm(-60), lqi=90, payload=bytes(57))
    taken = sum(bench.dongle.take_from_radio(received, eui64=EUI64, now_ns=bench.now_ns) for _ in range(1_000))
    assert 40 <= taken <= 60
    for _ in range(2_000):
        bench.dongle.feed(frame(znp.PingRequest()), now_ns=bench.now_ns)
    assert len(bench.dongle.take_bytes()) < 9_000


def test_every_request_of_the_host_is_one_that_the_chip_knows() -> None:
    bench = opened()
    bench.run(5_000)
    assert {type(one) for one in bench.asked} <= set(Request.__args__)
    assert not bench.dongle.faults.keys() & {"unknown_command", "bad_command_length", "wrong_direction"}


def test_a_start_forgets_what_the_startup_option_says() -> None:
    """Bit 1 is the network, bit 0 what hosts wrote into the factory's items; what hosts made themselves stays."""
    for option, keeps_network, keeps_pan in ((0, True, True), (1, True, False), (2, False, True), (3, False, False)):
        bench = opened(host=ZnpHostConfig(pan_id=0x0ABC))
        ask(bench.dongle, znp.NvInitRequest(item=0x0F00, length=1, value=b"\x55"))
        ask(bench.dongle, znp.NvWriteRequest(item=NvItem.STARTUP_OPTION, value=bytes((option,))))
        ask(bench.dongle, znp.ResetRequest(kind=1))
        bench.dongle.handle_deadline(now_ns=10 * S)
        memory = bench.dongle.memory
        assert (memory.network is not None) is keeps_network
        assert memory[NvItem.BDB_IS_ON_NETWORK] == keeps_network
        assert (memory[NvItem.PANID] == 0x0ABC) is keeps_pan
        assert memory[NvItem.HOST_CONFIGURED] == 0x55
        assert memory[NvItem.STARTUP_OPTION] == 0


def test_items_of_the_newer_layout_are_read_piece_by_piece_where_there_are_any() -> None:
    length = znp.ExtendedNvLengthRequest(system=1, item=4, sub_item=0)
    assert ask(a_running_dongle(), length) == [znp.ExtendedNvLengthReply(length=20)]
    for offset, n, sub_item, answer in (
        (4, 16, 0, znp.ExtendedNvReadReply(status=0, value=bytes(16))),
        (5, 16, 0, znp.ExtendedNvReadReply(status=ZnpStatus.INVALID_PARAMETER, value=b"")),
        (0, 16, 9, znp.ExtendedNvReadReply(status=ZnpStatus.NV_OPERATION_FAILED, value=b"")),
    ):
        request = znp.ExtendedNvReadRequest(system=1, item=4, sub_item=sub_item, offset=offset, length=n)
        assert ask(a_running_dongle(), request) == [answer]
    assert ask(a_running_dongle(CC2531), length) == [znp.RpcError(error=2, command=Command.SYS_NV_LENGTH)]


def test_what_cannot_be_sent_is_refused_at_once() -> None:
    def a_request(**changed: object) -> znp.DataRequest:
        return replace(
            znp.DataRequest(
                destination=NODE, destination_endpoint=BIOBOT_ENDPOINT, source_endpoint=BIOBOT_ENDPOINT, cluster=BIOBOT_CLUSTER,
                transaction=0, options=0, radius=1, data=b"x",
            ),
            **changed,  # type: ignore[arg-type]
        )  # fmt: skip

    bench = opened()
    for request, expected in (
        (a_request(source_endpoint=7), ZnpStatus.INVALID_PARAMETER),
        (a_request(data=bytes(58)), ZnpStatus.MAC_FRAME_TOO_LONG),
    ):
        assert ask(bench.dongle, request) == [znp.StatusReply(command=Command.AF_DATA_REQUEST, status=expected)]
    assert not bench.dongle.requests
