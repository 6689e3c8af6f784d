"""What is on its way between backpacks and coordinators: every payload in flight, and when it comes down. No clock.

Each coordinator has a network of its own. A backpack belongs to one of them or to none, and gets a new short address whenever it
joins (WIRE_FORMAT.md §1). A coordinator that still sends to an address it once gave away gets no acknowledgement.
"""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioReceived, RadioSend, RadioStatus
from firmware_protocol.units import NodeId, ShortAddress
from simulator import chance
from simulator.radios.radio import Radio

_ADDRESS_STREAM = 222
_FIRST_ADDRESS = 1
_N_ADDRESSES = 0xFFF7  # 0x0000 is the coordinator; from 0xFFF8 on addresses are broadcast addresses (ZigBee specification, 3.6.1.10)


@dataclass(frozen=True, slots=True, kw_only=True)
class UplinkArrival:
    """A payload reaches a coordinator."""

    coordinator: int
    node: NodeId
    received: RadioReceived


@dataclass(frozen=True, slots=True, kw_only=True)
class DownlinkArrival:
    """A payload reaches a backpack."""

    node: NodeId
    payload: bytes
    is_broadcast: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SendingDone:
    """A coordinator's radio knows what became of a request."""

    coordinator: int
    handle: int
    status: RadioStatus


Arrival: TypeAlias = UplinkArrival | DownlinkArrival | SendingDone


class Air:
    """Carries payloads as its radio draws their fates. At first all nodes belong to nobody.

    Raises
    ------
    ValueError
        There are more nodes than addresses.
    """

    def __init__(self, nodes: Sequence[NodeId], *, radio: Radio, seed: int) -> None:
        if len(nodes) > _N_ADDRESSES:
            msg = f"{len(nodes)} nodes, but a ZigBee network has {_N_ADDRESSES} addresses for them"
            raise ValueError(msg)
        self._seed = seed
        self._radio = radio
        self._home: dict[NodeId, int | None] = dict.fromkeys(nodes)
        self._address: dict[NodeId, ShortAddress] = {}
        self._n_joined: dict[NodeId, int] = dict.fromkeys(nodes, 0)
        self._node_at: dict[tuple[int, ShortAddress], NodeId] = {}
        self._silent: set[NodeId] = set()
        self._arrivals: list[tuple[int, int, Arrival]] = []
        self._n_launched = 0

    def address_of(self, node: NodeId) -> ShortAddress:
        """Return the short address that a node got when it joined last; one that never joined has none (KeyError)."""
        return self._address[node]

    def home_of(self, node: NodeId) -> int | None:
        """Return the coordinator that a node belongs to, or None."""
        return self._home[node]

    def join(self, node: NodeId, coordinator: int) -> None:
        """Let a node belong to a coordinator, under a new address."""
        count = self._n_joined[node]
        self._n_joined[node] = count + 1
        address = self._draw_address(node, coordinator, count)
        self._home[node], self._address[node] = coordinator, address
        self._node_at[coordinator, address] = node

    def leave(self, node: NodeId) -> None:
        """Let a node belong to nobody: nothing reaches it until it joins again."""
        self._home[node] = None

    def silence(self, node: NodeId) -> None:
        """Let a node be off for good; its coordinator does not learn of it."""
        self._silent.add(node)

    def send_up(self, received: RadioReceived, *, node: NodeId, now_ns: int) -> None:
        """Send what ``node`` says to its coordinator; what a node without one says is lost."""
        home = self._home[node]
        if home is None:
            return
        flight = self._radio.fly_up(node)
        if flight.is_delivered:
            self._launch(UplinkArrival(coordinator=home, node=node, received=received), at_ns=now_ns + flight.delay_ns)

    def send_down(self, request: RadioSend, *, coordinator: int = 0, now_ns: int) -> None:
        """Send a request to the node addressed, or to all of a coordinator; it will learn what became of it."""
        is_broadcast = request.destination == BROADCAST_ADDRESS
        addressee = self._node_at.get((coordinator, request.destination))
        if addressee is None and not is_broadcast:
            self._finish(request, RadioStatus.UNKNOWN_ADDRESS, coordinator=coordinator, at_ns=now_ns)
            return
        status, done_ns = RadioStatus.SENT, now_ns
        for node in self._home if addressee is None else (addressee,):
            if is_broadcast and self._home[node] != coordinator:
                continue
            flight = self._radio.fly_down(node)
            at_ns = now_ns + flight.delay_ns
            done_ns = max(done_ns, at_ns)
            is_there = self._is_reachable(node, coordinator=coordinator, request=request)
            if is_there and flight.is_delivered:
                self._launch(DownlinkArrival(node=node, payload=request.payload, is_broadcast=is_broadcast), at_ns=at_ns)
            if not is_broadcast and not (is_there and flight.is_acknowledged):
                status = RadioStatus.NO_ACK
        self._finish(request, status, coordinator=coordinator, at_ns=done_ns)

    def take_arrived(self, now_ns: int) -> Iterator[Arrival]:
        """Yield what has come down by now, in order of time; at one instant in order of launch."""
        while self._arrivals and self._arrivals[0][0] <= now_ns:
            yield heapq.heappop(self._arrivals)[2]

    def next_arrival_ns(self) -> int | None:
        """Return when the next payload comes down, or None."""
        return self._arrivals[0][0] if self._arrivals else None

    def _is_reachable(self, node: NodeId, *, coordinator: int, request: RadioSend) -> bool:
        is_here = self._home[node] == coordinator and node not in self._silent
        return is_here and request.destination in {self._address[node], BROADCAST_ADDRESS}

    def _draw_address(self, node: NodeId, coordinator: int, count: int) -> ShortAddress:
        """Draw an address that no node of this coordinator has: a ZigBee address says nothing about a node's number."""
        place = chance.word(seed=self._seed, biobot=node, stream=_ADDRESS_STREAM, index=count) % _N_ADDRESSES
        while (owner := self._node_at.get((coordinator, ShortAddress(_FIRST_ADDRESS + place)))) is not None and (
            self._home[owner] == coordinator and self._address[owner] == _FIRST_ADDRESS + place
        ):
            place = (place + 1) % _N_ADDRESSES
        return ShortAddress(_FIRST_ADDRESS + place)

    def _finish(self, request: RadioSend, status: RadioStatus, *, coordinator: int, at_ns: int) -> None:
        self._launch(SendingDone(coordinator=coordinator, handle=request.handle, status=status), at_ns=at_ns)

    def _launch(self, arrival: Arrival, *, at_ns: int) -> None:
        self._n_launched += 1
        heapq.heappush(self._arrivals, (at_ns, self._n_launched, arrival))
