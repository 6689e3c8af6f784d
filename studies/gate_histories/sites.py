"""What the histories' sites, orders and frames are drawn from; in each list the plainest comes first, to which a history shrinks."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from firmware_protocol.contract.commands import PulseRequest, StimulationAction, WaveformName
from firmware_protocol.messages import Limits, Waveform
from gateway.config import StimulationTable
from gateway.radio import Fate
from studies.gate_histories.air import FrameFate
from studies.gate_histories.world import Order, Site

TABLES = (
    StimulationTable(flight_s=1.0),
    StimulationTable(flight_s=0.3, max_trains=3, reply_timeout_s=0.5, stop_retry_s=0.2, stop_attempts=3),
    StimulationTable(flight_s=0.2, max_on_s=1.2),
    StimulationTable(),
    StimulationTable(flight_s=2.5, min_gap_s=3.0, max_trains=2, window_s=90.0, reply_timeout_s=1.0),
    StimulationTable(flight_s=0.5, max_on_s=0.9, duration_ms=300, allows_unbalanced=True, min_frequency_hz=20, max_frequency_hz=80),
)

_EASY = Limits(
    channels=0b111,
    waveforms=1 << Waveform.SYMMETRIC_BIPHASIC | 1 << Waveform.ASYMMETRIC_BIPHASIC,
    max_frequency_hz=150,
    max_pulse_width_us=10_000,
    max_amplitude_mv=4_000,
    max_duration_ms=1_000,
    min_gap_ms=0,
    max_on_ms_per_minute=60_000,
    battery_mv=3_000,
    battery_empty_mv=2_000,
    encounter_capacity=100,
)


def _stricter(**limits: int) -> Limits:
    return Limits(**{name: limits.get(name, getattr(_EASY, name)) for name in Limits.__struct_fields__})


LIMITS: Sequence[tuple[Limits, ...]] = (
    (_EASY,),
    (_EASY, _EASY),
    (_stricter(min_gap_ms=5_000), _EASY, _stricter(max_on_ms_per_minute=1_000)),
    (_stricter(max_amplitude_mv=1_500, channels=0b001), _stricter(max_duration_ms=400, min_gap_ms=2_500)),
)

RADIOS: Sequence[tuple[frozenset[int], ...]] = (
    (frozenset({1, 2, 3}),),
    (frozenset({1, 2, 3}), frozenset({1, 2, 3})),
    (frozenset({1, 2}), frozenset({2, 3}), frozenset({1})),
)

WALL_FOLLOWERS: Sequence[frozenset[int]] = (frozenset({1, 2, 3}), frozenset({2}))

SITES = tuple(
    Site(table=table, radio_timeout_s=6.0, limits=limits, radios=radios, wall_followers=wall_followers)
    for table, limits, radios, wall_followers in product(TABLES, LIMITS, RADIOS, WALL_FOLLOWERS)
)

PULSES: Sequence[PulseRequest | None] = (
    None,
    PulseRequest(duration_ms=200),
    PulseRequest(amplitude_mv=1_000, frequency_hz=55, channel=0),
    PulseRequest(duration_ms=0),
    PulseRequest(pulse_width_us=1_000, waveform=WaveformName.ASYMMETRIC, channel=2),
    PulseRequest(duration_ms=500, amplitude_mv=2_000),
    PulseRequest(duration_ms=501),
    PulseRequest(amplitude_mv=2_001),
    PulseRequest(frequency_hz=60),
    PulseRequest(frequency_hz=49),
    PulseRequest(amplitude_mv=0),
    PulseRequest(pulse_width_us=9_001),
    PulseRequest(waveform=WaveformName.MONOPHASIC),
    PulseRequest(channel=7),
    PulseRequest(duration_ms=60_000, amplitude_mv=60_000, frequency_hz=255, pulse_width_us=60_000),
)

MOVES = (StimulationAction.START, StimulationAction.TURN_LEFT, StimulationAction.TURN_RIGHT, StimulationAction.FOLLOW_WALLS)
ACTIONS = (*MOVES, StimulationAction.STOP)
TTLS_MS = (5_000, 500, 60_000, 1, 2_000)
LATE_MS = (0, 100, -500, 4_999, 5_000, -2_001, 3_600_000, -3_600_000, 1_999)
HOLDS_MS = (0, 1_000, 300, 20_000)
COMMANDERS = ("", "joystick")
WAITS_MS = (100, 1, 0, 10, 300, 700, 1_500, 2_000, 2_001, 2_500, 3_300, 6_000, 10_000, 30_000, 61_000)
JUMPS_MS = (3_600_000, -3_600_000, 1_000, -1_000, -5_000, 30_000, -30_000, -86_400_000, 86_400_000)
DOWNS_MS = (100, 0, 1, 1_000, 5_000, 30_000, 90_000)
COMMITS_MS = (2, 0, 20, 400, 900, 1_500)
GAPS_MS = (2_600, 2_000, 2_501, 3_100, 700, 10)


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """A start, a turn or a walk along walls as most are, and a wait after it."""

    number: int
    action: StimulationAction
    wait_ms: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Turns one after the other; where ``stop_at`` is not 0, that one of each six is a stop."""

    number: int
    n: int
    gap_ms: int
    stop_at: int


_MOVES = {"number": (0, 1, 2), "action": MOVES, "wait_ms": WAITS_MS}
_SERIES = {"number": (0, 1, 2), "n": tuple(range(1, 13)), "gap_ms": GAPS_MS, "stop_at": tuple(range(7))}
_ORDERS = {
    "node": (1, 2, 3, 4),
    "action": ACTIONS,
    "ttl_ms": TTLS_MS,
    "late_ms": LATE_MS,
    "hold_ms": HOLDS_MS,
    "commander": COMMANDERS,
    "pulse": PULSES,
}
_FATES = {
    "queued_ms": (1, 0, 30, 200, 900, 4_000),
    "flight": (0.001, 0.0, 0.2, 0.5, 0.9, 1.0),
    "n_copies": (1, 0, 2),
    "confirm": (Fate.SENT, Fate.NO_ACK, Fate.UNKNOWN, Fate.NOT_SENT),
    "confirm_ms": (10, 0, 500, 3_000),
    "answer_ms": (10, 0, 300, 2_000, 20_000),
    "n_lost_answers": (0, 1, 2, 5),
}


def _n_of(fields: Mapping[str, Sequence[object]]) -> int:
    return math.prod(len(values) for values in fields.values())


def _pick(fields: Mapping[str, Sequence[object]], number: int) -> dict[str, Any]:
    """Return one of all combinations of values; number 0 has the first of each."""
    picked = {}
    for name, values in fields.items():
        number, at = divmod(number, len(values))
        picked[name] = values[at]
    return picked


N_MOVES, N_SERIES, N_ORDERS, N_FATES = _n_of(_MOVES), _n_of(_SERIES), _n_of(_ORDERS), _n_of(_FATES)


def move(number: int) -> Move:
    """Return a move of a number below ``N_MOVES``."""
    return Move(**_pick(_MOVES, number))


def series(number: int) -> Series:
    """Return a series of a number below ``N_SERIES``."""
    return Series(**_pick(_SERIES, number))


def order(number: int) -> Order:
    """Return an order of a number below ``N_ORDERS``; its node is 4 where it is nobody's."""
    return Order(**_pick(_ORDERS, number))


def fate(number: int) -> FrameFate:
    """Return the fate of a number below ``N_FATES``; 0 is a good radio's."""
    return FrameFate(**_pick(_FATES, number))
