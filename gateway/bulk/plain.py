"""Bulk decoding in Python: what the compiled way says, a hundred times slower, for machines without a compiler and for tests."""

from firmware_protocol.envelope import RadioReceived, decode_envelope
from firmware_protocol.framing.cobs import CobsDecoder
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.message_codec import decode_uplink_fields
from firmware_protocol.messages import MessageFault
from firmware_protocol.units import RSSI_UNKNOWN
from gateway.bulk.columns import FRAME_FAULTS, MESSAGE_FAULTS, NO_PATH, NO_SOURCE, OTHER, UPLINK, Columns

_LINK_HEADER_SIZE = 4
_LINK_DATA = 3
_BATCH_TYPES = {0x02, 0x08}


class PlainDecoder:
    """See the module and ``decoder.Decoder``."""

    def __init__(self, *, is_bare: bool) -> None:
        self._is_bare = is_bare
        self._frames = CobsDecoder()

    def feed(self, chunk: bytes) -> Columns:
        """Take the next bytes of the stream; return what became of the frames they complete."""
        columns = Columns()
        for result in self._frames.feed(chunk):
            if isinstance(result, FrameFault):
                self._put(columns, status=FRAME_FAULTS[result])
            elif self._is_bare:
                self._put_payload(columns, result, source=NO_SOURCE, rssi_dbm=RSSI_UNKNOWN, lqi=0)
            else:
                envelope = decode_envelope(result[_LINK_HEADER_SIZE:]) if result[0] == _LINK_DATA else None
                if isinstance(envelope, RadioReceived):
                    self._put_payload(columns, envelope.payload, source=envelope.source, rssi_dbm=envelope.rssi_dbm, lqi=envelope.lqi)
                else:
                    self._put(columns, status=OTHER)
        return columns

    def _put_payload(self, columns: Columns, payload: bytes, *, source: int, rssi_dbm: int, lqi: int) -> None:
        fields = decode_uplink_fields(payload)
        if isinstance(fields, MessageFault):
            self._put(columns, status=MESSAGE_FAULTS[fields], source=source, rssi_dbm=rssi_dbm, lqi=lqi)
            return
        (kind, _, node, boot, sequence, sent_ms), _, rest = fields
        if kind in _BATCH_TYPES:
            for entry in rest:
                assert isinstance(entry, tuple), "batches have entries, not text"
                peer, start_ms, high, low, entry_rssi_dbm, *path = entry
                columns.peer.append(peer)
                columns.start_ms.append(start_ms)
                columns.duration_ms.append((high & 0x3F) << 16 | low)
                columns.is_ongoing.append(high >> 7)
                columns.entry_rssi_dbm.append(entry_rssi_dbm)
                columns.path_mm.append(path[0] if path else NO_PATH)
        self._put(
            columns,
            status=UPLINK,
            header=(kind, node, boot, sequence, sent_ms),
            source=source,
            rssi_dbm=rssi_dbm,
            lqi=lqi,
        )

    @staticmethod
    def _put(
        columns: Columns,
        *,
        status: int,
        header: tuple[int, int, int, int, int] = (0, 0, 0, 0, 0),
        source: int = NO_SOURCE,
        rssi_dbm: int = RSSI_UNKNOWN,
        lqi: int = 0,
    ) -> None:
        columns.status.append(status)
        for column, value in zip((columns.type, columns.node, columns.boot, columns.sequence, columns.sent_ms), header, strict=True):
            column.append(value)
        columns.source.append(source)
        columns.rssi_dbm.append(rssi_dbm)
        columns.lqi.append(lqi)
        columns.entries_end.append(len(columns.peer))
