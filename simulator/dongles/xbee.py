"""A virtual Digi XBee that is the coordinator of a ZigBee network (WIRE_FORMAT.md §8). No I/O, no clock.

It behaves as the module does: parameters by AT frames or in command mode, events, transmit statuses, node discovery; it forgets what it was
sent when it is reset, and pushes what it hears onto the line whether or not somebody listens. Its memory is bounded.
"""

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from firmware_protocol.dialects.xbee_addresses import NOT_DELIVERED16
from firmware_protocol.dialects.xbee_frames import (
    AT_BAD_COMMAND,
    AT_OK,
    BROADCAST64,
    UNKNOWN16,
    UNKNOWN64,
    ZDO_PROFILE,
    AtCommand,
    AtResponse,
    Endpoints,
    FromModule,
    ModemStatus,
    NodeIdentification,
    Receive,
    TransmitRequest,
    TransmitStatus,
    XBeeFault,
    decode_xbee,
    encode_xbee,
)
from firmware_protocol.dialects.xbee_meanings import ASSOCIATED, COORDINATOR_STARTED, HARDWARE_RESET, OUTCOME
from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioReceived, RadioSend, RadioStatus
from firmware_protocol.framing.interface import FrameDecoder, FrameFault
from firmware_protocol.framing.xbee import encode_frame, make_decoder
from firmware_protocol.units import NS_PER_MS, NS_PER_S, ShortAddress
from simulator.dongles.xbee_console import XBeeConsole, guard_and_end_ns
from simulator.dongles.xbee_settings import NETWORK, XBeeSettings

_RADIO_QUEUE = 16
_MAX_NODES = 4096
_MAX_WAITING = 4096
"""Bytes for the line that wait at most while payloads from the air are taken [B]."""
_MAX_SAID = 16 * 1024
"""And while anything is said at all [B]."""
_FORMING_NS = 300 * NS_PER_MS
_DISCOVERY_NS = 20 * NS_PER_MS
"""Between two answers of a node discovery."""
_ABSENT_NS = 10 * NS_PER_S
"""A host that has said nothing for so long is taken to be gone: ours asks every 3 s."""
_LONGEST_PAYLOAD = 84
_SCANNING, _FOUND_NOTHING = 0xFF, 0x21
_NO_NETWORK, _NO_ENDPOINT, _SELF, _NOT_KNOWN, _NO_BUFFER, _TOO_LARGE = 0x22, 0x15, 0x23, 0x24, 0x32, 0x74
_IS_BROADCAST, _IS_ACKNOWLEDGED = 0x02, 0x01
_ROUTER, _JOINED = 1, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class XBeeDongleConfig:
    """What the module is; ``memory`` is what its owner has written over the factory's settings. The EUI-64 begins with Digi's number."""

    eui64: int = 0x0013A20000000000
    pan_id: int = 0xB10B
    channel: int = 20
    firmware: int = 0x100D
    hardware: int = 0x4247
    name: bytes = b"BASE"
    memory: Mapping[str, int] = field(default_factory=lambda: {"AP": 2, "CE": 1})


