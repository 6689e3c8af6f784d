"""Carrier sense over the real channel: whether a radio that is about to send notices another's packet."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from simulator.radios.channel import Channel


class CarrierSense:
    """Compares the power without fading with the carrier sense threshold.

    Parameters
    ----------
    ids
        Identities of the channel's rows.
    place
        Called with a row and an instant [ns]: where that radio is then [m].

    Notes
    -----
    What shadowing and asymmetry give to all pairs of one listener is worked out when it first listens, and kept: 8 bytes a pair.
    """

    __slots__ = ("_channel", "_gain_db", "_place", "_row")

    def __init__(self, channel: Channel, *, ids: Sequence[int], place: Callable[[int, int], tuple[float, float]]) -> None:
        self._channel = channel
        self._place = place
        self._row = {one: row for row, one in enumerate(ids)}
        self._gain_db: dict[int, list[float]] = {}

    def __call__(self, listener: int, talker: int, at_ns: int) -> bool:
        """Tell whether ``listener`` notices a packet of ``talker``, by their identities."""
        to, by = self._row[listener], self._row[talker]
        gain_db = self._gain_db.get(to)
        if gain_db is None:
            everybody = np.arange(len(self._row))
            gain_db = self._gain_db[to] = self._channel.pair_gain_db(everybody, np.full_like(everybody, to)).tolist()
        config = self._channel.config
        here, there = self._place(to, at_ns), self._place(by, at_ns)
        power_dbm = config.median_dbm(math.dist(here, there)) + gain_db[by]
        if config.wall_db and power_dbm >= config.carrier_dbm:
            power_dbm -= config.wall_db * int(self._channel.walls_between(np.array([there]), np.array([here]))[0])
        return power_dbm >= config.carrier_dbm
