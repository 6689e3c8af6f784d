"""What radios are like, in presets, and the air between backpacks and coordinator: payloads are late, and some are lost.

On the way to the coordinator everything is in range, and loss is independent for each payload. Draws are keyed by (seed, node,
number of the payload), so one biobot's luck does not depend on another's traffic. What happens between backpacks is
``channel.py``'s and ``medium.py``'s.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType

from firmware_protocol.units import RssiDbm
from simulator import chance
from simulator.errors import ParameterError, ScenarioError
from simulator.radios.radio_keys import RadioKeys

_UPLINK_STREAM = 210
_DOWNLINK_STREAM = 213

NEAREST_M = 0.01
"""Path loss grows no smaller than it is here [m]: nearer, antennas are no points."""

# LQI as most radios make it: the signal's place between sensitivity and saturation, on 0 to 255. -97 dBm and 10 dBm are a
# CC2530's (its datasheet, "RF receive").
_LQI_FLOOR_DBM = -97
_LQI_TOP_DBM = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioConfig:
    """The air's parameters. The defaults are a radio that hears everything.

    Parameters
    ----------
    loss
        Probability that a payload is lost, and that the acknowledgement of a delivered one is: 0 up to, not including, 1. A beacon is
        lost with the same probability at each who would hear it.
    delay_ms, jitter_ms
        A payload takes the first, plus an exponential draw with the second as its mean [ms].
    tx_power_dbm, loss_1m_db, exponent
        Log-distance path loss. 1 dBm is a CC2530's; 51.6 dB and 2.4 are those of Castalia's radio example.
    shadowing_db
        Standard deviation of what stands between two biobots for the whole run, the same in both directions [dB].
    asymmetry_db
        Standard deviation of the difference between the two directions of a pair [dB].
    fading_db
        Standard deviation from packet to packet [dB].
    wall_db
        Attenuation by each wall or obstacle that the straight line passes through [dB].
    rssi_offset_db, rssi_step_db
        What a receiver says is wrong by a constant of this standard deviation, and comes in steps of this; 0: not rounded [dB].
    sensitivity_dbm
        At this power 1 % of 20-octet packets are lost; ``-inf``: nothing is too weak.
    burst_good_s, burst_bad_s
        Mean durations of the times in which a link works and does not [s]; both 0: it always works.
    csma
        Packets take time on one shared channel: senders wait for it to be free, and what overlaps collides.
    hidden_nodes
        Senders hear only what is strong enough for their carrier sense; without it, all hear all.
    carrier_dbm
        Carrier sense threshold: at most 10 dB above the sensitivity (IEEE 802.15.4, clear channel assessment).
    capture_db
        A packet survives those that overlap it when it is stronger than their sum by this; own assumption, usual in simulators.
    """

    loss: float = 0.0
    delay_ms: float = 5.0
    jitter_ms: float = 3.0
    tx_power_dbm: float = 1.0
    loss_1m_db: float = 51.6
    exponent: float = 2.4
    shadowing_db: float = 0.0
    asymmetry_db: float = 0.0
    fading_db: float = 0.0
    wall_db: float = 0.0
    rssi_offset_db: float = 0.0
    rssi_step_db: float = 1.0
    sensitivity_dbm: float = -math.inf
    burst_good_s: float = 0.0
    burst_bad_s: float = 0.0
    csma: bool = False
    hidden_nodes: bool = False
    carrier_dbm: float = -87.0
    capture_db: float = 3.0

    def __post_init__(self) -> None:
        if not 0 <= self.loss < 1:
            raise ParameterError(name="loss", got=self.loss, wanted="a probability from 0 up to, not including, 1")
        for name in _NOT_NEGATIVE:
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ParameterError(name=name, got=getattr(self, name), wanted="a finite number, not negative")
        for name in ("tx_power_dbm", "carrier_dbm", "capture_db"):
            if not math.isfinite(getattr(self, name)):
                raise ParameterError(name=name, got=getattr(self, name), wanted="a finite number")
        if not (math.isfinite(self.exponent) and self.exponent > 0):
            raise ParameterError(name="exponent", got=self.exponent, wanted="a positive finite number: power falls with distance")
        if math.isnan(self.sensitivity_dbm) or self.sensitivity_dbm == math.inf:
            raise ParameterError(name="sensitivity_dbm", got=self.sensitivity_dbm, wanted="a power [dBm], or -inf for no limit")
        if (self.burst_good_s == 0) != (self.burst_bad_s == 0):
            raise ParameterError(
                name="burst_good_s, burst_bad_s",
                got=(self.burst_good_s, self.burst_bad_s),
                wanted="both positive, or both 0 where there are no bursts",
            )

    def median_dbm(self, distance_m: float) -> float:
        """Return the received power that half of all links exceed at a distance [m; nearer than 1 cm counts as 1 cm]."""
        return self.tx_power_dbm - (self.loss_1m_db + 10 * self.exponent * math.log10(max(distance_m, NEAREST_M)))


_NOT_NEGATIVE = (
    "delay_ms", "jitter_ms", "loss_1m_db", "shadowing_db", "asymmetry_db", "fading_db", "wall_db", "rssi_offset_db", "rssi_step_db",
    "burst_good_s", "burst_bad_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioPreset:
    """A full set of radio parameters.

    Parameters
    ----------
    sources
        Name of each field that differs from the default, to where its value is from.
    """

    name: str
    summary: str
    config: RadioConfig
    sources: Mapping[str, str]


_CC2530 = "a CC2530's, its datasheet"
RADIO_PRESETS: Mapping[str, RadioPreset] = MappingProxyType(
    {
        "ideal": RadioPreset(
            name="ideal",
            summary="every link as its median, nothing lost, the air empty",
            config=RadioConfig(),
            sources=MappingProxyType({}),
        ),
        "indoor": RadioPreset(
            name="indoor",
            summary="rooms and corridors at 2.4 GHz, insects among each other",
            config=RadioConfig(
                shadowing_db=2.4,
                asymmetry_db=1.0,
                fading_db=2.0,
                wall_db=5.0,
                rssi_offset_db=2.0,
                sensitivity_dbm=-97.0,
                burst_good_s=30.0,
                burst_bad_s=0.5,
                csma=True,
                hidden_nodes=True,
            ),
            sources=MappingProxyType(
                {
                    "shadowing_db": "residual of multi-wall log-distance fits in dwellings at 2.4 GHz, 2.3 to 2.5 dB (iieta 22896)",
                    "asymmetry_db": "assumption",
                    "fading_db": "assumption",
                    "wall_db": "assumption: a light partition",
                    "rssi_offset_db": "assumption: half of the accuracy that data sheets of such receivers commonly promise",
                    "sensitivity_dbm": _CC2530,
                    "burst_good_s": "assumption",
                    "burst_bad_s": "assumption",
                    "csma": "IEEE 802.15.4, unslotted, defaults",
                    "hidden_nodes": "carrier sense uses the same channel as reception",
                }
            ),
        ),
        "rubble": RadioPreset(
            name="rubble",
            summary="collapsed building at 2.4 GHz: an assumption throughout, no measurement stands behind it",
            config=RadioConfig(
                exponent=4.0,
                shadowing_db=6.0,
                asymmetry_db=2.0,
                fading_db=3.0,
                wall_db=20.0,
                rssi_offset_db=2.0,
                sensitivity_dbm=-97.0,
                burst_good_s=10.0,
                burst_bad_s=1.0,
                csma=True,
                hidden_nodes=True,
            ),
            sources=MappingProxyType(
                {
                    "exponent": "assumption: the default of Stage's log-distance model; the known measurements in rubble end at 1.8 GHz",
                    "shadowing_db": "assumption: as exponent",
                    "asymmetry_db": "assumption",
                    "fading_db": "assumption",
                    "wall_db": "assumption: the middle of 10 to 30 dB",
                    "rssi_offset_db": "assumption, as in indoor",
                    "sensitivity_dbm": _CC2530,
                    "burst_good_s": "assumption",
                    "burst_bad_s": "assumption",
                    "csma": "IEEE 802.15.4, unslotted, defaults",
                    "hidden_nodes": "carrier sense uses the same channel as reception",
                }
            ),
        ),
    }
)


def choose_radio(keys: RadioKeys, *, loss: float | None = None) -> RadioConfig:
    """Complete a configuration's radio from its preset; ``loss`` as in RadioConfig, where it is given.

    Raises
    ------
    ScenarioError
        No radio preset has the name given.
    ParameterError
        A value is out of range, or two contradict each other.
    """
    if keys.radio not in RADIO_PRESETS:
        raise ScenarioError(kind="radio preset", got=keys.radio, known=tuple(RADIO_PRESETS))
    config = RADIO_PRESETS[keys.radio].config
    given = {field.name: getattr(keys, field.name, None) for field in fields(RadioConfig)} | {"loss": loss}
    return replace(config, **{name: value for name, value in given.items() if value is not None})


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """What becomes of one payload."""

    delay_ns: int
    is_delivered: bool
    is_acknowledged: bool
    """The sender's radio learns of the delivery."""


