"""Z-Stack as it runs in a virtual dongle between two resets: its network, its endpoints, its answers (WIRE_FORMAT.md §9). No I/O, no clock.

All that is in here is lost at a reset; what outlives it is in the ``ZnpMemory`` that it is given.
"""

from collections import Counter, deque
from dataclasses import dataclass, field
from enum import Enum

from firmware_protocol.envelope import RadioReceived, RadioSend, RadioStatus
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import NS_PER_MS, ShortAddress
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import Message
from firmware_protocol.znp.frames import Reply, Request
from firmware_protocol.znp.numbers import (
    BDB_FORMATION,
    BIOBOT_CLUSTER,
    BIOBOT_ENDPOINT,
    BIOBOT_PROFILE,
    COORDINATOR_TYPE,
    Command,
    DeviceState,
    NvItem,
    ZnpStatus,
)
from simulator.dongles.znp_memory import ZnpMemory, ZnpNetwork

_RESTORING_NS = 300 * NS_PER_MS
_FORMING_NS = 900 * NS_PER_MS
_RADIO_QUEUE = 16
_N_HANDLES = 1 << 16
_TICK_NS = 320_000
"""Unit of timestamps: a back-off period of IEEE 802.15.4 at 2.4 GHz."""
_NO_ADDRESS = 0xFFFE
_NOBODY = _NO_ADDRESS.to_bytes(2, "little")
"""Beginning of a table entry that holds no device."""
_ALL_KINDS = 7
_ANY_PAN = 0xFFFF

_STATUS_OF = {
    RadioStatus.SENT: ZnpStatus.SUCCESS,
    RadioStatus.NO_ACK: ZnpStatus.MAC_NO_ACK,
    RadioStatus.CHANNEL_BUSY: ZnpStatus.MAC_CHANNEL_ACCESS_FAILURE,
    RadioStatus.UNKNOWN_ADDRESS: ZnpStatus.NWK_NO_ROUTE,
    RadioStatus.QUEUE_FULL: ZnpStatus.BUFFER_FULL,
    RadioStatus.TOO_LONG: ZnpStatus.MAC_FRAME_TOO_LONG,
    RadioStatus.OTHER: ZnpStatus.FAILURE,
}


class ZStack(Enum):
    """Which firmware it is."""

    V1_2 = "Z-Stack 1.2, as on a CC2531"
    V3_X_0 = "Z-Stack 3.x.0, as on a CC2652"

    @property
    def version(self) -> znp.VersionReply:
        """What it says of itself."""
        if self is ZStack.V1_2:
            return znp.VersionReply(transport=2, product=0, major=2, minor=6, maintenance=3, revision=20201127)
        return znp.VersionReply(transport=2, product=1, major=2, minor=7, maintenance=1, revision=20210708)

    @property
    def capabilities(self) -> int:
        """A bit for each subsystem that is compiled in."""
        return 0x0179 if self is ZStack.V1_2 else 0x0659

    @property
    def entry_size(self) -> int:
        """Octets of an entry in the table of associated devices, packed or aligned."""
        return 28 if self is ZStack.V1_2 else 36


