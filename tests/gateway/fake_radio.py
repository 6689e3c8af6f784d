"""A coordinator dongle with backpacks behind it, on a pty or a TCP port, made from the ground's own parts.

The dongle keeps its link and its unconfirmed payloads while the cable is out, as a real one does. A backpack repeats what was
not acknowledged, and remembers commands.
"""

import asyncio
import os
import time
import tty
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

from firmware_protocol.envelope import (
    CoordinatorHello,
    IdentifyRequest,
    RadioConfirm,
    RadioReceived,
    RadioSend,
    RadioStatus,
    decode_envelope,
    encode_envelope,
)
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.link import Link, LinkConfig, PayloadReceived, Role
from firmware_protocol.message_codec import decode_downlink, encode_uplink
from firmware_protocol.messages import (
    Acknowledge,
    Action,
    Capability,
    ConfigurationReport,
    ConfigurationResult,
    Configure,
    EncounterBatch,
    EncounterBatchWithPaths,
    EncounterEntry,
    Hello,
    HelloRequest,
    MessageFault,
    Neighbour,
    Neighbours,
    Status,
    Stimulate,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    TimeSyncRequest,
    Uplink,
    UplinkHeader,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm, ShortAddress

_REPEAT_S = 1.0
_FIRST_BOOT = BootId(1)
_OUTSTANDING = 33


@dataclass(kw_only=True)
class FakeBackpack:
    """One backpack; ``reports`` are what it was told to say, in order."""

    node: NodeId
    boot: BootId = _FIRST_BOOT
    boot_at_s: float = field(default_factory=lambda: time.monotonic() - 1000.0)
    answers: bool = True
    is_away: bool = False
    """It was heard, and has left: nothing reaches it any more."""
    mode: WireMode = WireMode.CRW
    obeyed: list[Stimulate] = field(default_factory=list)
    heard: list[Stimulate] = field(default_factory=list)
    hellos: int = 0
    capabilities: Capability = Capability.STIMULATION
    configured: list[Configure] = field(default_factory=list)
    configuration_result: ConfigurationResult = ConfigurationResult.DONE
    _sequence: int = 0
    _waiting: deque[Uplink] = field(default_factory=deque)
    _outbox: dict[int, Uplink] = field(default_factory=dict)
    _repeats: deque[tuple[float, int]] = field(default_factory=deque)
    _unkept: list[Uplink] = field(default_factory=list)
    _known: dict[int, Milliseconds] = field(default_factory=dict)

    @property
    def now_ms(self) -> Milliseconds:
        return Milliseconds(int((time.monotonic() - self.boot_at_s) * 1000))

    @property
    def is_level(self) -> bool:
        """Everything it said is acknowledged."""
        return not self._outbox and not self._waiting

    def say(self, message: Uplink) -> None:
        self._waiting.append(message)

    def say_hello(self) -> None:
        self.hellos += 1
        self.say(Hello(eui64=0xE000 + self.node, firmware=0x0102, beacon_period_ms=0, capabilities=self.capabilities))

    def say_status(self, *, since_ms: int | None = None) -> None:
        since = Milliseconds(self.now_ms if since_ms is None else since_ms)
        cause = WireCause.COMMAND if self.mode is WireMode.S else WireCause.NATURAL
        self.say(Status(mode=self.mode, cause=cause, mode_since_ms=since, battery_mv=2900, buffered=0, dropped=0))

    def say_encounter(self, peer: NodeId, *, ago_ms: int, duration_ms: int, is_ongoing: bool = False, path_mm: int | None = None) -> None:
        entry = EncounterEntry(
            peer=peer,
            start_ms=Milliseconds(self.now_ms - ago_ms),
            duration_ms=Milliseconds(duration_ms),
            rssi_dbm=RssiDbm(-60),
            is_ongoing=is_ongoing,
            path_mm=path_mm,
        )
        self.say(EncounterBatch(entries=(entry,)) if path_mm is None else EncounterBatchWithPaths(entries=(entry,)))

    def say_neighbours(self, peers: list[NodeId]) -> None:
        parts = [peers[at : at + 10] for at in range(0, len(peers), 10)] or [[]]
        for index, part in enumerate(parts):
            neighbours = tuple(Neighbour(node=peer, rssi_dbm=RssiDbm(-70)) for peer in part)
            self.say(Neighbours(part=index, n_parts=len(parts), neighbours=neighbours))

    def take_due(self, now_s: float) -> list[bytes]:
        """Payloads that the radio takes now."""
        due = [self._encode(0, message) for message in self._unkept]
        self._unkept.clear()
        while self._waiting and (not self._outbox or self._sequence - next(iter(self._outbox)) < _OUTSTANDING):
            self._outbox[self._sequence] = self._waiting.popleft()
            due.append(self._encode(self._sequence, self._outbox[self._sequence]))
            self._repeats.append((now_s + _REPEAT_S, self._sequence))
            self._sequence += 1
        while self._repeats and self._repeats[0][0] <= now_s:
            _, sequence = self._repeats.popleft()
            if sequence in self._outbox:
                due.append(self._encode(sequence, self._outbox[sequence]))
                self._repeats.append((now_s + _REPEAT_S, sequence))
        return due

    def hear(self, payload: bytes) -> None:
        if self.is_away:
            return
        decoded = decode_downlink(payload)
        if isinstance(decoded, MessageFault):
            return  # counted and dropped, WIRE_FORMAT.md §7
        match decoded[1]:
            case HelloRequest():
                self.say_hello()
            case TimeSyncRequest(token=token):
                self._unkept.append(TimeSyncReply(token=token, received_ms=self.now_ms))
            case Acknowledge() as known:
                self._forget(known)
            case Stimulate() as command:
                self._obey(command)
            case Configure() as wanted:
                self._configure(wanted)

    def _encode(self, sequence: int, message: Uplink) -> bytes:
        header = UplinkHeader(node=self.node, boot=self.boot, sequence=sequence % 65536, sent_ms=self.now_ms)
        return encode_uplink(header, message)

    def _forget(self, known: Acknowledge) -> None:
        if known.boot != self.boot:
            return
        for sequence in list(self._outbox):
            ahead = (sequence - known.next_sequence) % 65536
            if ahead >= 32768 or (1 <= ahead <= 32 and known.bitmap >> (ahead - 1) & 1):
                del self._outbox[sequence]

    def _configure(self, wanted: Configure) -> None:
        self.configured.append(wanted)
        self.say(
            ConfigurationReport(
                token=wanted.token,
                result=self.configuration_result,
                beacon_period_ms=wanted.beacon_period_ms,
                rssi_enter_dbm=wanted.rssi_enter_dbm,
                rssi_exit_dbm=wanted.rssi_exit_dbm,
                gap_tolerance_ms=wanted.gap_tolerance_ms,
                report_period_ms=wanted.report_period_ms,
            )
        )

    def _obey(self, command: Stimulate) -> None:
        self.heard.append(command)
        if not self.answers:
            return
        result = StimulationResult.ALREADY_DONE
        if command.command not in self._known:
            result = StimulationResult.DONE
            self._known[command.command] = self.now_ms
            self.obeyed.append(command)
            self.mode = WireMode.S if command.action is Action.STOP else WireMode.CRW
        at_ms = self._known[command.command]
        self.say(StimulateReply(command=command.command, result=result, executed_ms=at_ms, mode=self.mode))
        self.say_status(since_ms=at_ms)


@dataclass(kw_only=True)
class FakeDongle:
    """The coordinator; ``pump`` moves bytes for as long as its cable is in."""

    backpacks: dict[NodeId, FakeBackpack]
    link: Link = field(default_factory=lambda: Link(role=Role.RESPONDER, config=LinkConfig(max_queue=512)))
    radio_status: RadioStatus = RadioStatus.SENT
    n_sent: int = 0
    is_stalled: bool = False
    _decoder: CobsDecoder = field(default_factory=CobsDecoder)

    def take_bytes(self, data: bytes) -> None:
        now_ns = time.monotonic_ns()
        for body in self._decoder.feed(data):
            if isinstance(body, bytes):
                for event in self.link.receive(body, now_ns=now_ns):
                    if isinstance(event, PayloadReceived):
                        self._take_envelope(event.payload, now_ns)
                        self.link.confirm(event.receipt)

    def give_bytes(self) -> bytes:
        now_ns = time.monotonic_ns()
        deadline_ns = self.link.next_deadline_ns()
        if deadline_ns is not None and now_ns >= deadline_ns:
            self.link.handle_deadline(now_ns=now_ns)
        for backpack in self.backpacks.values():
            if self.link.n_free > 64:
                for payload in backpack.take_due(now_ns / 1e9):
                    source = ShortAddress(0x1000 + backpack.node)
                    message = RadioReceived(source=source, rssi_dbm=RssiDbm(-55), lqi=200, payload=payload)
                    self.link.send(encode_envelope(message), now_ns=now_ns)
        return b"".join(encode_frame(body) for body in self.link.take_frames())

    def _take_envelope(self, payload: bytes, now_ns: int) -> None:
        match decode_envelope(payload):
            case IdentifyRequest():
                hello = CoordinatorHello(firmware=1, eui64=0xC0, pan_id=0xB10B, channel=20, max_radio_payload=57)
                self.link.send(encode_envelope(hello), now_ns=now_ns)
            case RadioSend(handle=handle, destination=destination, payload=inner):
                self.n_sent += 1
                backpack = self.backpacks.get(NodeId(destination - 0x1000))
                if backpack is not None and self.radio_status is RadioStatus.SENT:
                    backpack.hear(inner)
                self.link.send(encode_envelope(RadioConfirm(handle=handle, status=self.radio_status)), now_ns=now_ns)
            case other:
                raise AssertionError(other)


def a_dongle(*nodes: int) -> FakeDongle:
    return FakeDongle(backpacks={NodeId(node): FakeBackpack(node=NodeId(node)) for node in nodes})


@asynccontextmanager
async def on_pty(dongle: FakeDongle, link: Path) -> AsyncIterator[None]:
    """Plug the dongle in at the symbolic link ``link``; unplugged at exit."""
    master, slave = os.openpty()
    tty.setraw(slave)
    staged = link.with_name(link.name + ".new")
    staged.symlink_to(os.ttyname(slave))
    staged.replace(link)
    os.close(slave)
    os.set_blocking(master, False)
    try:
        async with _pumping(_pump_fd(dongle, master)):
            yield
    finally:
        os.unlink(link)  # noqa: PTH108  # a blocking call of microseconds, in a test
        os.close(master)


@asynccontextmanager
async def on_tcp(dongle: FakeDongle, *, port: int = 0) -> AsyncIterator[int]:
    """Serve the dongle on a TCP port of loopback; yields the port."""
    serving = 0
    is_over = False

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal serving
        serving += 1
        try:
            while not is_over:
                try:
                    async with asyncio.timeout(0.002):
                        data = await reader.read(4096)
                    if not data:
                        return
                    dongle.take_bytes(data)
                except TimeoutError:
                    pass
                if not dongle.is_stalled:
                    writer.write(dongle.give_bytes())
                    await writer.drain()
        except ConnectionError:
            pass
        finally:
            serving -= 1
            writer.transport.abort()

    server = await asyncio.start_server(serve, "127.0.0.1", port)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        is_over = True
        server.close()
        await until(lambda: serving == 0, what="the connections are closed")


async def until(is_so: Callable[[], bool], *, what: str, timeout_s: float = 60.0) -> None:
    """Wait until something is so; fail with ``what`` where it is not in time."""
    deadline_s = time.monotonic() + timeout_s
    while not is_so():
        assert time.monotonic() < deadline_s, f"not within {timeout_s:g} s: {what}"
        await asyncio.sleep(0.01)


@asynccontextmanager
async def _pumping(pump: Awaitable[None]) -> AsyncIterator[None]:
    task = asyncio.ensure_future(pump)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait({task})


async def _pump_fd(dongle: FakeDongle, master: int) -> None:
    rest = b""
    while True:
        try:
            dongle.take_bytes(os.read(master, 4096))
        except BlockingIOError:
            await asyncio.sleep(0.002)
        except OSError:  # EIO: nobody has the port open
            rest = b""
            await asyncio.sleep(0.01)
            continue
        rest += dongle.give_bytes()
        try:
            rest = rest[os.write(master, rest) :] if rest else b""
        except BlockingIOError:
            await asyncio.sleep(0.002)
