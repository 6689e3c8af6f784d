"""Records of a line as packets for Wireshark: what went over the air, and the frames on the line that carried it.

The dongle does not show the radio frames themselves, so each radio payload is put into an IEEE 802.15.4 data frame: addresses, PAN and
channel are those that the dongle told, sequence numbers are made up, and there are neither ZigBee's own headers nor a checksum.
"""

import struct
from dataclasses import dataclass, field

from firmware_protocol.messages import MessageFault
from gateway.recordings.dissection import Dissection, FrameCutter, LineDissector, RadioPayload, decode_payload
from gateway.recordings.pcapng import LinkType, PcapngWriter
from gateway.transports.recording import LineRecord, RecordKind

SECTION_COMMENT = (
    "From a recording of the line between a base station and a coordinator dongle. The IEEE 802.15.4 headers are synthesized around the "
    "radio payloads that the dongle handed over: addresses are the dongle's, PAN and channel are as it told them (0xffff and none until "
    "then), sequence numbers are made up, 0x0000 stands for the coordinator, and one byte, 0xf8, stands where ZigBee's own headers were."
)

_BYTES = (RecordKind.BYTES_IN, RecordKind.BYTES_OUT)
_MAX_RAW = 4096
"""Bytes kept of what makes no frame; a longer run is shown by its end."""

_MAX_REMARKS = 8

_COORDINATOR = 0x0000
_BROADCAST = 0xFFFF
_UNKNOWN_PAN = 0xFFFF

# IEEE 802.15.4-2015, 7.2.2: data frame, PAN id compressed, both addresses short; bit 5 asks for an acknowledgement.
_DATA_FRAME = 0x8841
_WANTS_ACKNOWLEDGEMENT = 0x0020

PREFIX = b"\xf8"
"""Stands before every radio payload in captures, where a ZigBee network header would be: Wireshark, which guesses what a data frame
carries, takes this for none of the protocols it knows (it would be ZigBee of version 14); the dissector of biobot messages looks for it."""

# Fields of the TAP header (github.com/jkcko/ieee802.15.4-tap).
_NO_CHECKSUM, _RSS, _CHANNEL, _LQI = 0, 1, 3, 10


