"""Configures a coordinator on CAN: a question and its answer through ISO-TP, on identifiers of their own (WIRE_FORMAT.md §10.4).

can-isotp knows the protocol and its time limits; the frames go through the port that is open anyway.
"""

from collections import deque

import isotp

from firmware_protocol.envelope import ConfigureCoordinator, CoordinatorConfigured, decode_envelope, encode_envelope
from firmware_protocol.framing.can_frame import CanFrame, Direction, RecordReader, configuration_id, encode_record
from firmware_protocol.units import NS_PER_MS

_TICK_NS = 5 * NS_PER_MS
_MAX_WAITING = 64


class IsoTpExchange:
    """See the module; driven as a host is. ``answer`` is None until there is one, ``faults`` are can-isotp's words."""

    def __init__(self, request: ConfigureCoordinator, *, unit: int) -> None:
        self.answer: CoordinatorConfigured | None = None
        self.faults: deque[str] = deque(maxlen=8)
        self._token = request.token
        self._asks_as = configuration_id(unit=unit, direction=Direction.TO_COORDINATOR)
        self._answered_by = configuration_id(unit=unit, direction=Direction.FROM_COORDINATOR)
        self._records = RecordReader()
        self._incoming: deque[isotp.CanMessage] = deque(maxlen=_MAX_WAITING)
        self._outgoing: list[bytes] = []
        self._layer = isotp.TransportLayerLogic(
            rxfn=lambda _: self._incoming.popleft() if self._incoming else None,
            txfn=self._send,
            address=isotp.Address(isotp.AddressingMode.Normal_29bits, txid=self._asks_as, rxid=self._answered_by),
            error_handler=lambda error: self.faults.append(str(error)),
            params={"max_frame_size": 64, "stmin": 0, "blocksize": 0},
        )
        self._layer.send(encode_envelope(request))
        self._next_ns = 0

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take records from the port."""
        for frame in self._records.feed(chunk):
            if isinstance(frame, CanFrame) and frame.can_id == self._answered_by:
                size = len(frame.data)
                self._incoming.append(isotp.CanMessage(arbitration_id=frame.can_id, dlc=size, data=frame.data, extended_id=True))
        self.handle_deadline(now_ns=now_ns)

    def take_frames(self) -> list[bytes]:
        """Return the records that are to go out."""
        frames, self._outgoing = self._outgoing, []
        return frames

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` is to be called."""
        return self._next_ns

    def handle_deadline(self, *, now_ns: int) -> None:
        """Let can-isotp, which has a clock of its own, do what is due."""
        self._next_ns = now_ns + _TICK_NS
        self._layer.process()
        while (message := self._layer.recv()) is not None:
            answer = decode_envelope(bytes(message))
            if isinstance(answer, CoordinatorConfigured) and answer.token == self._token:
                self.answer = answer

    def _send(self, message: isotp.CanMessage) -> None:
        self._outgoing.append(encode_record(CanFrame(can_id=message.arbitration_id, data=bytes(message.data))))
