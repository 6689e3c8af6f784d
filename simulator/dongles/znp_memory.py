"""The non-volatile memory of a virtual Z-Stack dongle: items with numbers, as OSAL keeps them [SWRA198, 3.8]. No I/O."""

from dataclasses import dataclass, field

from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.frames import Reply, Request
from firmware_protocol.znp.numbers import CLEAR_CONFIG, CLEAR_STATE, Command, NvItem, ZnpStatus

_MAX_ITEMS = 256
_MAX_LENGTH = 512
_LONGEST_READ = 246
"""An answer's data less status and length, of 250 with a margin as the firmware has it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZnpNetwork:
    """The network that a dongle has formed, and takes up again after a reset."""

    pan_id: int
    channel: int


@dataclass(slots=True, kw_only=True)
class ZnpMemory:
    """See the module. ``factory`` is what is written where there is nothing, and after the configuration was cleared."""

    factory: dict[int, bytes]
    items: dict[int, bytes] = field(default_factory=dict)
    extended: dict[tuple[int, int, int], bytes] = field(default_factory=dict)
    """Items of the newer layout, by system, item and sub-item; empty in a chip that has none."""
    network: ZnpNetwork | None = None

    def __post_init__(self) -> None:
        self.items = self.factory | self.items

    def __getitem__(self, item: NvItem) -> int:
        """Return an item as an integer; 0 where there is none."""
        return int.from_bytes(self.items.get(item, b""), "little")

    def obey_startup_option(self) -> None:
        """Forget the network, or all that hosts have changed in the factory's items, where ``STARTUP_OPTION`` says so."""
        option = self[NvItem.STARTUP_OPTION]
        if option & CLEAR_STATE:
            self.network = None
            self._note_network(0)
        if option & CLEAR_CONFIG:
            self.items |= self.factory
            self._note_network(int(self.network is not None))
        self.items[NvItem.STARTUP_OPTION] = b"\x00"

    def found(self, network: ZnpNetwork) -> None:
        """Keep a network that was formed."""
        self.network = network
        self._note_network(1)

    def answer(self, request: Request) -> Reply | None:
        """Return the answer to a request that is about the memory, None to any other."""
        match request:
            case znp.NvInitRequest():
                return self._create(request)
            case znp.NvReadRequest():
                return self._read(request)
            case znp.NvWriteRequest():
                return self._write(request)
            case znp.NvDeleteRequest():
                return self._delete(request)
            case znp.NvLengthRequest():
                return znp.NvLengthReply(length=len(self.items.get(request.item, b"")))
            case znp.ExtendedNvLengthRequest() if self.extended:
                key = (request.system, request.item, request.sub_item)
                return znp.ExtendedNvLengthReply(length=len(self.extended.get(key, b"")))
            case znp.ExtendedNvReadRequest() if self.extended:
                return self._read_extended(request)
            case _:
                return None

    def _create(self, request: znp.NvInitRequest) -> znp.StatusReply:
        """Make an item where there is none."""
        status = ZnpStatus.SUCCESS
        if request.item not in self.items:
            has_room = len(self.items) < _MAX_ITEMS and len(request.value) <= request.length <= _MAX_LENGTH
            status = ZnpStatus.NV_ITEM_UNINITIALIZED if has_room else ZnpStatus.NV_OPERATION_FAILED
            if has_room:
                self.items[request.item] = request.value.ljust(request.length, b"\xff")
        return znp.StatusReply(command=Command.SYS_OSAL_NV_ITEM_INIT, status=status)

    def _read(self, request: znp.NvReadRequest) -> znp.NvReadReply:
        """Return an item from an offset on."""
        value = self.items.get(request.item)
        if value is None:
            return znp.NvReadReply(status=ZnpStatus.NV_OPERATION_FAILED, value=b"")
        if request.offset >= len(value):
            return znp.NvReadReply(status=ZnpStatus.INVALID_PARAMETER, value=b"")
        return znp.NvReadReply(status=ZnpStatus.SUCCESS, value=value[request.offset : request.offset + _LONGEST_READ])

    def _read_extended(self, request: znp.ExtendedNvReadRequest) -> znp.ExtendedNvReadReply:
        value = self.extended.get((request.system, request.item, request.sub_item))
        if value is None:
            return znp.ExtendedNvReadReply(status=ZnpStatus.NV_OPERATION_FAILED, value=b"")
        end = request.offset + min(request.length, _LONGEST_READ)
        if end > len(value):
            return znp.ExtendedNvReadReply(status=ZnpStatus.INVALID_PARAMETER, value=b"")
        return znp.ExtendedNvReadReply(status=ZnpStatus.SUCCESS, value=value[request.offset : end])

    def _write(self, request: znp.NvWriteRequest) -> znp.StatusReply:
        """Write into an item that is there and long enough."""
        value = self.items.get(request.item)
        end = request.offset + len(request.value)
        status = ZnpStatus.SUCCESS
        if value is None:
            status = ZnpStatus.NV_OPERATION_FAILED
        elif end > len(value):
            status = ZnpStatus.INVALID_PARAMETER
        else:
            self.items[request.item] = value[: request.offset] + request.value + value[end:]
        return znp.StatusReply(command=Command.SYS_OSAL_NV_WRITE, status=status)

    def _delete(self, request: znp.NvDeleteRequest) -> znp.StatusReply:
        """Delete an item whose length the host knows."""
        value = self.items.get(request.item)
        status = ZnpStatus.SUCCESS
        if value is None:
            status = ZnpStatus.NV_ITEM_UNINITIALIZED
        elif len(value) != request.length:
            status = ZnpStatus.NV_OPERATION_FAILED
        else:
            del self.items[request.item]
        return znp.StatusReply(command=Command.SYS_OSAL_NV_DELETE, status=status)

    def _note_network(self, value: int) -> None:
        if NvItem.BDB_IS_ON_NETWORK in self.items:
            self.items[NvItem.BDB_IS_ON_NETWORK] = bytes((value,))