@dataclass(slots=True, kw_only=True)
class Radio:
    """Draws the fate of payloads, and signal strengths."""

    seed: int
    config: RadioConfig = field(default_factory=RadioConfig)
    _n_sent: Counter[tuple[int, int]] = field(default_factory=Counter)

    def fly_up(self, node: int) -> Flight:
        """Draw what becomes of the next payload from ``node``."""
        return self._fly(node, _UPLINK_STREAM)

    def fly_down(self, node: int) -> Flight:
        """Draw what becomes of the next payload to ``node``."""
        return self._fly(node, _DOWNLINK_STREAM)

    def rssi_dbm(self, distance_m: float) -> RssiDbm:
        """Return the signal strength at a distance [m; nearer than 1 cm counts as 1 cm], as a radio says it: whole dBm."""
        return RssiDbm(max(-128, min(127, round(self.strength_dbm(distance_m)))))

    def strength_dbm(self, distance_m: float) -> float:
        """Return the same as a number that is not rounded, as an association compares it [dBm]."""
        return self.config.median_dbm(distance_m)

    def _fly(self, node: int, stream: int) -> Flight:
        index = self._n_sent[node, stream]
        self._n_sent[node, stream] = index + 1
        jitter_ms = self.config.jitter_ms * chance.exponential(seed=self.seed, biobot=node, stream=stream, index=index)
        is_delivered = self._survives(node, stream + 1, index)
        return Flight(
            delay_ns=round((self.config.delay_ms + jitter_ms) * 1e6),
            is_delivered=is_delivered,
            is_acknowledged=is_delivered and self._survives(node, stream + 2, index),
        )

    def _survives(self, node: int, stream: int, index: int) -> bool:
        return chance.uniform(seed=self.seed, biobot=node, stream=stream, index=index) >= self.config.loss


def lqi(rssi_dbm: RssiDbm) -> int:
    """Return the link quality, 0 to 255, that goes with a signal strength."""
    share = (rssi_dbm - _LQI_FLOOR_DBM) / (_LQI_TOP_DBM - _LQI_FLOOR_DBM)
    return round(255 * min(1.0, max(0.0, share)))
