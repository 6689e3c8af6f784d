"""The commands of a Z-Stack network processor as values (WIRE_FORMAT.md §9.2), for either end of the line.

Field by field as TI's "Z-Stack Monitor and Test API" (SWRA198, revision 1.14) lays them out; integers are little-endian, EUI-64s too. What
comes in and is none of these is a fault value; bytes behind the last field are those of a newer firmware and are ignored. Requests whose
answer is a status alone are answered by ``StatusReply``, which names what it answers.
"""

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias


class ZnpFault(Enum):
    """Why an MT body is no command of these."""

    UNKNOWN_COMMAND = "unknown_command"
    BAD_LENGTH = "bad_command_length"


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusReply:
    """Answer ``command``, a request with a status and nothing else."""

    command: int
    status: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RpcError:
    """Say that a request could not be understood: error 1 no such subsystem, 2 no such command, 3 a parameter, 4 its length."""

    error: int
    command: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ResetRequest:
    """Restart: kind 0 as the reset pin does, boot loader and all, 1 the stack alone. Not answered but by ``ResetIndication``."""

    kind: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ResetIndication:
    """Say that the device has just started; reason 0 power, 1 the pin, 2 the watchdog."""

    reason: int
    transport: int
    product: int
    major: int
    minor: int
    hardware: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PingRequest:
    """Ask whether anybody is there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PingReply:
    """Answer with a bit for each subsystem that is compiled in."""

    capabilities: int


@dataclass(frozen=True, slots=True, kw_only=True)
class VersionRequest:
    """Ask for the firmware."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VersionReply:
    """Tell the firmware: product 0 is Z-Stack 1.2, 1 Z-Stack 3.x.0 (CC26xx), 2 Z-Stack 3.0.x (CC253x); ``revision`` is its date."""

    transport: int
    product: int
    major: int
    minor: int
    maintenance: int
    revision: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedAddressRequest:
    """Ask for the EUI-64."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedAddressReply:
    """Tell the EUI-64."""

    eui64: int


@dataclass(frozen=True, slots=True, kw_only=True)
class NvInitRequest:
    """Make an item where there is none; status 0x09 says that it was made, 0 that it was there."""

    item: int
    length: int
    value: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class NvReadRequest:
    """Ask for an item from an offset on."""

    item: int
    offset: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class NvReadReply:
    """Tell what the item holds, where ``status`` is 0."""

    status: int
    value: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class NvWriteRequest:
    """Write an item from an offset on; it must be there and long enough."""

    item: int
    offset: int = 0
    value: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class NvDeleteRequest:
    """Delete an item of this length."""

    item: int
    length: int


@dataclass(frozen=True, slots=True, kw_only=True)
class NvLengthRequest:
    """Ask how long an item is."""

    item: int


@dataclass(frozen=True, slots=True, kw_only=True)
class NvLengthReply:
    """Tell it; 0 where there is no such item."""

    length: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedNvLengthRequest:
    """Ask how long an item of the memory's newer layout is (CC26xx)."""

    system: int
    item: int
    sub_item: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedNvLengthReply:
    """Tell it; 0 where there is no such item."""

    length: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedNvReadRequest:
    """Ask for a piece of an item of the memory's newer layout."""

    system: int
    item: int
    sub_item: int
    offset: int
    length: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedNvReadReply:
    """Tell what it holds."""

    status: int
    value: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterRequest:
    """Register an endpoint with its profile and clusters; messages for others never reach the base station."""

    endpoint: int
    profile: int
    device: int
    device_version: int
    latency: int
    in_clusters: tuple[int, ...]
    out_clusters: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DataRequest:
    """Send data to an endpoint of a node; the status says whether the radio took it, ``DataConfirm`` what became of it."""

    destination: int
    destination_endpoint: int
    source_endpoint: int
    cluster: int
    transaction: int
    options: int
    radius: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class DataConfirm:
    """Say what became of a ``DataRequest`` that the radio took."""

    status: int
    endpoint: int
    transaction: int


@dataclass(frozen=True, slots=True, kw_only=True)
class IncomingMessage:
    """Hand over data that came in over the air."""

    group: int
    cluster: int
    source: int
    source_endpoint: int
    destination_endpoint: int
    was_broadcast: int
    lqi: int
    security: int
    timestamp: int
    sequence: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class StartupRequest:
    """Take up the network of before, or form one; status 0: that of before, 1: a new one, 2: neither."""

    delay_ms: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StateChange:
    """Say that the device is in another state."""

    state: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceAnnounced:
    """Say that a node has joined, or joined again, and told both its addresses."""

    source: int
    address: int
    eui64: int
    capabilities: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceTrusted:
    """Say that the trust centre has let a node in."""

    address: int
    eui64: int
    parent: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PermitJoinRequest:
    """Open or close the network: for ``duration_s`` seconds, 0 closes, at most 254; mode 0x02 one node, 0x0F a broadcast address."""

    address_mode: int
    destination: int
    duration_s: int
    trust_center: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PermitJoinAnswered:
    """Say that a node has obeyed ``PermitJoinRequest``."""

    source: int
    status: int


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkInfoRequest:
    """Ask for the network."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkInfoReply:
    """Tell the network."""

    address: int
    state: int
    pan_id: int
    parent: int
    extended_pan_id: int
    extended_parent: int
    channel: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceInfoRequest:
    """Ask for the device's addresses and state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceInfoReply:
    """Tell them."""

    status: int
    eui64: int
    address: int
    kind: int
    state: int
    associated: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociatedRequest:
    """Ask for the entry of the table of associated devices with this index."""

    index: int


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociatedReply:
    """Tell it as it stands in the chip's memory: 28 octets where structures are packed, as on a CC253x, 36 where they are aligned."""

    entry: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class CommissioningRequest:
    """Start a commissioning of Z-Stack 3."""

    mode: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CommissioningReport:
    """Say how a commissioning goes; ``remaining`` are the modes still to come."""

    status: int
    mode: int
    remaining: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SetChannelRequest:
    """Say which channels a formation may use, a bit for each (Z-Stack 3): the primary ones, or the secondary ones."""

    is_primary: int
    channels: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RequireKeyExchangeRequest:
    """Say whether a node that joined must exchange keys before long or is thrown out (Z-Stack 3)."""

    is_required: int


Request: TypeAlias = (
    ResetRequest | PingRequest | VersionRequest | ExtendedAddressRequest | NvInitRequest | NvReadRequest | NvWriteRequest
    | NvDeleteRequest | NvLengthRequest | ExtendedNvLengthRequest | ExtendedNvReadRequest | RegisterRequest | DataRequest
    | StartupRequest | PermitJoinRequest | NetworkInfoRequest | DeviceInfoRequest | AssociatedRequest | CommissioningRequest
    | SetChannelRequest | RequireKeyExchangeRequest
)  # fmt: skip
"""What the base station says."""

Reply: TypeAlias = (
    StatusReply | RpcError | PingReply | VersionReply | ExtendedAddressReply | NvReadReply | NvLengthReply | ExtendedNvLengthReply
    | ExtendedNvReadReply | NetworkInfoReply | DeviceInfoReply | AssociatedReply
)  # fmt: skip
"""What answers a request."""

Report: TypeAlias = (
    ResetIndication | DataConfirm | IncomingMessage | StateChange | DeviceAnnounced | DeviceTrusted | PermitJoinAnswered
    | CommissioningReport
)  # fmt: skip
"""What the device says of itself."""
