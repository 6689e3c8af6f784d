"""The CC2530's main loop and radio driver, compiled for this machine over a model of the chip's registers, against the native host.

The chip itself is not here: what is pinned is the driver's logic, not the radio's timing.
"""

import ctypes
import shlex
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.interface import HostEvent, PayloadHeard, SendSettled
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.envelope import RadioStatus
from firmware_protocol.units import ShortAddress
from hatch_build import find_compiler
from studies.c_wire import SOURCES

MS = 1_000_000
NODE = ShortAddress(0x1010)
CORE = ("codec", "coordinator", "crc", "frame", "layouts", "link")
FLAGS = ("-std=c11", "-O1", "-fPIC", "-shared", "-Wall", "-Wextra", "-Wno-main", "-Werror", "-Dmain=cc2530_main")


@pytest.fixture(scope="session")
def chip(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler here: install gcc")
    here, port = Path(__file__).parent, SOURCES / "ports" / "cc2530"
    library = tmp_path_factory.mktemp("cc2530") / "cc2530.so"
    sources = [here / "cc2530_model.c", port / "radio.c", *(SOURCES / f"biobot_{name}.c" for name in CORE)]
    command = [
        *shlex.split(compiler), *FLAGS, f"-I{SOURCES}", f"-I{port}", f"-I{here}", "-include", str(here / "cc2530_model.h"),
        *map(str, sources), "-o", str(library),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = ctypes.CDLL(str(library))
    loaded.model_hear.restype = ctypes.c_bool
    loaded.model_take.restype = loaded.model_transmissions.restype = ctypes.c_uint16
    loaded.bb_coordinator_counters.restype = ctypes.POINTER(ctypes.c_uint16 * 4)
    return loaded


@dataclass
class Room:
    """A base station that may stall, the chip, and a backpack near it."""

    chip: ctypes.CDLL
    host: NativeHost = field(default_factory=NativeHost)
    now_ms: int = 0
    confirms: bool = True
    unconfirmed: list[int] = field(default_factory=list)
    events: list[HostEvent] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.octets = ctypes.create_string_buffer(65536)
        self.chip.model_start()
        self.host.open(session=1, now_ns=0)
        self.run(5)

    def run(self, n_ms: int) -> None:
        for _ in range(n_ms):
            self.now_ms += 1
            self.note(self.host.handle_deadline(now_ns=self.now_ms * MS))
            chunk = b"".join(self.host.take_frames())
            self.chip.model_feed(chunk, ctypes.c_uint16(len(chunk)))
            self.chip.model_run_a_millisecond()
            size = self.chip.model_take(self.octets)
            self.note(self.host.feed(self.octets.raw[:size], now_ns=self.now_ms * MS))

    def note(self, events: list[HostEvent]) -> None:
        self.events += events
        self.unconfirmed += [event.receipt for event in events if isinstance(event, PayloadHeard)]
        while self.confirms and self.unconfirmed:
            self.host.confirm(self.unconfirmed.pop(0))

    def hear(self, payload: bytes) -> bool:
        return bool(self.chip.model_hear(ctypes.c_uint16(NODE), payload, ctypes.c_uint8(len(payload))))

    def send(self) -> tuple[int, int]:
        """Send a payload down; return its ticket, and how often it was on the air."""
        before = self.chip.model_transmissions()
        ticket = self.host.send(destination=NODE, payload=b"stop", now_ns=self.now_ms * MS)
        self.run(200)
        return ticket, self.chip.model_transmissions() - before

    def status(self, ticket: int) -> RadioStatus:
        (status,) = [RadioStatus(event.status) for event in self.events if isinstance(event, SendSettled) and event.ticket == ticket]
        return status

    def resume(self) -> None:
        """The base station stalls no more; let it take all that waits."""
        self.confirms = True
        self.note([])
        self.run(3_000)

    @property
    def n_refused(self) -> int:
        return int(self.chip.bb_coordinator_counters().contents[2])

    @property
    def heard(self) -> list[bytes]:
        return [event.received.payload for event in self.events if isinstance(event, PayloadHeard)]


def fill_queue(room: Room) -> list[bytes]:
    """Stall the base station and let the backpack talk on; return all that it says."""
    room.confirms = False
    said = [number.to_bytes(2, "little") + bytes(38) for number in range(200)]
    for payload in said:
        assert room.hear(payload), "the driver leaves nothing in the radio"
        room.run(1)
    return said


def test_a_payload_that_its_backpack_acknowledged_is_sent_once_whether_or_not_the_queue_is_full(chip: ctypes.CDLL) -> None:
    room = Room(chip)
    idle, n_idle = room.send()
    fill_queue(room)
    assert room.n_refused
    stalled, n_stalled = room.send()
    room.resume()
    assert (n_idle, n_stalled) == (1, 1)
    assert (room.status(idle), room.status(stalled)) == (RadioStatus.SENT, RadioStatus.SENT)


def test_each_payload_without_room_is_counted_once_and_those_that_had_room_arrive_in_order(chip: ctypes.CDLL) -> None:
    room = Room(chip)
    said = fill_queue(room)
    n_refused = room.n_refused
    room.resume()
    assert room.heard == said[: len(said) - n_refused]
    assert room.hear(b"again")
    room.run(50)
    assert room.heard[-1] == b"again"


@given(lengths=st.lists(st.integers(1, 30), min_size=1, max_size=3))
def test_an_acknowledgement_behind_payloads_in_the_radio_is_found(chip: ctypes.CDLL, lengths: list[int]) -> None:
    room = Room(chip)
    fill_queue(room)
    room.host.send(destination=NODE, payload=b"stop", now_ns=room.now_ms * MS)
    for length in lengths:
        assert room.hear(bytes([length]) * length)
    before = chip.model_transmissions()
    room.run(200)
    assert chip.model_transmissions() == before + 1
