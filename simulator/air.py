"""What is on its way between backpacks and coordinator: every payload in flight, and when it comes down. No clock."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioReceived, RadioSend, RadioStatus
from firmware_protocol.units import NodeId, ShortAddress
from simulator import chance
from simulator.radio import Radio

_ADDRESS_STREAM = 222
_FIRST_ADDRESS = 1
_N_ADDRESSES = 0xFFF7  # 0x0000 is the coordinator; from 0xFFF8 on addresses are broadcast addresses (ZigBee specification, 3.6.1.10)


@dataclass(frozen=True, slots=True, kw_only=True)
class UplinkArrival:
    """A payload reaches the coordinator."""

    received: RadioReceived


@dataclass(frozen=True, slots=True, kw_only=True)
class DownlinkArrival:
    """A payload reaches a backpack."""

    node: NodeId
    payload: bytes
    is_broadcast: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SendingDone:
    """The coordinator's radio knows what became of a request."""

    handle: int
    status: RadioStatus


Arrival: TypeAlias = UplinkArrival | DownlinkArrival | SendingDone


class Air:
    """Carries payloads as its radio draws their fates; addresses are short addresses of the nodes given."""

    def __init__(self, nodes: Sequence[NodeId], *, radio: Radio, seed: int) -> None:
        self._nodes = tuple(nodes)
        self._radio = radio
        self._address = assign_addresses(nodes, seed=seed)
        self._node_at = {address: node for node, address in self._address.items()}
        self._arrivals: list[tuple[int, int, Arrival]] = []
        self._n_launched = 0

    def address_of(self, node: NodeId) -> ShortAddress:
        """Return a node's short address."""
        return self._address[node]

    def send_up(self, received: RadioReceived, *, node: NodeId, now_ns: int) -> None:
        """Send what ``node`` says to the coordinator."""
        flight = self._radio.fly_up(node)
        if flight.is_delivered:
            self._launch(UplinkArrival(received=received), at_ns=now_ns + flight.delay_ns)

    def send_down(self, request: RadioSend, *, now_ns: int) -> None:
        """Send a request to the node addressed, or to all; the coordinator will learn what became of it."""
        is_broadcast = request.destination == BROADCAST_ADDRESS
        addressee = self._node_at.get(request.destination)
        if addressee is None and not is_broadcast:
            self._launch(SendingDone(handle=request.handle, status=RadioStatus.UNKNOWN_ADDRESS), at_ns=now_ns)
            return
        status, done_ns = RadioStatus.SENT, now_ns
        for node in self._nodes if addressee is None else (addressee,):
            flight = self._radio.fly_down(node)
            at_ns = now_ns + flight.delay_ns
            done_ns = max(done_ns, at_ns)
            if flight.is_delivered:
                self._launch(DownlinkArrival(node=node, payload=request.payload, is_broadcast=is_broadcast), at_ns=at_ns)
            if not flight.is_acknowledged and not is_broadcast:
                status = RadioStatus.NO_ACK
        self._launch(SendingDone(handle=request.handle, status=status), at_ns=done_ns)

    def take_arrived(self, now_ns: int) -> Iterator[Arrival]:
        """Yield what has come down by now, in order of time; at one instant in order of launch."""
        while self._arrivals and self._arrivals[0][0] <= now_ns:
            yield heapq.heappop(self._arrivals)[2]

    def next_arrival_ns(self) -> int | None:
        """Return when the next payload comes down, or None."""
        return self._arrivals[0][0] if self._arrivals else None

    def _launch(self, arrival: Arrival, *, at_ns: int) -> None:
        self._n_launched += 1
        heapq.heappush(self._arrivals, (at_ns, self._n_launched, arrival))


def assign_addresses(nodes: Sequence[NodeId], *, seed: int) -> dict[NodeId, ShortAddress]:
    """Give every node a short address of its own, as at random: a ZigBee address says nothing about a node's number.

    Raises
    ------
    ValueError
        There are more nodes than addresses.
    """
    if len(nodes) > _N_ADDRESSES:
        msg = f"{len(nodes)} nodes, but a ZigBee network has {_N_ADDRESSES} addresses for them"
        raise ValueError(msg)
    assigned: dict[NodeId, ShortAddress] = {}
    used: set[int] = set()
    for node in nodes:
        place = chance.word(seed=seed, biobot=node, stream=_ADDRESS_STREAM, index=0) % _N_ADDRESSES
        while place in used:
            place = (place + 1) % _N_ADDRESSES
        used.add(place)
        assigned[node] = ShortAddress(_FIRST_ADDRESS + place)
    return assigned
