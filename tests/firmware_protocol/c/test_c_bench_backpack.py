"""The bench's virtual backpack, which stands behind the emulated board, keeps WIRE_FORMAT.md sections 5 and 6."""

import ctypes
import shlex
import subprocess
from dataclasses import dataclass, field

import pytest
from msgspec.structs import replace

from firmware_protocol.message_codec import decode_uplink, encode_downlink
from firmware_protocol.messages import (
    Acknowledge,
    Action,
    ConfigurationReport,
    ConfigurationResult,
    Configure,
    Downlink,
    EncounterBatch,
    Hello,
    HelloRequest,
    Limits,
    MessageFault,
    Status,
    Stimulate,
    StimulateReply,
    StimulationResult,
    Uplink,
    Waveform,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, RssiDbm
from hatch_build import find_compiler
from studies.c_wire import SOURCES

BOOT = BootId(1)
FLAGS = ("-std=c11", "-O1", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror")
FILES = ("bench/bb_bench_backpack", "bench/bb_bench_encounters", "biobot_backpack", "biobot_codec", "biobot_crc", "biobot_layouts")


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler here: install gcc")
    library = tmp_path_factory.mktemp("bench") / "bench.so"
    sources = [str(SOURCES / f"{name}.c") for name in FILES]
    command = [*shlex.split(compiler), *FLAGS, f"-I{SOURCES}", f"-I{SOURCES / 'bench'}", *sources, "-o", str(library)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = ctypes.CDLL(str(library))
    loaded.bb_bench_backpack_speak.restype = ctypes.c_uint8
    return loaded


@dataclass
class Pack:
    """A virtual backpack and a base station that acknowledges all."""

    library: ctypes.CDLL
    now_ms: int = 1_000
    said: list[tuple[int, Uplink]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.memory = ctypes.create_string_buffer(4096)
        self.payload = ctypes.create_string_buffer(57)
        self.library.bb_bench_backpack_boot(self.memory, ctypes.c_uint8(3), ctypes.c_uint32(self.now_ms))

    def hear(self, message: Downlink, *, is_broadcast: bool = False) -> None:
        payload = encode_downlink(0, message)
        self.library.bb_bench_backpack_hear(
            self.memory, payload, ctypes.c_uint8(len(payload)), ctypes.c_bool(is_broadcast), ctypes.c_uint32(self.now_ms)
        )

    def listen(self, until_ms: int | None = None) -> list[Uplink]:
        """Return what it says by then, encounters left out."""
        before = len(self.said)
        while True:
            while size := self.library.bb_bench_backpack_speak(self.memory, ctypes.c_uint32(self.now_ms), self.payload):
                decoded = decode_uplink(self.payload.raw[:size])
                assert not isinstance(decoded, MessageFault)
                self.said.append((decoded[0].sequence, decoded[1]))
                self.acknowledge()
            if until_ms is None or self.now_ms >= until_ms:
                return [message for _, message in self.said[before:] if not isinstance(message, EncounterBatch)]
            self.now_ms += 10

    def acknowledge(self) -> None:
        taken = {number for number, _ in self.said}
        first = next(number for number in range(len(taken) + 1) if number not in taken)
        self.hear(Acknowledge(boot=BOOT, next_sequence=first, bitmap=sum(1 << i for i in range(32) if first + 1 + i in taken)))

    def command(self, number: int, action: Action, **changes: int) -> list[Uplink]:
        self.hear(replace(TRAIN, command=number, action=action, **changes))
        return self.listen()


TRAIN = Stimulate(
    command=1, action=Action.START, ttl_ms=2_000, hold_ms=0, frequency_hz=50, pulse_width_us=5_000, amplitude_mv=2_000, duration_ms=500
)


def results(said: list[Uplink]) -> dict[int, StimulationResult]:
    return {one.command: one.result for one in said if isinstance(one, StimulateReply)}


def states(said: list[Uplink]) -> list[tuple[WireMode, WireCause]]:
    return [(one.mode, one.cause) for one in said if isinstance(one, Status)]


def test_a_boot_begins_with_hello_and_limits(bench: ctypes.CDLL) -> None:
    pack = Pack(bench)
    pack.listen()
    assert [(number, type(message)) for number, message in pack.said[:3]] == [(0, Hello), (1, Limits), (2, Status)]


@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ({"frequency_hz": 150, "pulse_width_us": 3_333}, StimulationResult.DONE),
        ({"frequency_hz": 100, "pulse_width_us": 5_001}, StimulationResult.BAD_PARAMETER),
        ({"frequency_hz": 0}, StimulationResult.BAD_PARAMETER),
        ({"pulse_width_us": 0}, StimulationResult.BAD_PARAMETER),
        ({"amplitude_mv": 4_001}, StimulationResult.REFUSED_LIMIT),
        ({"frequency_hz": 151, "pulse_width_us": 100}, StimulationResult.REFUSED_LIMIT),
        ({"channel": 4}, StimulationResult.REFUSED_LIMIT),
        ({"channel": 77}, StimulationResult.REFUSED_LIMIT),
        ({"waveform": Waveform.MONOPHASIC}, StimulationResult.REFUSED_LIMIT),
        ({"duration_ms": 1_001}, StimulationResult.REFUSED_LIMIT),
    ],
)
def test_unfit_pulses_are_bad_parameters_and_trains_beyond_the_limits_are_refused(
    bench: ctypes.CDLL, changes: dict[str, int], result: StimulationResult
) -> None:
    pack = Pack(bench)
    pack.listen()
    assert results(pack.command(1, Action.TURN_LEFT, **changes)) == {1: result}


@pytest.mark.parametrize("duration_ms", [0, 300])
def test_walls_are_followed_by_no_backpack_without_that_capability(bench: ctypes.CDLL, duration_ms: int) -> None:
    pack = Pack(bench)
    pack.listen()
    assert results(pack.command(1, Action.FOLLOW_WALLS, duration_ms=duration_ms)) == {1: StimulationResult.BAD_PARAMETER}
    assert states(pack.listen(pack.now_ms + 1_000)) == []


def test_a_train_waits_for_the_one_that_runs_four_at_most_and_no_longer_than_it_may(bench: ctypes.CDLL) -> None:
    pack = Pack(bench)
    pack.listen()
    assert results(pack.command(1, Action.TURN_LEFT)) == {1: StimulationResult.DONE}
    for number, ttl_ms in ((2, 2_000), (3, 400), (4, 5_000), (5, 5_000)):
        assert results(pack.command(number, Action.TURN_LEFT, ttl_ms=ttl_ms)) == {}
    assert results(pack.command(6, Action.TURN_LEFT)) == {6: StimulationResult.REFUSED_LIMIT}
    assert results(pack.listen(1_490)) == {3: StimulationResult.EXPIRED}
    assert results(pack.listen(1_500)) == {2: StimulationResult.DONE}
    assert results(pack.command(7, Action.STOP)) == {7: StimulationResult.DONE, 4: StimulationResult.EXPIRED, 5: StimulationResult.EXPIRED}


def test_modes_and_causes_are_told_and_a_turn_leaves_one_that_stands_as_it_is(bench: ctypes.CDLL) -> None:
    pack = Pack(bench)
    assert states(pack.listen()) == [(WireMode.CRW, WireCause.NATURAL)]
    assert states(pack.command(1, Action.STOP, duration_ms=0)) == [(WireMode.S, WireCause.COMMAND)]
    assert states(pack.command(2, Action.TURN_LEFT, hold_ms=300)) == []
    assert states(pack.listen(pack.now_ms + 1_000)) == []
    assert states(pack.command(3, Action.START, hold_ms=2_000)) == [(WireMode.CRW, WireCause.COMMAND)]
    assert states(pack.listen(pack.now_ms + 3_000)) == [(WireMode.S, WireCause.COMMAND)], "whoever controlled it has gone"
    assert states(pack.command(4, Action.START, duration_ms=0)) == [(WireMode.CRW, WireCause.COMMAND)]
    assert states(pack.command(5, Action.STOP, duration_ms=0, hold_ms=500)) == [(WireMode.S, WireCause.COMMAND)]
    assert states(pack.listen(pack.now_ms + 1_000)) == [(WireMode.CRW, WireCause.NATURAL)]


def test_a_pack_that_senses_continuously_has_its_report_period_to_set_and_nothing_else(bench: ctypes.CDLL) -> None:
    pack = Pack(bench)
    pack.listen()
    pack.hear(Configure(token=7, beacon_period_ms=800, report_period_ms=9))
    pack.hear(Configure(token=8, report_period_ms=90))
    reports = [one for one in pack.listen() if isinstance(one, ConfigurationReport)]
    assert [(one.token, one.result, one.report_period_ms) for one in reports] == [
        (7, ConfigurationResult.NOT_SUPPORTED, 60),
        (8, ConfigurationResult.DONE, 90),
    ]
    assert {(one.beacon_period_ms, one.rssi_enter_dbm, one.rssi_exit_dbm, one.gap_tolerance_ms) for one in reports} == {
        (0, RssiDbm(-128), RssiDbm(-128), 0)
    }


def test_a_stop_by_broadcast_is_obeyed_and_answered_within_a_second_and_nothing_else_is(bench: ctypes.CDLL) -> None:
    pack = Pack(bench)
    pack.listen()
    pack.hear(replace(TRAIN, command=1, action=Action.START), is_broadcast=True)
    assert pack.listen(pack.now_ms + 2_000) == []
    pack.hear(replace(TRAIN, command=2, action=Action.STOP), is_broadcast=True)
    said = pack.listen()
    assert (states(said), results(said)) == ([(WireMode.S, WireCause.COMMAND)], {})
    assert results(pack.listen(pack.now_ms + 1_000)) == {2: StimulationResult.DONE}


def test_a_hello_request_is_answered_with_hello_and_limits_by_all_that_hear_it_within_a_second(bench: ctypes.CDLL) -> None:
    pack = Pack(bench)
    pack.listen()
    pack.hear(HelloRequest(), is_broadcast=True)
    assert pack.listen() == []
    assert [type(one) for one in pack.listen(pack.now_ms + 1_000)] == [Hello, Limits]
