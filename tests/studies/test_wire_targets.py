"""What the fuzzer calls: every target takes any bytes of a few seeds, and one that breaks a law is found out."""

import random
from collections import deque
from dataclasses import replace

import pytest

from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.framing.interface import FrameFault
from studies.held_state import Held, measure_held
from studies.wire_framings import FRAMINGS
from studies.wire_targets import TARGETS, check_framing

# Bytes that mean something to some framing or link, among others.
TELLING = bytes.fromhex("7e7d5e5d1113fe00010344818b90ff")


def some_bytes(draw: random.Random, size: int) -> bytes:
    share = draw.random()
    return bytes(draw.choice(TELLING) if draw.random() < share else draw.randrange(256) for _ in range(size))


@pytest.mark.parametrize("name", TARGETS)
def test_no_bytes_break_a_law(name: str) -> None:
    draw = random.Random(name)
    for _ in range(20):
        TARGETS[name](some_bytes(draw, draw.randrange(400)))
    TARGETS[name](b"")


class Forgetful(CobsDecoder):
    """Loses what a chunk leaves over."""

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        self._buffer.clear()
        return super().feed(chunk)


class Hoarder(CobsDecoder):
    """Keeps all that it ever heard."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[bytes] = []

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        self.heard.append(chunk)
        return super().feed(chunk)


@pytest.mark.parametrize("kind", [Forgetful, Hoarder])
def test_a_decoder_that_breaks_a_law_is_found_out(kind: type[CobsDecoder]) -> None:
    stream = encode_frame(b"one body") * 80
    stream += bytes(-len(stream) % 8)
    with pytest.raises(AssertionError):
        check_framing(replace(FRAMINGS["native"], make_decoder=kind), stream)


def test_what_is_held_is_counted_through_slots_containers_and_once() -> None:
    shared = b"abc"
    assert measure_held([shared, shared, {"k": bytearray(5)}, deque([1, 2])]) == Held(3 + 1 + 5, 4 + 1 + 2)
    decoder = CobsDecoder()
    decoder.feed(b"\x05abc")
    assert measure_held(decoder) == Held(4, 0)