@dataclass(slots=True, kw_only=True)
class ZnpStack:
    """See the module. ``requests`` are what the host wants sent over the air."""

    firmware: ZStack
    memory: ZnpMemory
    pan_id: int
    """The one it chooses where it may."""
    requests: deque[RadioSend]
    faults: Counter[str]
    _state: DeviceState = DeviceState.HOLD
    _up_at_ns: int | None = None
    _is_commissioning: bool = False
    _primary_channels: int = 0
    _endpoints: dict[int, znp.RegisterRequest] = field(default_factory=dict)
    _in_radio: dict[int, znp.DataRequest] = field(default_factory=dict)
    """What is under way, by its handle."""
    _next_handle: int = 0
    _n_heard: int = 0

    @property
    def is_registered(self) -> bool:
        """A base station of biobots has registered its endpoint, and the network is up."""
        ours = self._endpoints.get(BIOBOT_ENDPOINT)
        is_ours = ours is not None and ours.profile == BIOBOT_PROFILE and BIOBOT_CLUSTER in ours.in_clusters
        return is_ours and self._state is DeviceState.COORDINATOR

    @property
    def up_at_ns(self) -> int | None:
        """When ``come_up`` is to be called, or None."""
        return self._up_at_ns

    def answer(self, request: Request, *, now_ns: int) -> list[Message]:
        """Return the answer to a request and what it brings about at once; nothing where this firmware does not know the request."""
        match request:
            case znp.RegisterRequest():
                return [self._register(request)]
            case znp.DataRequest():
                return self._send(request)
            case znp.StartupRequest():
                return self._start_up(now_ns)
            case znp.PermitJoinRequest():
                return [_status(Command.ZDO_MGMT_PERMIT_JOIN_REQ), znp.PermitJoinAnswered(source=0, status=0)]
            case znp.SetChannelRequest() | znp.CommissioningRequest() | znp.RequireKeyExchangeRequest():
                return [] if self.firmware is ZStack.V1_2 else self._commission(request, now_ns)
            case _:
                told = self._tell(request) or self.memory.answer(request)
                return [] if told is None else [told]

    def come_up(self) -> list[Message]:
        """Let the network that was taken up or formed be there."""
        network = self.memory.network
        self._up_at_ns = None
        if network is None:
            network = self._form()
        self._state = DeviceState.COORDINATOR
        said: list[Message] = [znp.StateChange(state=self._state)]
        if self._is_commissioning:
            said.append(znp.CommissioningReport(status=0, mode=BDB_FORMATION, remaining=0))
        self._is_commissioning = False
        return said

    def hear(self, received: RadioReceived, *, now_ns: int) -> znp.IncomingMessage:
        """Return what the host is told of a payload from the air."""
        self._n_heard += 1
        return znp.IncomingMessage(
            group=0, cluster=BIOBOT_CLUSTER, source=received.source, source_endpoint=BIOBOT_ENDPOINT, destination_endpoint=BIOBOT_ENDPOINT,
            was_broadcast=0, lqi=received.lqi, security=0, timestamp=now_ns // _TICK_NS % (1 << 32), sequence=self._n_heard % 256,
            data=received.payload,
        )  # fmt: skip

    def confirm(self, handle: int, status: RadioStatus) -> list[Message]:
        """Return what the host is told of a request that is done; nothing where it is one from before a reset."""
        sent = self._in_radio.pop(handle, None)
        if sent is None:
            self.faults["forgotten_request"] += 1
            return []
        return [znp.DataConfirm(status=_STATUS_OF[status], endpoint=sent.source_endpoint, transaction=sent.transaction)]

    def see(self, address: ShortAddress, *, eui64: int) -> list[Message]:
        """Return what the host is told of a node that has joined: nothing unless it wants to be told."""
        if self._state is not DeviceState.COORDINATOR or self.memory[NvItem.ZDO_DIRECT_CB] != 1:
            return []
        return [
            znp.DeviceTrusted(address=address, eui64=eui64, parent=0),
            znp.DeviceAnnounced(source=address, address=address, eui64=eui64, capabilities=0x80),
        ]

    def _tell(self, request: Request) -> Reply | None:
        """Return the answer to a request that changes nothing, None to any other."""
        match request:
            case znp.PingRequest():
                return znp.PingReply(capabilities=self.firmware.capabilities)
            case znp.VersionRequest():
                return self.firmware.version
            case znp.ExtendedAddressRequest():
                return znp.ExtendedAddressReply(eui64=self.memory[NvItem.EXTADDR])
            case znp.DeviceInfoRequest():
                return self._device_info()
            case znp.NetworkInfoRequest():
                return self._network_info()
            case znp.AssociatedRequest():
                return znp.AssociatedReply(entry=_NOBODY.ljust(self.firmware.entry_size, b"\x00"))
            case _:
                return None

    def _device_info(self) -> znp.DeviceInfoReply:
        return znp.DeviceInfoReply(
            status=0, eui64=self.memory[NvItem.EXTADDR], address=self._address, kind=_ALL_KINDS, state=self._state, associated=()
        )  # fmt: skip

    def _network_info(self) -> znp.NetworkInfoReply:
        network = self.memory.network
        return znp.NetworkInfoReply(
            address=self._address, state=self._state, pan_id=network.pan_id if network else _ANY_PAN, parent=0,
            extended_pan_id=self.memory[NvItem.EXTADDR] if network else 0, extended_parent=0, channel=network.channel if network else 0,
        )  # fmt: skip

    @property
    def _address(self) -> int:
        return 0 if self._state is DeviceState.COORDINATOR else _NO_ADDRESS

    def _register(self, request: znp.RegisterRequest) -> Reply:
        if not 1 <= request.endpoint <= 240:
            return _status(Command.AF_REGISTER, ZnpStatus.INVALID_PARAMETER)
        if request.endpoint in self._endpoints:
            return _status(Command.AF_REGISTER, ZnpStatus.APS_DUPLICATE_ENTRY)
        self._endpoints[request.endpoint] = request
        return _status(Command.AF_REGISTER)

    def _send(self, request: znp.DataRequest) -> list[Message]:
        source = self._endpoints.get(request.source_endpoint)
        status = ZnpStatus.SUCCESS
        if source is None:
            status = ZnpStatus.INVALID_PARAMETER
        elif self._state is not DeviceState.COORDINATOR:
            status = ZnpStatus.NWK_INVALID_REQUEST
        elif len(request.data) > MAX_RADIO_PAYLOAD:
            status = ZnpStatus.MAC_FRAME_TOO_LONG
        elif len(self._in_radio) >= _RADIO_QUEUE:
            status = ZnpStatus.BUFFER_FULL
        reply = _status(Command.AF_DATA_REQUEST, status)
        if source is None or status is not ZnpStatus.SUCCESS:
            return [reply]
        if (source.profile, request.cluster, request.destination_endpoint) != (BIOBOT_PROFILE, BIOBOT_CLUSTER, BIOBOT_ENDPOINT):
            self.faults["foreign_request"] += 1  # no backpack has such an endpoint
            confirm = znp.DataConfirm(status=ZnpStatus.APS_NO_ACK, endpoint=request.source_endpoint, transaction=request.transaction)
            return [reply, confirm]
        handle = self._next_handle
        self._next_handle = (handle + 1) % _N_HANDLES
        self._in_radio[handle] = request
        self.requests.append(RadioSend(handle=handle, destination=ShortAddress(request.destination), payload=request.data))
        return [reply]

    def _start_up(self, now_ns: int) -> list[Message]:
        had_network = self.memory.network is not None
        if not had_network and self.firmware is not ZStack.V1_2:
            return [_status(Command.ZDO_STARTUP_FROM_APP, 2)]  # Z-Stack 3 forms networks by commissioning alone
        if self._state is DeviceState.COORDINATOR:
            return [_status(Command.ZDO_STARTUP_FROM_APP, 0)]
        self._up_at_ns = now_ns + (_RESTORING_NS if had_network else _FORMING_NS)
        self._state = DeviceState.COORDINATOR_STARTING
        return [_status(Command.ZDO_STARTUP_FROM_APP, 0 if had_network else 1), znp.StateChange(state=self._state)]

    def _commission(
        self, request: znp.SetChannelRequest | znp.CommissioningRequest | znp.RequireKeyExchangeRequest, now_ns: int
    ) -> list[Message]:
        match request:
            case znp.RequireKeyExchangeRequest():
                return [_status(Command.APP_CNF_BDB_SET_TC_REQUIRE_KEY_EXCHANGE)]
            case znp.SetChannelRequest(is_primary=is_primary, channels=channels):
                if is_primary:
                    self._primary_channels = channels
                return [_status(Command.APP_CNF_BDB_SET_CHANNEL)]
            case znp.CommissioningRequest(mode=mode):
                can_form = mode == BDB_FORMATION and self.memory[NvItem.LOGICAL_TYPE] == COORDINATOR_TYPE
                if not can_form or self._state is not DeviceState.HOLD:
                    return [_status(Command.APP_CNF_BDB_START_COMMISSIONING, ZnpStatus.INVALID_PARAMETER)]
                self._up_at_ns = now_ns + _FORMING_NS
                self._is_commissioning = True
                self._state = DeviceState.COORDINATOR_STARTING
                return [_status(Command.APP_CNF_BDB_START_COMMISSIONING), znp.StateChange(state=self._state)]

    def _form(self) -> ZnpNetwork:
        """Form a network on the lowest channel allowed."""
        allowed = self._primary_channels or self.memory[NvItem.CHANLIST]
        channel = next((one for one in range(11, 27) if allowed >> one & 1), 11)
        wanted = self.memory[NvItem.PANID]
        network = ZnpNetwork(pan_id=self.pan_id if wanted == _ANY_PAN else wanted, channel=channel)
        self.memory.found(network)
        return network


def _status(command: Command, status: int = ZnpStatus.SUCCESS) -> znp.StatusReply:
    return znp.StatusReply(command=command, status=status)
