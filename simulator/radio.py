"""The air between backpacks and coordinator: everything is in range; payloads are late, and some are lost.

Loss is independent for each payload. Draws are keyed by (seed, node, number of the payload), so one biobot's luck does not
depend on another's traffic.
"""

import math
from collections import Counter
from dataclasses import dataclass, field

from firmware_protocol.units import RssiDbm
from simulator import chance
from simulator.errors import ParameterError

_UPLINK_STREAM = 210
_DOWNLINK_STREAM = 213
_NEAREST_M = 0.01

# LQI as most radios make it: the signal's place between sensitivity and saturation, on 0 to 255. -97 dBm and 10 dBm are a
# CC2530's (its datasheet, "RF receive").
_LQI_FLOOR_DBM = -97
_LQI_TOP_DBM = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioConfig:
    """The air's parameters.

    Parameters
    ----------
    loss
        Probability that a payload is lost, and that the acknowledgement of a delivered one is: 0 up to, not including, 1.
    delay_ms, jitter_ms
        A payload takes the first, plus an exponential draw with the second as its mean [ms].
    tx_power_dbm, loss_1m_db, exponent
        Log-distance path loss. 1 dBm is a CC2530's; 51.6 dB and 2.4 are those of Castalia's radio example.
    """

    loss: float = 0.0
    delay_ms: float = 5.0
    jitter_ms: float = 3.0
    tx_power_dbm: float = 1.0
    loss_1m_db: float = 51.6
    exponent: float = 2.4

    def __post_init__(self) -> None:
        if not 0 <= self.loss < 1:
            raise ParameterError(name="loss", got=self.loss, wanted="a probability from 0 up to, not including, 1")
        for name in ("delay_ms", "jitter_ms"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ParameterError(name=name, got=getattr(self, name), wanted="a finite number, not negative")


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
        loss_db = self.config.loss_1m_db + 10 * self.config.exponent * math.log10(max(distance_m, _NEAREST_M))
        return self.config.tx_power_dbm - loss_db

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
