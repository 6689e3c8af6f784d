"""Who hears which packet, and what else became of it: too weak, faded, in a burst, lost by chance, or spoilt by other packets."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator import draws
from simulator.legs import Floats, Indices
from simulator.radios.bursts import BurstLoss
from simulator.radios.channel import Channel
from simulator.radios.medium import expand, find_overlaps

_LOSS_STREAM = 238
_ERROR_STREAM = 239


class Fate(IntEnum):
    """What became of a packet at one receiver. Where several causes would do, the first in this order is told."""

    HEARD = 0
    RANGE = 1
    """Too weak on average."""
    FADING = 2
    """Too weak this time, and strong enough on average."""
    BURST = 3
    CHANCE = 4
    """The constant probability of loss."""
    DEAF = 5
    """The receiver was sending."""
    COLLISION = 6
    """Packets that overlapped were too strong."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Packets:
    """Packets that went on the air, in order of start; all arrays have shape (k,).

    Parameters
    ----------
    sender
        Row in the channel's list of ids.
    number
        The sender's number of the packet, below 2^32.
    start_ns, end_ns
        On the air from, until [ns].
    """

    sender: Indices
    number: Indices
    start_ns: Indices
    end_ns: Indices


@dataclass(slots=True, kw_only=True)
class Receiver:
    """Decides on receptions; remembers only the state of the links' bursts."""

    seed: int
    channel: Channel
    n_octets: int
    bursts: BurstLoss | None = None

    def decide(
        self, packets: Packets, *, subject: Indices, place: Floats, packet: Indices, receiver: Indices
    ) -> tuple[NDArray[np.int8], Floats, NDArray[np.bool_]]:
        """Decide what becomes of some packets at some receivers.

        Parameters
        ----------
        packets
            All that may overlap those in question.
        subject
            Rows of the packets in question, shape (k,).
        place
            Where all radios were at the start of each of them, shape (k, n, 2) [m].
        packet, receiver
            Each reception: place in ``subject``, ascending, and row of the receiver, shape (m,).

        Returns
        -------
        fate
            A ``Fate`` each, shape (m,).
        rssi_dbm
            What the receiver says of the strength, shape (m,); of meaning where it is heard.
        is_spoiled
            Whether other packets, or the receiver's own, overlapped it too strongly, whatever else befell it, shape (m,).
        """
        channel, config = self.channel, self.channel.config
        row = subject[packet]
        sender, number = packets.sender[row], packets.number[row]
        mean_dbm = channel.mean_dbm(sender, receiver, from_place=place[packet, sender], to_place=place[packet, receiver])
        power_dbm = mean_dbm + channel.fading_db(sender, receiver, number)
        fate = np.zeros(packet.size, dtype=np.int8)
        if config.csma:
            self._mark_interference(fate, packets, subject=subject, place=place, packet=packet, receiver=receiver, power_dbm=power_dbm)
        is_spoiled = fate != Fate.HEARD
        if config.loss:
            fate[self._uniform(_LOSS_STREAM, sender, receiver, number) < config.loss] = Fate.CHANCE
        if self.bursts is not None:
            ids = channel.ids
            struck = self.bursts.strikes(
                sender=ids[sender], receiver=ids[receiver], number=number.astype(np.uint64), t_ns=packets.start_ns[row]
            )
            fate[struck] = Fate.BURST
        if np.isfinite(config.sensitivity_dbm):
            u = self._uniform(_ERROR_STREAM, sender, receiver, number)
            fate[u < channel.packet_error_rate(power_dbm, n_octets=self.n_octets)] = Fate.FADING
            fate[(fate == Fate.FADING) & (u < channel.packet_error_rate(mean_dbm, n_octets=self.n_octets))] = Fate.RANGE
        return fate, channel.rssi_dbm(power_dbm, receiver), is_spoiled

    def _mark_interference(
        self, fate: NDArray[np.int8], packets: Packets, *, subject: Indices, place: Floats, packet: Indices, receiver: Indices,
        power_dbm: Floats,
    ) -> None:  # fmt: skip
        """Mark where overlapping packets, or the receiver's own, spoil a reception."""
        owner, other = find_overlaps(packets.start_ns, packets.end_ns, subject=subject)
        low = np.searchsorted(owner, packet, side="left")
        reception, at = expand(low, np.searchsorted(owner, packet, side="right"))
        if not reception.size:
            return
        disturber = packets.sender[other[at]]
        deaf = disturber == receiver[reception]
        fate[reception[deaf]] = Fate.DEAF
        reception, at, disturber = reception[~deaf], at[~deaf], disturber[~deaf]
        listener, around = receiver[reception], packet[reception]
        channel = self.channel
        strength_dbm = channel.mean_dbm(disturber, listener, from_place=place[around, disturber], to_place=place[around, listener])
        strength_dbm += channel.fading_db(disturber, listener, packets.number[other[at]])
        # Sums are over ratios to the wanted power, so that no unit overflows.
        ratio = np.bincount(reception, weights=10.0 ** ((strength_dbm - power_dbm[reception]) / 10.0), minlength=fate.size)
        fate[(fate == Fate.HEARD) & (ratio > 10.0 ** (-channel.config.capture_db / 10.0))] = Fate.COLLISION

    def _uniform(self, stream: int, sender: Indices, receiver: Indices, number: Indices) -> Floats:
        ids = self.channel.ids
        index = (number.astype(np.uint64) << np.uint64(32)) | ids[receiver]
        return draws.uniform(draws.words(seed=self.seed, biobot=ids[sender], stream=stream, index=index))