@dataclass(slots=True, kw_only=True)
class XBeeDongle:
    """See the module and ``simulator.dongles.interface.Dongle``."""

    config: XBeeDongleConfig = field(default_factory=XBeeDongleConfig)
    requests: deque[RadioSend] = field(default_factory=deque)
    faults: Counter[str] = field(default_factory=Counter)
    settings: XBeeSettings = field(init=False)
    _console: XBeeConsole = field(init=False)
    _decoder: FrameDecoder = field(init=False)
    _mode: int = 0
    _out: bytearray = field(default_factory=bytearray)
    _nodes: dict[int, int] = field(default_factory=dict)
    """Short address of each node, by its EUI-64."""
    _in_radio: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Frame id and short address of each request that the radio has, by its handle."""
    _next_handle: int = 0
    _association: int = _SCANNING
    _form_at_ns: int | None = None
    _is_to_form: bool = False
    """A parameter of the network was set, and that has not taken effect."""
    _found: deque[bytes] = field(default_factory=deque)
    """Answers of a node discovery that are still to be given."""
    _find_at_ns: int | None = None
    _discovery_id: int = 0
    _host_until_ns: int | None = None
    _restarts_at_ns: int | None = None

    def __post_init__(self) -> None:
        self.settings = XBeeSettings(self.config.memory, name=self.config.name)
        self._console = XBeeConsole(
            obey=self._obey_text,
            read_time_ns=lambda: guard_and_end_ns(guard_ms=self.settings.number("GT"), end_tenths=self.settings.number("CT")),
        )
        self._speak()

    @property
    def is_open(self) -> bool:
        """A base station has said something of late, in frames."""
        return self._host_until_ns is not None

    def start(self, *, now_ns: int) -> None:
        """Switch the module on, or reset it: it runs what is in its memory, and looks for its network."""
        self.settings.reload()
        self.requests.clear()
        self._in_radio.clear()
        self._found.clear()
        self._find_at_ns = self._restarts_at_ns = self._host_until_ns = None
        self._console.leave()
        self._speak()
        self._say(ModemStatus(status=HARDWARE_RESET))
        self._form(now_ns)

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """Take bytes from the line, cut anywhere."""
        if self._mode == 0:
            answer, data = self._console.feed(chunk, now_ns=now_ns)
            self._out += answer
            self._send_transparently(data)
            if not self._console.is_in_command_mode:
                self._apply(now_ns)
            return
        for body in self._decoder.feed(chunk):
            if isinstance(body, FrameFault):
                self.faults[body.value] += 1
            else:
                self._take(body, now_ns)

    def take_bytes(self) -> bytes:
        """Return what is to go out over the line; each byte is handed out once."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None."""
        dues = (self._console.deadline_ns, self._form_at_ns, self._find_at_ns, self._host_until_ns, self._restarts_at_ns)
        return min((due for due in dues if due is not None), default=None)

    def handle_deadline(self, *, now_ns: int) -> None:
        """Do what is due."""
        self._out += self._console.handle_deadline(now_ns=now_ns)
        if self._mode == 0 and not self._console.is_in_command_mode:
            self._apply(now_ns)
        if self._restarts_at_ns is not None and now_ns >= self._restarts_at_ns:
            self.start(now_ns=now_ns)
        if self._form_at_ns is not None and now_ns >= self._form_at_ns:
            self._form_at_ns = None
            self._association = ASSOCIATED if self.settings.number("CE") else _FOUND_NOTHING
            if self._association == ASSOCIATED:
                self._say(ModemStatus(status=COORDINATOR_STARTED))
        if self._find_at_ns is not None and now_ns >= self._find_at_ns:
            if self._found:
                self._say(AtResponse(frame_id=self._discovery_id, command="ND", status=AT_OK, value=self._found.popleft()))
            self._find_at_ns = now_ns + _DISCOVERY_NS if self._found else None
        if self._host_until_ns is not None and now_ns >= self._host_until_ns:
            self._host_until_ns = None

    def take_from_radio(self, received: RadioReceived, *, eui64: int, now_ns: int) -> bool:  # noqa: ARG002  # the interface's
        """Take a payload from the air; return False, and take nothing, where there is no network or no room."""
        if self._association != ASSOCIATED:
            return False
        if len(self._out) > _MAX_WAITING:
            self.faults["uplink_full"] += 1
            return False
        self._know(eui64, received.source)
        if self._mode == 0:
            self._out += received.payload
            return True
        endpoints = Endpoints() if self.settings.number("AO") else None
        options = _IS_ACKNOWLEDGED
        self._say(Receive(source64=eui64, source16=received.source, options=options, payload=received.payload, endpoints=endpoints))
        return True

    def confirm(self, handle: int, status: RadioStatus, *, now_ns: int) -> None:  # noqa: ARG002  # the interface's
        """Tell the base station what became of a request, unless a reset came in between."""
        frame_id, address = self._in_radio.pop(handle, (0, 0))
        self._say_status(frame_id, OUTCOME[status], address if status is RadioStatus.SENT else NOT_DELIVERED16)

    def node_joined(self, address: ShortAddress, *, eui64: int, now_ns: int) -> None:  # noqa: ARG002  # the interface's
        """Learn that a node has joined; backpacks identify themselves then (their ``JN`` is 1)."""
        self._know(eui64, address)
        name = _name_of(eui64)
        self._say(
            NodeIdentification(
                sender64=eui64, sender16=address, options=_IS_BROADCAST, node16=address, node64=eui64, name=name, parent16=0, kind=_ROUTER,
                event=_JOINED,
            )
        )  # fmt: skip

    def _take(self, body: bytes, now_ns: int) -> None:
        frame = decode_xbee(body)
        if not isinstance(frame, XBeeFault):
            self._host_until_ns = now_ns + _ABSENT_NS
        match frame:
            case AtCommand():
                status, value = self._obey(frame, now_ns)
                if frame.frame_id and not (frame.command == "ND" and status == AT_OK):
                    self._say(AtResponse(frame_id=frame.frame_id, command=frame.command, status=status, value=value))
                if not frame.is_queued or frame.command == "AC":
                    self._apply(now_ns)
            case TransmitRequest():
                self._transmit(frame)
            case XBeeFault():
                self.faults[frame.value] += 1
            case _:
                self.faults["wrong_direction"] += 1

    def _obey(self, command: AtCommand, now_ns: int) -> tuple[int, bytes]:
        """Do an AT command; return status and value of the answer."""
        name, value = command.command, command.value
        match name:
            case "AC" | "CN":
                pass
            case "WR":
                self.settings.write()
            case "RE":
                self.settings.restore()
            case "FR":
                self._restarts_at_ns = now_ns
            case "NR":
                self._form(now_ns)
            case "ND":
                self._discover(value, command.frame_id, now_ns)
            case _ if value:
                before = self.settings.read(name)
                status = self.settings.change(name, value)
                if status == AT_OK and name in NETWORK and self.settings.read(name) != before:
                    self._is_to_form = True
                return status, b""
            case _:
                given = self._read(name)
                return (AT_BAD_COMMAND, b"") if given is None else (AT_OK, given)
        return AT_OK, b""

    def _obey_text(self, name: str, value: bytes, now_ns: int) -> tuple[int, bytes]:
        if name == "ND":
            return AT_BAD_COMMAND, b""
        return self._obey(AtCommand(frame_id=0, command=name, value=value), now_ns)

    def _read(self, name: str) -> bytes | None:
        config, is_up = self.config, self._association == ASSOCIATED
        numbers = {
            "AI": (self._association, 1),
            "CH": (config.channel if is_up else 0, 1),
            "DB": (0x3C, 1),
            "HV": (config.hardware, 2),
            "MY": (0 if is_up else UNKNOWN16, 2),
            "NP": (_LONGEST_PAYLOAD, 2),
            "OI": (config.pan_id if is_up else 0xFFFF, 2),
            "OP": ((self.settings.number("ID") or config.pan_id) if is_up else 0, 8),
            "SH": (config.eui64 >> 32, 4),
            "SL": (config.eui64 & 0xFFFF_FFFF, 4),
            "VR": (config.firmware, 2),
        }
        if name in numbers:
            number, size = numbers[name]
            return number.to_bytes(size, "big")
        return self.settings.read(name)

    def _apply(self, now_ns: int) -> None:
        """Let what was set take effect: the mode, in which the answer did not yet go out, and the network."""
        if self._is_to_form:
            self._form(now_ns)
        if self.settings.number("AP") != self._mode:
            self._speak()
            if self._mode:
                self._host_until_ns = now_ns + _ABSENT_NS

    def _speak(self) -> None:
        self._mode = self.settings.number("AP")
        self._decoder = make_decoder(is_escaped=self._mode == 2)

    def _form(self, now_ns: int) -> None:
        self._is_to_form = False
        self._association = _SCANNING
        self._form_at_ns = now_ns + _FORMING_NS

    def _transmit(self, request: TransmitRequest) -> None:
        address = self._resolve(request)
        refusal = None
        if self._association != ASSOCIATED:
            refusal = _NO_NETWORK
        elif request.endpoints is not None and request.endpoints.profile == ZDO_PROFILE:
            refusal = _NO_ENDPOINT  # backpacks here have no ZigBee device object to talk to
        elif len(request.payload) > _LONGEST_PAYLOAD:
            refusal = _TOO_LARGE
        elif request.destination64 in {0, self.config.eui64} or (request.destination64 == UNKNOWN64 and request.destination16 == 0):
            refusal = _SELF
        elif address is None:
            refusal = _NOT_KNOWN
        elif len(self._in_radio) >= _RADIO_QUEUE:
            refusal = _NO_BUFFER
        if refusal is not None or address is None:
            self._say_status(request.frame_id, refusal or _NOT_KNOWN, NOT_DELIVERED16)
            return
        self._request(request.frame_id, address, request.payload)

    def _request(self, frame_id: int, address: int, payload: bytes) -> None:
        self._next_handle = (self._next_handle + 1) % (1 << 16)
        self._in_radio[self._next_handle] = (frame_id, UNKNOWN16 if address == BROADCAST_ADDRESS else address)
        self.requests.append(RadioSend(handle=self._next_handle, destination=ShortAddress(address), payload=payload))

    def _resolve(self, request: TransmitRequest) -> int | None:
        if request.destination64 == BROADCAST64:
            return BROADCAST_ADDRESS
        known = self._nodes.get(request.destination64)
        if known is not None:
            return known
        if request.destination16 >= 0xFFFC and request.destination64 == UNKNOWN64 and request.destination16 != UNKNOWN16:
            return BROADCAST_ADDRESS
        return None if request.destination16 == UNKNOWN16 else request.destination16

    def _send_transparently(self, data: bytes) -> None:
        """Send to ``DH`` and ``DL``, as with ``RO`` = 0; at the factory that is the coordinator, which is this module itself."""
        destination64 = self.settings.number("DH") << 32 | self.settings.number("DL")
        for at in range(0, len(data), _LONGEST_PAYLOAD):
            piece = data[at : at + _LONGEST_PAYLOAD]
            request = TransmitRequest(frame_id=0, destination64=destination64, destination16=UNKNOWN16, payload=piece)
            address = self._resolve(request)
            if destination64 == 0 or address is None or self._association != ASSOCIATED or len(self._in_radio) >= _RADIO_QUEUE:
                self.faults["transparent"] += 1
            else:
                self._request(0, address, piece)

    def _discover(self, wanted: bytes, frame_id: int, now_ns: int) -> None:
        self._discovery_id = frame_id
        self._found.clear()
        for eui64, address in self._nodes.items():
            name = _name_of(eui64)
            if wanted in {b"", name, eui64.to_bytes(8, "big")}:
                head = address.to_bytes(2, "big") + eui64.to_bytes(8, "big") + name + b"\0"
                self._found.append(head + bytes([0, 0, _ROUTER, 0]) + (0xC105).to_bytes(2, "big") + (0x101E).to_bytes(2, "big"))
        self._find_at_ns = now_ns + _DISCOVERY_NS

    def _know(self, eui64: int, address: int) -> None:
        self._nodes.pop(eui64, None)
        self._nodes[eui64] = address
        while len(self._nodes) > _MAX_NODES:
            del self._nodes[next(iter(self._nodes))]

    def _say_status(self, frame_id: int, delivery: int, address: int) -> None:
        if frame_id:
            self._say(TransmitStatus(frame_id=frame_id, destination16=address, retries=0, delivery=delivery, discovery=0))

    def _say(self, frame: FromModule) -> None:
        if self._mode == 0:
            return  # a module in transparent mode says nothing of itself
        if len(self._out) > _MAX_SAID:
            self.faults["answer_lost"] += 1
            return
        self._out += encode_frame(encode_xbee(frame), is_escaped=self._mode == 2)


def _name_of(eui64: int) -> bytes:
    return b"BP%d" % (eui64 & 0xFFFF)
