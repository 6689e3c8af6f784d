"""Messages to biobots: finds the radio and the short address, and sends."""

import asyncio
from collections.abc import Mapping

from firmware_protocol.message_codec import encode_downlink
from firmware_protocol.messages import Downlink
from firmware_protocol.units import NodeId
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
            The biobot was never heard of, or its radio takes nothing now; nothing was sent.
        """
        known = self._nodes.find(node)
        coordinator = None if known is None else self._coordinators.get(known.radio)
        if known is None or coordinator is None:
            reason = (
                "it was never heard of" if known is None else f"it was last heard by {known.radio}, which is no port of this gateway now"
            )
            raise RadioUnavailableError(radio=f"of biobot {node}", reason=reason)
        payload = encode_downlink(self._sequence, message)
        future = coordinator.send(destination=known.address, payload=payload, is_urgent=is_urgent)
        self._sequence = (self._sequence + 1) % _SEQUENCE_MODULUS
        return future

    def n_pending(self, node: NodeId) -> int:
        """Return how many payloads wait for their fate at the radio of a biobot."""
        known = self._nodes.find(node)
        coordinator = None if known is None else self._coordinators.get(known.radio)
        return 0 if coordinator is None else coordinator.n_pending
