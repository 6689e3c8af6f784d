"""A virtual coordinator on a CAN bus: the native dialect in CAN frames, configured by ISO-TP (WIRE_FORMAT.md §10). No I/O, no clock."""

from collections import Counter, deque

from firmware_protocol.dialects.can import can_framing
from firmware_protocol.envelope import ConfigureCoordinator, RadioReceived, RadioSend, RadioStatus, decode_envelope, encode_envelope
from firmware_protocol.framing.can_frame import CanFrame, Direction, RecordReader, configuration_id, encode_record
from firmware_protocol.units import ShortAddress
from simulator.dongles.isotp import IsoTpEnd
from simulator.dongles.native import NativeDongle, NativeDongleConfig


class CanDongle:
    """See the module and ``Dongle``.

    Parameters
    ----------
    unit
        The coordinator's number on its bus.
    is_fd
        Whether it sends CAN FD frames; it takes both.
    """

    def __init__(self, *, config: NativeDongleConfig, unit: int, is_fd: bool) -> None:
        self._native = NativeDongle(config=config, framing=can_framing(unit=unit, is_fd=is_fd, sends=Direction.FROM_COORDINATOR))
        self._records = RecordReader()
        self._configuration = IsoTpEnd()
        self._asked_by = configuration_id(unit=unit, direction=Direction.TO_COORDINATOR)
        self._answers_as = configuration_id(unit=unit, direction=Direction.FROM_COORDINATOR)
        self.requests: deque[RadioSend] = self._native.requests
        self.faults: Counter[str] = self._native.faults

    @property
    def is_open(self) -> bool:
        """A base station is connected."""
        return self._native.is_open

    def start(self, *, now_ns: int) -> None:
        """Switch the coordinator on: it asks for a session."""
        self._configuration = IsoTpEnd()
        self._native.start(now_ns=now_ns)

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take records from the bus, cut anywhere."""
        self._native.feed(chunk, now_ns=now_ns)
        for frame in self._records.feed(chunk):
            if isinstance(frame, CanFrame) and frame.can_id == self._asked_by:
                message = self._configuration.take(frame.data, now_ns=now_ns)
                if message is not None:
                    self._configure(message, now_ns=now_ns)

    def take_bytes(self) -> bytes:
        """Return the records that are to go out; each is handed out once."""
        frames = [CanFrame(can_id=self._answers_as, data=data) for data in self._configuration.take_frames()]
        return self._native.take_bytes() + b"".join(map(encode_record, frames))

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None."""
        deadlines = (self._native.next_deadline_ns(), self._configuration.next_deadline_ns())
        return min((at for at in deadlines if at is not None), default=None)

    def handle_deadline(self, *, now_ns: int) -> None:
        """Repeat what was not answered, or give the session up."""
        self._native.handle_deadline(now_ns=now_ns)
        self._configuration.handle_deadline(now_ns=now_ns)

    def take_from_radio(self, received: RadioReceived, *, eui64: int, now_ns: int) -> bool:
        """Take a payload from the air; return False, and take nothing, where there is no room."""
        return self._native.take_from_radio(received, eui64=eui64, now_ns=now_ns)

    def confirm(self, handle: int, status: RadioStatus, *, now_ns: int) -> None:
        """Tell the base station what became of a request."""
        self._native.confirm(handle, status, now_ns=now_ns)

    def node_joined(self, address: ShortAddress, *, eui64: int, now_ns: int) -> None:
        """Learn that a node has joined."""
        self._native.node_joined(address, eui64=eui64, now_ns=now_ns)

    def _configure(self, message: bytes, *, now_ns: int) -> None:
        request = decode_envelope(message)
        if isinstance(request, ConfigureCoordinator):
            self._configuration.send(encode_envelope(self._native.configure(request, now_ns=now_ns)), now_ns=now_ns)
        else:
            self.faults["configuration"] += 1