@dataclass(slots=True)
class Capture:
    """Turns the records of one line into packets; see the module.

    Parameters
    ----------
    dissector
        Of the line's dialect.
    writer
        Gets two interfaces: radio payloads, and frames on the line.
    """

    dissector: LineDissector
    writer: PcapngWriter
    port: str
    dialect: str
    n_packets: int = 0
    _air: int = field(init=False)
    _line: int = field(init=False)
    _pan_id: int = _UNKNOWN_PAN
    _channel: int | None = None
    _sequence: int = 0
    _raw: dict[bool, bytearray] = field(default_factory=dict)
    _cutters: dict[bool, FrameCutter] = field(default_factory=dict)
    _remarks: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        name = f"radio of {self.port}"
        description = "radio payloads in synthesized IEEE 802.15.4 frames"
        self._air = self.writer.add_interface(LinkType.IEEE802_15_4_TAP, name=name, description=description)
        description = f"frames of dialect {self.dialect} as they stood on the line"
        link_type = LinkType.USER0 if self.dissector.dialect.make_cutter is None else LinkType.CAN_SOCKETCAN
        self._line = self.writer.add_interface(link_type, name=self.port, description=description)
        self._begin_anew()

    def take(self, record: LineRecord) -> None:
        """Write the packets that a record completes."""
        if record.kind not in _BYTES:
            self._remark(record)
            return
        is_outgoing = record.kind is RecordKind.BYTES_OUT
        if self._cutters:
            self._take_can(record, is_outgoing=is_outgoing)
            return
        raw = self._raw[is_outgoing]
        for piece in self.dissector.pieces(record.data):
            raw += piece
            for dissection in self.dissector.feed(piece, is_outgoing=is_outgoing):
                faults = (f"fault: {dissection.fault}",) if dissection.fault else ()
                self._write_line(bytes(raw[-_MAX_RAW:]), record.wall_ns, is_outgoing=is_outgoing, comments=faults)
                self._write_air(dissection, record.wall_ns)
                raw.clear()  # where one byte settles several frames, the first has it all
        if len(raw) > 2 * _MAX_RAW:
            del raw[:-_MAX_RAW]

    def _take_can(self, record: LineRecord, *, is_outgoing: bool) -> None:
        """Write CAN frames as they are, and what they carry together once they are whole."""
        for frame, fault in self._cutters[is_outgoing].feed(record.data):
            self._write_line(frame, record.wall_ns, is_outgoing=is_outgoing, comments=(f"fault: {fault}",) if fault else ())
        for dissection in self.dissector.feed(record.data, is_outgoing=is_outgoing):
            self._write_air(dissection, record.wall_ns)
            if dissection.fault and len(self._remarks) < _MAX_REMARKS:
                self._remarks.append(f"before this, fault: {dissection.fault}")

    def _begin_anew(self) -> None:
        self.dissector.begin_anew()
        self._raw = {False: bytearray(), True: bytearray()}
        make_cutter = self.dissector.dialect.make_cutter
        self._cutters = {} if make_cutter is None else {is_outgoing: make_cutter() for is_outgoing in (False, True)}

    def _remark(self, record: LineRecord) -> None:
        """Keep what is no packet for the next one."""
        if record.kind is RecordKind.OPENED:
            self._begin_anew()
        if len(self._remarks) < _MAX_REMARKS:
            self._remarks.append(f"before this: {record.kind.name.lower()} {record.data.decode(errors='replace')}".rstrip())

    def _write_line(self, data: bytes, wall_ns: int, *, is_outgoing: bool, comments: tuple[str, ...]) -> None:
        remarks, self._remarks = tuple(self._remarks), []
        self.writer.write_packet(self._line, data, wall_ns=wall_ns, is_outgoing=is_outgoing, comments=remarks + comments)
        self.n_packets += 1

    def _write_air(self, dissection: Dissection, wall_ns: int) -> None:
        """Write the radio payload of a frame, where it has one, and keep what it tells of the network."""
        if (told := dissection.network) is not None:
            self._pan_id = self._pan_id if told.pan_id is None else told.pan_id
            self._channel = self._channel if told.channel is None else told.channel
        payload, is_outgoing = dissection.payload, dissection.is_outgoing
        if payload is None:
            return
        decoded = decode_payload(payload, is_outgoing=is_outgoing)
        comments = (f"fault: message.{decoded.value}",) if isinstance(decoded, MessageFault) else ()
        data = self._tap_header(payload) + self._radio_frame(payload, is_outgoing=is_outgoing)
        self.writer.write_packet(self._air, data, wall_ns=wall_ns, is_outgoing=is_outgoing, comments=comments)
        self.n_packets += 1

    def _tap_header(self, payload: RadioPayload) -> bytes:
        fields = _tap_field(_NO_CHECKSUM, b"\x00")
        if payload.rssi_dbm is not None:
            fields += _tap_field(_RSS, struct.pack("<f", payload.rssi_dbm))
        if self._channel is not None:
            fields += _tap_field(_CHANNEL, struct.pack("<HB", self._channel, 0))  # page 0: O-QPSK at 2.4 GHz
        if payload.lqi is not None:
            fields += _tap_field(_LQI, bytes([payload.lqi]))
        return struct.pack("<BBH", 0, 0, 4 + len(fields)) + fields

    def _radio_frame(self, payload: RadioPayload, *, is_outgoing: bool) -> bytes:
        self._sequence = (self._sequence + 1) % 256
        source, destination = (_COORDINATOR, payload.address) if is_outgoing else (payload.address, _COORDINATOR)
        control = _DATA_FRAME if destination == _BROADCAST else _DATA_FRAME | _WANTS_ACKNOWLEDGEMENT
        return struct.pack("<HBHHH", control, self._sequence, self._pan_id, destination, source) + PREFIX + payload.data


def _tap_field(kind: int, value: bytes) -> bytes:
    return struct.pack("<HH", kind, len(value)) + value + bytes(-len(value) % 4)
