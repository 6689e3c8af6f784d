"""At which radio and under which short address each biobot is reached. One address of one radio is one biobot's. Pure.

A downlink names nobody (WIRE_FORMAT.md §6.1): whoever holds the short address obeys. So an address that passes from one biobot to another
is lost to the first at once, and that one is reached again when it is next heard.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from msgspec import Struct

from firmware_protocol.units import NS_PER_S, NodeId, ShortAddress

HANDOVER_NS = 300 * NS_PER_S
"""A radio that heard a biobot no longer ago than this may still be the one that reaches it."""


class Place(Struct, frozen=True, kw_only=True, gc=False):
    """Where a biobot was heard, and when (monotonic)."""

    radio: str
    address: ShortAddress
    heard_ns: int


@dataclass(slots=True)
class Whereabouts:
    """The places of all biobots: of each at most one at each radio, and of each place one biobot."""

    _places: dict[NodeId, dict[str, Place]] = field(default_factory=dict)
    _owners: dict[tuple[str, ShortAddress], NodeId] = field(default_factory=dict)

    def move(self, node: NodeId, place: Place) -> NodeId | None:
        """Let a biobot be at a place; return whom the place belonged to, where that is another."""
        before = self._owners.get((place.radio, place.address))
        if before is not None and before != node:
            del self._places[before][place.radio]
        self._settle(node, place)
        return None if before == node else before

    def stay(self, node: NodeId, *, radio: str, heard_ns: int) -> None:
        """Let a biobot be heard again where it is at a radio, which must have heard it there before."""
        mine = self._places[node]
        mine[radio] = Place(radio=radio, address=mine[radio].address, heard_ns=heard_ns)

    def suspect(self, node: NodeId, place: Place) -> None:
        """Note that a biobot may be at a place: an old message came from there. It takes nobody's address, nor a better one of its own."""
        known = self._places.get(node, {}).get(place.radio)
        owner = self._owners.get((place.radio, place.address), node)
        if owner == node and (known is None or known.address == place.address):
            self._settle(node, place)

    def restore(self, places: Sequence[tuple[NodeId, Place]]) -> set[NodeId]:
        """Know again places of an earlier process; return whose they are. One that several claim is believed of none."""
        claims = Counter((place.radio, place.address) for _, place in places)
        believed = [(node, place) for node, place in places if claims[place.radio, place.address] == 1]
        for node, place in believed:
            self._settle(node, place)
        return {node for node, _ in believed}

    def recent(self, node: NodeId, *, now_ns: int) -> list[Place]:
        """Return where a biobot was within the last minutes, the latest first."""
        places = sorted(self._places.get(node, {}).values(), key=lambda place: place.heard_ns, reverse=True)
        return [place for place in places if place.heard_ns >= now_ns - HANDOVER_NS]

    def _settle(self, node: NodeId, place: Place) -> None:
        mine = self._places.setdefault(node, {})
        if place.radio in mine:
            del self._owners[place.radio, mine[place.radio].address]
        mine[place.radio] = place
        self._owners[place.radio, place.address] = node
