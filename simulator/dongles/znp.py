"""A virtual Z-Stack coordinator dongle: the chip's side of MT (WIRE_FORMAT.md §9). No I/O, no clock.

It comes as from a shop, without a network, and forms one when its host tells it to. What is in its non-volatile memory, the network too,
outlives a reset; endpoints and all that is under way do not. A CC2531's boot loader waits for a byte before it starts the rest.
"""

import struct
from collections import Counter, deque
from dataclasses import dataclass, field
from enum import Enum

from firmware_protocol.envelope import RadioReceived, RadioSend, RadioStatus
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.framing.znp import ZnpDecoder, encode_frame
from firmware_protocol.units import NS_PER_MS, NS_PER_S, ShortAddress
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import Message, decode_command, encode_command
from firmware_protocol.znp.frames import Request, ZnpFault
from firmware_protocol.znp.numbers import NvItem
from simulator.dongles.znp_memory import ZnpMemory
from simulator.dongles.znp_stack import ZnpStack, ZStack

_BOOT_NS = 150 * NS_PER_MS
_LOADER_NS = 60 * NS_PER_S
"""How long the boot loader waits for its byte before it starts the application all the same."""
_SKIP_BYTE = 0xEF
_HOST_NS = 30 * NS_PER_S
"""A host that says nothing for so long is gone: the dongle behaves the same, the simulator's log is told."""

_MAX_UPLINK = 4096
_MAX_OUTGOING = 8192
"""Bytes that wait for the line at most [B]: payloads from the air leave half of it to answers."""

_SYNCHRONOUS = 0x20
_BAD_SUBSYSTEM, _BAD_COMMAND, _BAD_LENGTH = 1, 2, 4
_SUBSYSTEMS = frozenset({0x01, 0x04, 0x05, 0x07, 0x0F})
_RADIUS_LEFT = 30
_FIRST_TRUST_CENTER_KEY = (1, 4, 0)
"""Z-Stack's own table (system 1) of trust-centre link keys (item 4), its first entry."""
_NO_KEY = bytes(20)


@dataclass(frozen=True, slots=True, kw_only=True)
class ZnpDongleConfig:
    """What is in the box; ``pan_id`` is the one it chooses where it may."""

    eui64: int = 0x00124B0000000000
    pan_id: int = 0xB10B
    firmware: ZStack = ZStack.V3_X_0
    has_boot_loader: bool = False


class _Power(Enum):
    OFF = "off"
    LOADER = "loader"
    BOOTING = "booting"
    ON = "on"


