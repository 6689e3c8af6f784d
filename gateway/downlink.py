"""Messages to biobots: finds the radio and the short address, and sends."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping

from firmware_protocol.message_codec import encode_downlink
from firmware_protocol.messages import Downlink
from firmware_protocol.units import NodeId, ShortAddress
from gateway.coordinator import Coordinator
from gateway.errors import RadioUnavailableError
from gateway.nodes import NodeBook
from gateway.radio import RadioOutcome

_SEQUENCE_MODULUS = 1 << 16


class DownlinkSender:
    """Sends messages to biobots over whichever radio heard them last."""

    def __init__(self, *, coordinators: Mapping[str, Coordinator], nodes: NodeBook) -> None:
        self._coordinators = coordinators
        self._nodes = nodes
        self._sequence = 0

    def send(self, node: NodeId, message: Downlink, *, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":
        """Send a message; the future tells its fate and never fails.

        Raises
        ------
        RadioUnavailableError
            The biobot was never heard of, another has its address now, or its radio takes nothing now; nothing was sent.
        """
        coordinator, address = self._way_to(node)
        future = coordinator.send(destination=address, payload=encode_downlink(self._sequence, message), is_urgent=is_urgent)
        self._sequence = (self._sequence + 1) % _SEQUENCE_MODULUS
        return future

    def send_timed(self, node: NodeId, make: Callable[[int], Downlink]) -> "asyncio.Future[RadioOutcome]":
        """Send a message that is made of the instant [ns] at which the radio's port takes it; see ``Coordinator.send_timed``.

        Raises
        ------
        RadioUnavailableError
            As of ``send``, or another timed message waits for its radio.
        """
        coordinator, address = self._way_to(node)

        def make_payload(now_ns: int) -> bytes:
            sequence, self._sequence = self._sequence, (self._sequence + 1) % _SEQUENCE_MODULUS
            return encode_downlink(sequence, make(now_ns))

        return coordinator.send_timed(destination=address, make=make_payload)

    def send_elsewhere(self, node: NodeId, message: Downlink) -> "list[asyncio.Future[RadioOutcome]]":
        """Send an urgent message over each radio that heard a biobot within the last minutes, but for the one that heard it last."""
        futures: list[asyncio.Future[RadioOutcome]] = []
        known = self._nodes.find(node)
        for place in self._nodes.places_of(node, now_ns=time.monotonic_ns()):
            coordinator = self._coordinators.get(place.radio)
            if coordinator is None or known is None or (place.radio, place.address) == (known.radio, known.address):
                continue
            with contextlib.suppress(RadioUnavailableError):
                payload = encode_downlink(self._sequence, message)
                futures.append(coordinator.send(destination=place.address, payload=payload, is_urgent=True))
                self._sequence = (self._sequence + 1) % _SEQUENCE_MODULUS
        return futures

    def ways_to(self, node: NodeId) -> list[str]:
        """Return the radios that may reach a biobot: the one that heard it last, and each other that heard it within the last minutes."""
        known = self._nodes.find(node)
        last = [] if known is None else [known.radio]
        return list(dict.fromkeys([*last, *(place.radio for place in self._nodes.places_of(node, now_ns=time.monotonic_ns()))]))

    def send_over(self, radio: str, node: NodeId, message: Downlink) -> "asyncio.Future[RadioOutcome]":
        """Send an urgent message over one of the radios that may reach a biobot.

        Raises
        ------
        RadioUnavailableError
            As of ``send``.
        """
        known = self._nodes.find(node)
        place = next((one for one in self._nodes.places_of(node, now_ns=time.monotonic_ns()) if one.radio == radio), None)
        coordinator = self._coordinators.get(radio)
        if place is None or coordinator is None or (known is not None and known.radio == radio and known.address is not None):
            return self.send(node, message, is_urgent=True)
        future = coordinator.send(destination=place.address, payload=encode_downlink(self._sequence, message), is_urgent=True)
        self._sequence = (self._sequence + 1) % _SEQUENCE_MODULUS
        return future

    def send_to_all(self, message: Downlink) -> "dict[str, asyncio.Future[RadioOutcome]]":
        """Send an urgent message by broadcast, one frame on each radio that is up; return what tells its fate, by radio."""
        payload = encode_downlink(self._sequence, message)
        self._sequence = (self._sequence + 1) % _SEQUENCE_MODULUS
        futures: dict[str, asyncio.Future[RadioOutcome]] = {}
        for radio, coordinator in self._coordinators.items():
            with contextlib.suppress(RadioUnavailableError):
                futures[radio] = coordinator.send_to_all(payload)
        return futures

    def withdraw(self, sending: "asyncio.Future[RadioOutcome]") -> bool:
        """Take back what ``send`` sent, where it was not written; True: it never will be, and its future says so (``Fate.NOT_SENT``)."""
        return any(coordinator.withdraw(sending) for coordinator in self._coordinators.values())

    def radio_of(self, node: NodeId) -> str | None:
        """Return the radio over which a biobot is reached, None where it was never heard."""
        known = self._nodes.find(node)
        return None if known is None else known.radio

    def is_radio_up(self, radio: str) -> bool:
        """Return whether a radio takes payloads now."""
        coordinator = self._coordinators.get(radio)
        return coordinator is not None and coordinator.is_up

    def can_reach(self, node: NodeId) -> bool:
        """Return whether the radio of a biobot takes payloads now."""
        radio = self.radio_of(node)
        return radio is not None and self.is_radio_up(radio)

    def n_pending(self, node: NodeId) -> int:
        """Return how many payloads wait for their fate at the radio of a biobot."""
        known = self._nodes.find(node)
        coordinator = None if known is None else self._coordinators.get(known.radio)
        return 0 if coordinator is None else coordinator.n_pending

    def _way_to(self, node: NodeId) -> tuple[Coordinator, ShortAddress]:
        known = self._nodes.find(node)
        coordinator = None if known is None else self._coordinators.get(known.radio)
        if known is None or coordinator is None:
            reason = (
                "it was never heard of" if known is None else f"it was last heard by {known.radio}, which is no port of this gateway now"
            )
            raise RadioUnavailableError(radio=f"of biobot {node}", reason=reason)
        if known.address is None:
            raise RadioUnavailableError(
                radio=f"of biobot {node}", reason="its short address is another biobot's now; it is reached again when it is next heard"
            )
        return coordinator, known.address
