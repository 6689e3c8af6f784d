"""The channel between two radios: log-distance path loss, shadowing, asymmetry, fading, walls; how weak is too weak; what RSSI is said.

All is a pure function of (seed, identities, number of the packet, places). The world's unit of length counts as a metre.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator import draws
from simulator.arenas.arena import Arena
from simulator.draws import Floats, Words
from simulator.errors import ParameterError
from simulator.legs import Indices
from simulator.radios.radio import NEAREST_M, RadioConfig

_SHADOW_STREAM = 230
_ASYMMETRY_STREAM = 232
_OFFSET_STREAM = 234
_FADING_STREAM = 236

_MAX_ID = 2**32 - 1
_DEVIATIONS = 4.0
"""Beyond so many standard deviations above the median, a link is not looked for: 3 in 100,000 draws are."""

# Lines times walls looked at in one block: bounds memory.
_BLOCK = 1_000_000

# IEEE 802.15.4-2006, E.4.1.8 (2.4 GHz O-QPSK): BER = 8/15 * 1/16 * sum over k of (-1)^k C(16, k) exp(20 SINR (1/k - 1)).
_BER_TERMS = tuple(((-1) ** k * math.comb(16, k) * 8 / 15 / 16, 20.0 * (1.0 / k - 1.0)) for k in range(2, 17))
_SENSITIVITY_OCTETS = 20
_SENSITIVITY_ERROR = 0.01


class Channel:
    """See the module.

    Parameters
    ----------
    ids
        Identities of the radios, each below 2^32; rows below are places in this sequence.
    arena
        Whose walls attenuate; None where none do.
    """

    __slots__ = ("_config", "_ids", "_noise_dbm", "_offset_db", "_seed", "_wall_end", "_wall_start")

    def __init__(self, config: RadioConfig, *, seed: int, ids: Sequence[int], arena: Arena | None = None) -> None:
        if not all(0 <= one <= _MAX_ID for one in ids):
            raise ParameterError(name="ids", got=[one for one in ids if not 0 <= one <= _MAX_ID][:8], wanted=f"0 to {_MAX_ID}")
        self._config = config
        self._seed = seed
        self._ids = np.array(ids, dtype=np.uint64)
        self._offset_db = config.rssi_offset_db * self._normal(_OFFSET_STREAM, self._ids, np.zeros_like(self._ids))
        self._noise_dbm = config.sensitivity_dbm - 10 * math.log10(_ratio_at_sensitivity())
        walls = arena if config.wall_db else None
        self._wall_start = np.empty((0, 2)) if walls is None else walls.wall_start
        self._wall_end = np.empty((0, 2)) if walls is None else walls.wall_end

    @property
    def config(self) -> RadioConfig:
        """The radio's parameters."""
        return self._config

    @property
    def ids(self) -> Words:
        """Identities, shape (n,)."""
        return self._ids

    def median_dbm(self, distance: Floats) -> Floats:
        """Return the received power that half of all links exceed at a distance [m]: path loss alone [dBm]."""
        config = self._config
        return config.tx_power_dbm - (config.loss_1m_db + 10 * config.exponent * np.log10(np.maximum(distance, NEAREST_M)))

    def reach(self, floor_dbm: float) -> float:
        """Return the distance [m] beyond which no link comes up to ``floor_dbm``, but for one draw in some 30,000."""
        config = self._config
        if floor_dbm == -math.inf:
            return math.inf
        spread_db = math.sqrt(config.shadowing_db**2 + config.asymmetry_db**2 / 4 + config.fading_db**2 + config.rssi_offset_db**2)
        margin_db = _DEVIATIONS * spread_db + config.rssi_step_db / 2
        exponent = (config.tx_power_dbm - config.loss_1m_db - floor_dbm + margin_db) / (10 * config.exponent)
        return max(NEAREST_M, math.pow(10.0, min(exponent, 300.0)))

    def pair_gain_db(self, sender: Indices, receiver: Indices) -> Floats:
        """Return what a pair's shadowing and the direction's share of its asymmetry add to the median, shape (k,) [dB].

        It belongs to the pair for the whole run. Of the asymmetry one direction has plus half, the other minus half.
        """
        config = self._config
        gain = np.zeros(sender.size)
        if config.shadowing_db or config.asymmetry_db:
            one, other = self._ids[sender], self._ids[receiver]
            low, high = np.minimum(one, other), np.maximum(one, other)
            if config.shadowing_db:
                gain += config.shadowing_db * self._normal(_SHADOW_STREAM, low, high)
            if config.asymmetry_db:
                gain += np.where(one < other, 0.5, -0.5) * config.asymmetry_db * self._normal(_ASYMMETRY_STREAM, low, high)
        return gain

    def mean_dbm(self, sender: Indices, receiver: Indices, *, from_place: Floats, to_place: Floats) -> Floats:
        """Return the received power without fading, shape (k,) [dBm].

        Parameters
        ----------
        sender, receiver
            Rows, shape (k,).
        from_place, to_place
            Where they are, shape (k, 2) [m].
        """
        offset = to_place - from_place
        power = self.median_dbm(np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2)) + self.pair_gain_db(sender, receiver)
        if self._config.wall_db:
            power -= self._config.wall_db * self.walls_between(from_place, to_place)
        return power

    def fading_db(self, sender: Indices, receiver: Indices, number: Indices) -> Floats:
        """Return what fading adds to the power of each sender's packet ``number`` (below 2^32) at the receiver, shape (k,) [dB]."""
        if not self._config.fading_db:
            return np.zeros(sender.size)
        index = (number.astype(np.uint64) << np.uint64(32)) | self._ids[receiver]
        return self._config.fading_db * self._normal(_FADING_STREAM, self._ids[sender], index)

    def rssi_dbm(self, power_dbm: Floats, receiver: Indices) -> Floats:
        """Return what each receiver says of a power, shape (k,): wrong by its own offset, and in steps [dBm]."""
        said = power_dbm + self._offset_db[receiver]
        step = self._config.rssi_step_db
        return np.clip(step * np.rint(said / step), -128, 127) if step else said

    def packet_error_rate(self, power_dbm: Floats, *, n_octets: int) -> Floats:
        """Return the probability that noise alone spoils a packet, shape (k,).

        Notes
        -----
        The bit error rate of the 2.4 GHz modulation over noise, where the noise is such that the sensitivity is what the standard
        calls so: 1 % of 20-octet packets lost.
        """
        if self._noise_dbm == -math.inf:
            return np.zeros(power_dbm.shape)
        ratio = 10.0 ** (np.clip(power_dbm - self._noise_dbm, -100.0, 20.0) / 10.0)
        rate: Floats = -np.expm1(8 * n_octets * np.log1p(-_bit_error_rate(ratio)))
        return rate

    def walls_between(self, from_place: Floats, to_place: Floats) -> NDArray[np.int64]:
        """Count the walls and obstacles that the straight lines pass through, shape (k,).

        What is passed through is left again on the other side, so it is half the number of outlines crossed. A line through a corner
        crosses one of the two edges that meet there, or both, or none.
        """
        counts = np.zeros(len(from_place), dtype=np.int64)
        if not self._wall_start.size:
            return counts
        block = max(1, _BLOCK // len(self._wall_start))
        for k in range(0, counts.size, block):
            a, b = from_place[k : k + block, None, :], to_place[k : k + block, None, :]
            start, end = self._wall_start, self._wall_end
            parts = (_side(a, b, start) >= 0) != (_side(a, b, end) >= 0)
            walls = (_side(start, end, a) >= 0) != (_side(start, end, b) >= 0)
            counts[k : k + block] = (parts & walls).sum(axis=1)
        return counts // 2

    def _normal(self, stream: int, biobot: Words, index: Words) -> Floats:
        """Draw from the normal distribution of variance 1, shape (k,): Box and Muller's transformation."""
        radius = np.sqrt(2.0 * draws.exponential(draws.words(seed=self._seed, biobot=biobot, stream=stream, index=index)))
        return radius * draws.circle(draws.uniform(draws.words(seed=self._seed, biobot=biobot, stream=stream + 1, index=index)))[0]


def _side(a: Floats, b: Floats, point: Floats) -> Floats:
    """Return the cross product of ``b - a`` and ``point - a``: positive on the left of the way from a to b."""
    cross: Floats = (b[..., 0] - a[..., 0]) * (point[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (point[..., 0] - a[..., 0])
    return cross


def _bit_error_rate(ratio: Floats) -> Floats:
    """Return the bit error rate at a ratio of signal to noise (a plain ratio), shape (k,)."""
    rate = np.zeros(ratio.shape)
    for factor, slope in _BER_TERMS:
        rate += factor * np.exp(slope * ratio)
    return np.clip(rate, 0.0, 0.5)


def _ratio_at_sensitivity() -> float:
    """Find the signal to noise ratio at which 1 % of 20-octet packets are lost, by bisection."""
    wanted = -math.expm1(math.log1p(-_SENSITIVITY_ERROR) / (8 * _SENSITIVITY_OCTETS))
    low, high = 0.01, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if float(_bit_error_rate(np.array([middle]))[0]) > wanted else (low, middle)
    return high