@dataclass(slots=True, kw_only=True)
class ZnpDongle:
    """See the module and ``dongles.interface.Dongle``."""

    config: ZnpDongleConfig = field(default_factory=ZnpDongleConfig)
    requests: deque[RadioSend] = field(default_factory=deque)
    faults: Counter[str] = field(default_factory=Counter)
    memory: ZnpMemory = field(init=False)
    _stack: ZnpStack = field(init=False)
    _decoder: ZnpDecoder = field(default_factory=ZnpDecoder)
    _power: _Power = _Power.OFF
    _power_at_ns: int = 0
    """When the state of ``_power`` ends by itself."""
    _outgoing: bytearray = field(default_factory=bytearray)
    _host_until_ns: int | None = None

    def __post_init__(self) -> None:
        factory: dict[int, bytes] = {
            NvItem.EXTADDR: self.config.eui64.to_bytes(8, "little"),
            NvItem.STARTUP_OPTION: b"\x00",
            NvItem.PANID: b"\xff\xff",
            NvItem.CHANLIST: (1 << 11).to_bytes(4, "little"),
            NvItem.LOGICAL_TYPE: b"\x00",
            NvItem.ZDO_DIRECT_CB: b"\x00",
        }
        if self.config.firmware is not ZStack.V1_2:
            factory[NvItem.BDB_IS_ON_NETWORK] = b"\x00"
        extended = {} if self.config.firmware is ZStack.V1_2 else {_FIRST_TRUST_CENTER_KEY: _NO_KEY}
        self.memory = ZnpMemory(factory=factory, extended=extended)
        self._stack = self._make_stack()

    @property
    def is_open(self) -> bool:
        """A base station has registered its endpoint, and speaks."""
        return self._host_until_ns is not None and self._stack.is_registered

    def start(self, *, now_ns: int) -> None:
        """Switch the dongle on, or reset it as its button does."""
        self._reset(now_ns, is_hard=True)

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take bytes from the serial line, cut anywhere."""
        if self._power is _Power.LOADER and _SKIP_BYTE in chunk:
            self._power, self._power_at_ns = _Power.BOOTING, now_ns + _BOOT_NS
        if not self._is_on:
            self.faults["not_running"] += 1
            return
        for body in self._decoder.feed(chunk):
            if isinstance(body, FrameFault):
                self.faults[body.value] += 1
                continue
            self._host_until_ns = now_ns + _HOST_NS
            if self._obey(body, now_ns):
                return  # what came behind the command to reset fell into the reset

    def take_bytes(self) -> bytes:
        """Return what is to go out over the serial line; each byte is handed out once."""
        data = bytes(self._outgoing)
        self._outgoing.clear()
        return data

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None."""
        if not self._is_on:
            return None if self._power is _Power.OFF else self._power_at_ns
        return min((at for at in (self._host_until_ns, self._stack.up_at_ns) if at is not None), default=None)

    def handle_deadline(self, *, now_ns: int) -> None:
        """Go on with a start, or with a network that is to come up."""
        if not self._is_on:
            if self._power is not _Power.OFF and now_ns >= self._power_at_ns:
                self._boot()
            return
        if self._stack.up_at_ns is not None and now_ns >= self._stack.up_at_ns:
            self._say(self._stack.come_up())
        if self._host_until_ns is not None and now_ns >= self._host_until_ns:
            self._host_until_ns = None

    def take_from_radio(self, received: RadioReceived, *, eui64: int, now_ns: int) -> bool:  # noqa: ARG002  # the frame has short addresses
        """Hand a payload from the air over the line; return False where nobody has registered for it, or the line is behind."""
        if not self._stack.is_registered:
            self.faults["no_endpoint"] += 1
            return False
        if len(self._outgoing) >= _MAX_UPLINK:
            self.faults["uplink_full"] += 1
            return False
        body = encode_command(self._stack.hear(received, now_ns=now_ns))
        # What no document tells and every firmware of today adds: the last hop, and what is left of the radius.
        self._outgoing += encode_frame(body + struct.pack("<HB", received.source, _RADIUS_LEFT))
        return True

    def confirm(self, handle: int, status: RadioStatus, *, now_ns: int) -> None:  # noqa: ARG002  # the interface's
        """Tell the host what became of a request."""
        self._say(self._stack.confirm(handle, status))

    def node_joined(self, address: ShortAddress, *, eui64: int, now_ns: int) -> None:  # noqa: ARG002  # the interface's
        """Tell the host, where it wants to be told, that a node has joined."""
        self._say(self._stack.see(address, eui64=eui64))

    @property
    def _is_on(self) -> bool:
        return self._power is _Power.ON

    def _make_stack(self) -> ZnpStack:
        config = self.config
        return ZnpStack(firmware=config.firmware, memory=self.memory, pan_id=config.pan_id, requests=self.requests, faults=self.faults)

    def _reset(self, now_ns: int, *, is_hard: bool) -> None:
        self.requests.clear()
        self._stack = self._make_stack()
        self._decoder = ZnpDecoder()
        self._host_until_ns = None
        waits = is_hard and self.config.has_boot_loader
        self._power = _Power.LOADER if waits else _Power.BOOTING
        self._power_at_ns = now_ns + (_LOADER_NS if waits else _BOOT_NS)

    def _boot(self) -> None:
        self._power = _Power.ON
        self.memory.obey_startup_option()
        version = self.config.firmware.version
        indication = znp.ResetIndication(
            reason=0, transport=version.transport, product=version.product, major=version.major, minor=version.minor,
            hardware=version.maintenance,
        )  # fmt: skip
        self._say([indication])

    def _obey(self, body: bytes, now_ns: int) -> bool:
        """Do what the host wants; return whether that was a reset."""
        message = decode_command(body)
        if isinstance(message, ZnpFault):
            self._refuse(body, message)
        elif isinstance(message, znp.ResetRequest):
            self._reset(now_ns, is_hard=message.kind == 0)
        elif isinstance(message, Request):
            said = self._stack.answer(message, now_ns=now_ns)
            if said:
                self._say(said)
            else:
                self._refuse(body, ZnpFault.UNKNOWN_COMMAND)
        else:
            self.faults["wrong_direction"] += 1
        return isinstance(message, znp.ResetRequest)

    def _refuse(self, body: bytes, fault: ZnpFault) -> None:
        """Answer a request that is not understood, as Z-Stack does."""
        self.faults[fault.value] += 1
        if body[0] & 0xE0 == _SYNCHRONOUS:
            is_short = fault is ZnpFault.BAD_LENGTH
            error = _BAD_LENGTH if is_short else _BAD_COMMAND if body[0] & 0x1F in _SUBSYSTEMS else _BAD_SUBSYSTEM
            self._say([znp.RpcError(error=error, command=body[0] << 8 | body[1])])

    def _say(self, messages: list[Message]) -> None:
        for message in messages:
            if len(self._outgoing) >= _MAX_OUTGOING:
                self.faults["answer_lost"] += 1
            else:
                self._outgoing += encode_frame(encode_command(message))
