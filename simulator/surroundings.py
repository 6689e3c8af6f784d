"""Where the biobots are as their radios notice it: places, signal strengths between them, and neighbours. No clock."""

import math
from collections.abc import Container, Sequence

from firmware_protocol.messages import Neighbour
from firmware_protocol.units import NodeId, RssiDbm
from simulator.errors import ParameterError
from simulator.habitat import Habitat
from simulator.legs import Floats
from simulator.odometer import Odometer
from simulator.radios.radio import Radio


class Surroundings:
    """The world's present places, looked up once for each instant of the world.

    Parameters
    ----------
    world
        Its unit of length counts as a metre for signal strengths.
    """

    def __init__(self, world: Habitat, *, nodes: Sequence[NodeId], radio: Radio) -> None:
        self._world = world
        self._nodes = tuple(nodes)
        self._row = {node: row for row, node in enumerate(self._nodes)}
        self._radio = radio
        self._places_at_s = -1.0
        self._places: Floats = world.positions()

    @property
    def is_known(self) -> bool:
        """It is known where the biobots are."""
        return self._world.arena is not None

    def make_odometer(self, *, mm_per_unit: float, seed: int) -> Odometer:
        """Make what measures how far everybody is carried from now on; ``mm_per_unit`` is the world's unit of length [mm].

        Raises
        ------
        ParameterError
            It is not known where the biobots are.
        """
        if not self.is_known:
            raise ParameterError(name="imu", got=True, wanted="false, where it is not known where the biobots are")
        return Odometer(self._nodes, places=self.places(), mm_per_unit=mm_per_unit, seed=seed)

    def place(self, node: NodeId) -> tuple[float, float]:
        """Return where a biobot is [length]; nan where that is unknown."""
        places = self.places()
        row = self._row[node]
        return float(places[row, 0]), float(places[row, 1])

    def contact_rssi_dbm(self, node: NodeId, peer: NodeId) -> RssiDbm:
        """Return the signal strength between two biobots that have just met.

        The world tells of the meeting up to a step later, when they may have parted again: they count as no further apart than the
        detection radius.
        """
        (x1, y1), (x2, y2) = self.place(node), self.place(peer)
        # Where places are unknown this is the detection radius, for no comparison with nan is true.
        return self._radio.rssi_dbm(min(self._world.ranges.detection, math.hypot(x1 - x2, y1 - y2)))

    def neighbours(self, node: NodeId, *, silent: Container[NodeId]) -> list[Neighbour]:
        """Return whom a biobot hears within the communication radius, but for the silent; where no places are known, whom it meets."""
        if not self.is_known:
            return self._company(node)
        places = self.places()
        square_distances = ((places - places[self._row[node]]) ** 2).sum(axis=1).tolist()
        limit = self._world.ranges.communication**2
        return [
            Neighbour(node=other, rssi_dbm=self._radio.rssi_dbm(math.sqrt(square)))
            for other, square in zip(self._nodes, square_distances, strict=True)
            if square <= limit and other != node and other not in silent
        ]

    def _company(self, node: NodeId) -> list[Neighbour]:
        rssi_dbm = self._radio.rssi_dbm(self._world.ranges.detection)
        pairs = [(one.id1, one.id2) for one in self._world.open_encounters() if node in {one.id1, one.id2}]
        return [Neighbour(node=NodeId(id2 if id1 == node else id1), rssi_dbm=rssi_dbm) for id1, id2 in pairs]

    def places(self) -> Floats:
        """Return where all biobots are now: shape (n, 2) [length], in the order of ``nodes``; nan where that is unknown."""
        if self._places_at_s != self._world.now_s:
            self._places_at_s = self._world.now_s
            self._places = self._world.positions()
        return self._places
