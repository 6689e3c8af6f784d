"""A small base station for tests: the ground's own link, framing and messages, and a store of what was heard. No I/O."""

from collections import Counter, defaultdict
from dataclasses import dataclass, field

from firmware_protocol.envelope import CoordinatorHello, RadioConfirm, RadioReceived, RadioSend, decode_envelope, encode_envelope
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.link import Link, LinkLost, LinkState, PayloadReceived, Role
from firmware_protocol.message_codec import decode_uplink, encode_downlink
from firmware_protocol.messages import (
    Acknowledge,
    Action,
    Downlink,
    EncounterBatch,
    EncounterEntry,
    MessageFault,
    Stimulate,
    TimeSyncReply,
    Uplink,
    UplinkHeader,
)
from firmware_protocol.units import BootId, ShortAddress


def a_command(
    command: int, action: Action, *, hold_ms: int = 0, ttl_ms: int = 1000, duration_ms: int = 500, frequency_hz: int = 50
) -> Stimulate:
    return Stimulate(
        command=command, action=action, ttl_ms=ttl_ms, hold_ms=hold_ms, frequency_hz=frequency_hz, pulse_width_us=5_000, amplitude_mv=2_000,
        duration_ms=duration_ms,
    )  # fmt: skip


@dataclass(slots=True)
class Ledger:
    """What the base station has on disk from one boot of one backpack."""

    messages: dict[int, Uplink] = field(default_factory=dict)

    def take(self, sequence: int, message: Uplink) -> None:
        assert self.messages.setdefault(sequence, message) == message, "a sequence number was used for two messages"

    def acknowledge(self, boot: BootId) -> Acknowledge:
        # What lies more than 32 below the newest was acknowledged, here or by another base station (WIRE_FORMAT.md §5.1).
        next_sequence = max(0, max(self.messages, default=0) - 32)
        while next_sequence in self.messages:
            next_sequence += 1
        bitmap = sum(1 << bit for bit in range(32) if next_sequence + 1 + bit in self.messages)
        return Acknowledge(boot=boot, next_sequence=next_sequence % 65536, bitmap=bitmap)

    def entries(self) -> list[EncounterEntry]:
        batches = [message for _, message in sorted(self.messages.items()) if isinstance(message, EncounterBatch)]
        return [entry for batch in batches for entry in batch.entries]


@dataclass(slots=True)
class BaseStation:
    """Feed it the line's bytes and time; it acknowledges all it hears."""

    link: Link = field(default_factory=lambda: Link(role=Role.INITIATOR))
    ledgers: dict[tuple[int, int], Ledger] = field(default_factory=lambda: defaultdict(Ledger))
    address: dict[int, ShortAddress] = field(default_factory=dict)
    hellos: list[CoordinatorHello] = field(default_factory=list)
    confirms: list[RadioConfirm] = field(default_factory=list)
    syncs: list[tuple[UplinkHeader, TimeSyncReply]] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)
    outgoing: bytearray = field(default_factory=bytearray)
    is_deaf_to_radio: bool = False
    refused: list[MessageFault] | None = None
    """Messages that their own check refuses; None: there must be none."""
    _decoder: CobsDecoder = field(default_factory=CobsDecoder)
    _session: int = 0
    _handle: int = 0

    def tick(self, now_ns: int) -> None:
        if self.link.state is LinkState.CLOSED:
            self._session += 1
            self.link.open(session=self._session, now_ns=now_ns)
        deadline_ns = self.link.next_deadline_ns()
        if deadline_ns is not None and deadline_ns <= now_ns:
            self.link.handle_deadline(now_ns=now_ns)
        self._flush()

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        for body in self._decoder.feed(chunk):
            if isinstance(body, FrameFault):
                self.faults[body.value] += 1
                continue
            for event in self.link.receive(body, now_ns=now_ns):
                if isinstance(event, PayloadReceived):
                    self._take(event.payload, now_ns=now_ns)
                    self.link.confirm(event.receipt)
                elif isinstance(event, LinkLost):
                    self.faults[event.reason.value] += 1
        self._flush()

    def send(self, destination: int, message: Downlink, *, now_ns: int) -> int:
        self._handle = (self._handle + 1) % 65536
        payload = encode_downlink(0, message)
        envelope = RadioSend(handle=self._handle, destination=ShortAddress(destination), payload=payload)
        self.link.send(encode_envelope(envelope), now_ns=now_ns, is_urgent=True)
        self._flush()
        return self._handle

    def take_outgoing(self) -> bytes:
        data = bytes(self.outgoing)
        self.outgoing.clear()
        return data

    def of_type(self, kind: type[Uplink]) -> list[tuple[int, Uplink]]:
        return [(node, one) for (node, _), ledger in self.ledgers.items() for one in ledger.messages.values() if isinstance(one, kind)]

    def _take(self, payload: bytes, *, now_ns: int) -> None:
        match decode_envelope(payload):
            case CoordinatorHello() as hello:
                self.hellos.append(hello)
            case RadioConfirm() as confirm:
                self.confirms.append(confirm)
            case RadioReceived(source=source, payload=radio_payload) if not self.is_deaf_to_radio:
                self._hear(source, radio_payload, now_ns=now_ns)
            case _:
                pass

    def _hear(self, source: ShortAddress, payload: bytes, *, now_ns: int) -> None:
        decoded = decode_uplink(payload)
        if isinstance(decoded, MessageFault):
            assert self.refused is not None, decoded
            self.refused.append(decoded)
            return
        header, message = decoded
        self.address[header.node] = source
        if isinstance(message, TimeSyncReply):
            self.syncs.append((header, message))
            return
        ledger = self.ledgers[header.node, header.boot]
        ledger.take(header.sequence, message)
        if self.link.n_free > 0:
            self.send(source, ledger.acknowledge(header.boot), now_ns=now_ns)

    def _flush(self) -> None:
        for body in self.link.take_frames():
            self.outgoing += encode_frame(body)
