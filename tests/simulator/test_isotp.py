"""The virtual coordinator's ISO-TP end beside can-isotp, which knows the whole standard."""

from collections import deque

import isotp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.dongles.isotp import MAX_MESSAGE, IsoTpEnd

MS = 1_000_000


class Peer:
    """can-isotp at the other end of a bus without delay."""

    def __init__(self, end: IsoTpEnd, *, block_size: int = 0, stmin: int = 0) -> None:
        self.end = end
        self.heard: list[bytes] = []
        self.errors: list[Exception] = []
        self.now_ns = 0
        self._to_peer: deque[isotp.CanMessage] = deque()
        self.layer = isotp.TransportLayerLogic(
            rxfn=lambda _: self._to_peer.popleft() if self._to_peer else None,
            txfn=lambda message: self._hear(bytes(message.data)),
            address=isotp.Address(isotp.AddressingMode.Normal_29bits, txid=1, rxid=2),
            error_handler=self.errors.append,
            params={"blocksize": block_size, "stmin": stmin},
        )

    def run(self, for_ms: int) -> None:
        for _ in range(for_ms):
            self.now_ns += MS
            self.end.handle_deadline(now_ns=self.now_ns)
            for data in self.end.take_frames():
                self._to_peer.append(isotp.CanMessage(arbitration_id=2, dlc=len(data), data=data, extended_id=True))
            self.layer.process()

    def _hear(self, data: bytes) -> None:
        message = self.end.take(data, now_ns=self.now_ns)
        if message is not None:
            self.heard.append(message)


@given(st.binary(min_size=1, max_size=MAX_MESSAGE))
def test_what_can_isotp_sends_is_heard(message: bytes) -> None:
    peer = Peer(IsoTpEnd())
    peer.layer.send(message)
    peer.run(20)
    assert peer.heard == [message]
    assert not peer.errors
    assert not peer.end.n_faults


@given(st.binary(min_size=1, max_size=MAX_MESSAGE), st.integers(0, 4), st.integers(0, 3))
def test_can_isotp_hears_what_is_sent_at_its_own_pace(message: bytes, block_size: int, stmin: int) -> None:
    peer = Peer(IsoTpEnd(), block_size=block_size, stmin=stmin)
    peer.end.send(message, now_ns=0)
    peer.run(80)
    assert bytes(peer.layer.recv() or b"") == message
    assert not peer.errors
    assert peer.end.next_deadline_ns() is None


def test_a_message_that_is_too_long_is_refused() -> None:
    peer = Peer(IsoTpEnd())
    peer.layer.send(bytes(MAX_MESSAGE + 1))
    peer.run(20)
    assert peer.heard == []
    assert [type(error) for error in peer.errors] == [isotp.errors.OverflowError]


@pytest.mark.parametrize("lost", [b"\x10\x14abcdef", b"\x10\x14abcdef\x22abcdefg"])
def test_a_message_whose_rest_does_not_come_is_forgotten_and_the_next_is_heard(lost: bytes) -> None:
    end = IsoTpEnd()
    for at in range(0, len(lost), 8):
        assert end.take(lost[at : at + 8], now_ns=0) is None
    end.handle_deadline(now_ns=1000 * MS)
    assert end.n_faults == 1
    assert end.take(b"\x03new", now_ns=1000 * MS) == b"new"
    assert end.next_deadline_ns() is None


def test_without_a_flow_control_a_long_message_is_given_up() -> None:
    end = IsoTpEnd()
    end.send(bytes(20), now_ns=0)
    assert end.next_deadline_ns() == 1000 * MS
    end.handle_deadline(now_ns=1000 * MS)
    assert end.take(b"\x30\x00\x00", now_ns=1001 * MS) is None
    assert end.n_faults == 2
    assert len(end.take_frames()) == 1


@given(st.lists(st.binary(max_size=8), max_size=40))
def test_no_frames_crash_it_or_grow_its_memory(frames: list[bytes]) -> None:
    end = IsoTpEnd()
    end.send(bytes(MAX_MESSAGE), now_ns=0)
    for now_ns, data in enumerate(frames):
        end.take(data, now_ns=now_ns * 200 * MS)
        end.handle_deadline(now_ns=now_ns * 200 * MS)
        assert len(end._incoming) <= MAX_MESSAGE + 7
        assert len(end.take_frames()) <= 12
