"""The emulated slcan adapter: its answers, its limits, and frames both ways."""

import asyncio
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing.can import encode_message
from firmware_protocol.framing.can_frame import FD_SIZES, CanFrame, CanId, Direction, encode_record, make_frame
from simulator.errors import ParameterError
from simulator.lines.line import parse_line
from simulator.lines.slcan_port import SlcanAdapter, SlcanEnd

# Lawicel CAN232 manual, version 3: a command is answered with CR, one that is refused with BEL, a frame with z or Z and CR.
GOLDEN = [
    (b"\r", b"\r"),
    (b"S6\rO\rC\r", b"\r\r\r"),
    (b"O\rS6\r", b"\r\a"),
    (b"C\r", b"\a"),
    (b"O\rO\r", b"\r\a"),
    (b"s031C\r", b"\r"),
    (b"Y2\r", b"\r"),
    (b"V\rN\rF\r", b"V1013\rNB10B\rF00\r"),
    (b"O\rt10021133\r", b"\rz\r"),
    (b"O\rT0000010021133\r", b"\rZ\r"),
    (b"O\rr1002\r", b"\rz\r"),
    (b"t10021133\r", b"\a"),
    (b"L\rt10021133\r", b"\r\a"),
    (b"O\rt8002", b"\r"),
    (b"O\rt80021133\r", b"\r\a"),
    (b"O\rt100311\r", b"\r\a"),
    (b"O\rt1009112233445566778899\r", b"\r\a"),
    (b"O\rT2000000021133\r", b"\r\a"),
    (b"O\rtxyz0\r", b"\r\a"),
    (b"Q\r", b"\a"),
    (b"T" + b"0" * 500 + b"\r\r", b"\a\r"),
]


@pytest.mark.parametrize(("said", "answer"), GOLDEN)
def test_commands_are_answered_as_the_manual_says(said: bytes, answer: bytes) -> None:
    whole, cut = SlcanAdapter(), SlcanAdapter()

    assert whole.feed(said)[0] == answer
    assert b"".join(cut.feed(said[at : at + 1])[0] for at in range(len(said))) == answer


frames = st.booleans().flatmap(
    lambda is_fd: st.builds(
        lambda fields, data: make_frame(CanId(*fields), data, is_fd=is_fd),
        st.tuples(*(st.integers(0, top) for top in (3, 1, 31)), st.integers(1, 6), st.integers(0, 255), st.integers(0, 15)),
        st.sampled_from(FD_SIZES if is_fd else FD_SIZES[:9]).flatmap(lambda size: st.binary(min_size=size, max_size=size)),
    )
)


@given(st.lists(frames, max_size=5))
def test_what_one_adapter_tells_another_can_send(sent: list[CanFrame]) -> None:
    records = b"".join(map(encode_record, sent))
    one, other = SlcanAdapter(), SlcanAdapter()
    assert one.pass_on(records) == b"", "a closed channel hears nothing"
    one.feed(b"O\r")
    other.feed(b"O\r")

    assert other.feed(one.pass_on(records)) == (b"Z\r" * len(sent), records)


@given(st.lists(st.one_of(st.binary(max_size=200), st.text("OCtTdDbB0123456789ABCDEF\r", max_size=60).map(str.encode)), max_size=10))
def test_no_characters_crash_the_adapter_or_grow_its_memory(chunks: list[bytes]) -> None:
    adapter = SlcanAdapter()
    for chunk in chunks:
        adapter.feed(chunk)
        adapter.pass_on(chunk)
        assert len(adapter._line) <= 139


def test_the_port_says_what_a_gateway_is_to_open(tmp_path: Path) -> None:
    async def story() -> None:
        end = SlcanEnd(tmp_path / "can", dialect="canfd:7")
        assert end.address == f"can:slcan:{tmp_path / 'can'}?unit=7&fd=1"
        await end.write(encode_message(b"\x03\x00\x00\x00", unit=7, direction=Direction.FROM_COORDINATOR, is_fd=True))
        await end.aclose()
        assert not (tmp_path / "can").exists()

    asyncio.run(story())


def test_a_link_over_slcan_names_its_unit_and_frames() -> None:
    assert parse_line("slcan:/tmp/can").dialect == "can:1"
    assert parse_line("slcan:/tmp/can?unit=9&fd=1").dialect == "canfd:9"


@pytest.mark.parametrize("options", ["unit=32", "unit=x", "fd=2", "baud=9600", "unit=1&speed=3"])
def test_a_wrong_option_of_a_link_over_slcan_is_refused(options: str) -> None:
    with pytest.raises(ParameterError, match="unit= with 0 to 31"):
        parse_line(f"slcan:/tmp/can?{options}")
