"""The C link and the coordinator firmware, out of the library that ``c_wire.py`` compiles, as Python objects."""

import ctypes
from dataclasses import dataclass
from enum import IntEnum

from studies.c_wire import Wire

_HOST_UART_SIZE = 65536
_WINDOW = 16
_COUNTERS = ("bad_frames", "bad_envelopes", "refused_payloads", "lost_reports")


class LinkEventKind(IntEnum):
    """What ``bb_link_receive`` and ``bb_link_poll`` tell."""

    NOTHING = 0
    OPENED = 1
    PAYLOAD = 2
    CONFIRMED = 3
    LOST = 4


class _LinkEvent(ctypes.Structure):
    _fields_ = (
        ("payload", ctypes.c_void_p),
        ("receipt", ctypes.c_uint16),
        ("length", ctypes.c_uint8),
        ("kind", ctypes.c_uint8),
        ("n_confirmed", ctypes.c_uint8),
        ("reason", ctypes.c_uint8),
        ("n_dropped", ctypes.c_uint16),
        ("tags", ctypes.c_uint16 * _WINDOW),
    )


class _Sent(ctypes.Structure):
    _fields_ = (
        ("handle", ctypes.c_uint16),
        ("destination", ctypes.c_uint16),
        ("length", ctypes.c_uint8),
        ("payload", ctypes.c_uint8 * 57),
    )


class _Counters(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_uint16) for name in _COUNTERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkEvent:
    """An event of the C link."""

    kind: LinkEventKind
    payload: bytes = b""
    receipt: int = 0
    reason: int = 0
    tags: tuple[int, ...] = ()


class CLink:
    """``bb_link``, either role. Frames are bodies."""

    def __init__(self, wire: Wire, *, is_initiator: bool, queue_size: int = 4096) -> None:
        self._library = wire.library
        self._library.bb_link_next_frame.restype = ctypes.c_uint8
        for name in ("bb_link_send_tagged", "bb_link_next_deadline"):
            getattr(self._library, name).restype = ctypes.c_bool
        self._memory = ctypes.create_string_buffer(256)
        self._queue = ctypes.create_string_buffer(queue_size)
        self._frame = ctypes.create_string_buffer(256)
        self._body = ctypes.create_string_buffer(256)
        self._library.bb_link_start(self._memory, ctypes.c_uint8(is_initiator), self._queue, ctypes.c_uint16(queue_size))

    def open(self, *, session: int, now_ms: int) -> int:
        """Begin a session; return how many payloads it dropped."""
        return int(self._library.bb_link_open(self._memory, ctypes.c_uint16(session), ctypes.c_uint32(now_ms))) & 0xFFFF

    def announce_restart(self) -> None:
        """Say that this end knows no session."""
        self._library.bb_link_announce_restart(self._memory)

    def send(self, payload: bytes, *, tag: int = 0, is_urgent: bool = False) -> bool:
        """Queue a payload; False: no room."""
        taken = self._library.bb_link_send_tagged(
            self._memory, ctypes.c_uint16(tag), payload, ctypes.c_uint8(len(payload)), ctypes.c_bool(is_urgent)
        )
        return bool(taken)

    def receive(self, body: bytes, *, now_ms: int) -> LinkEvent:
        """Take a frame body."""
        event = _LinkEvent()
        ctypes.memmove(self._body, body, len(body))
        self._library.bb_link_receive(self._memory, self._body, ctypes.c_uint8(len(body)), ctypes.c_uint32(now_ms), ctypes.byref(event))
        return _told(event)

    def poll(self, *, now_ms: int) -> LinkEvent:
        """Do what is due."""
        event = _LinkEvent()
        self._library.bb_link_poll(self._memory, ctypes.c_uint32(now_ms), ctypes.byref(event))
        return _told(event)

    def confirm(self, receipt: int) -> None:
        """Acknowledge up to a receipt."""
        self._library.bb_link_confirm(self._memory, ctypes.c_uint16(receipt))

    def take_frames(self, *, now_ms: int) -> list[bytes]:
        """Return all frame bodies that are to be sent now."""
        frames = []
        while length := self._library.bb_link_next_frame(self._memory, self._frame, ctypes.c_uint32(now_ms)):
            frames.append(self._frame.raw[:length])
        return frames

    def next_deadline_ms(self, *, now_ms: int) -> int | None:
        """Return when ``poll`` has something to do."""
        at = ctypes.c_uint32()
        is_set = self._library.bb_link_next_deadline(self._memory, ctypes.c_uint32(now_ms), ctypes.byref(at))
        return at.value if is_set else None


def _told(event: _LinkEvent) -> LinkEvent:
    kind = LinkEventKind(event.kind)
    if kind is LinkEventKind.PAYLOAD:
        return LinkEvent(kind=kind, payload=ctypes.string_at(event.payload, event.length), receipt=event.receipt)
    if kind is LinkEventKind.CONFIRMED:
        return LinkEvent(kind=kind, tags=tuple(event.tags[: event.n_confirmed]))
    return LinkEvent(kind=kind, reason=event.reason if kind is LinkEventKind.LOST else 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """A payload that the firmware gave to its radio."""

    handle: int
    destination: int
    payload: bytes


class CCoordinator:
    """The coordinator firmware on the port of tests; there is one in a process, and a new one of these starts it anew."""

    def __init__(self, wire: Wire) -> None:
        self._library = wire.library
        for name in ("radio_received", "node_joined", "log", "is_open", "next_deadline"):
            getattr(self._library, f"bb_coordinator_{name}").restype = ctypes.c_bool
        self._library.bb_host_take_uart.restype = ctypes.c_uint16
        self._library.bb_host_take_sent.restype = ctypes.c_bool
        self._library.bb_coordinator_counters.restype = ctypes.POINTER(_Counters)
        self._uart = ctypes.create_string_buffer(_HOST_UART_SIZE)
        self._library.bb_host_start()
        self._library.bb_coordinator_start()

    def restart(self) -> None:
        """Reset the firmware; what it held is gone."""
        self._library.bb_host_start()
        self._library.bb_coordinator_start()

    @property
    def is_open(self) -> bool:
        """A base station is connected."""
        return bool(self._library.bb_coordinator_is_open())

    def set_now_ms(self, now_ms: int) -> None:
        """Set the clock."""
        self._library.bb_host_set_now_ms(ctypes.c_uint32(now_ms))

    def set_uart_room(self, room: int) -> None:
        """Let the serial line take so many bytes from now on."""
        self._library.bb_host_set_uart_room(ctypes.c_uint16(room))

    def set_radio_room(self, n_payloads: int) -> None:
        """Let the radio hold so many payloads."""
        self._library.bb_host_set_radio_room(ctypes.c_uint8(n_payloads))

    def feed(self, chunk: bytes) -> None:
        """Take bytes from the serial line."""
        for start in range(0, len(chunk), 0x8000):
            part = chunk[start : start + 0x8000]
            self._library.bb_coordinator_uart_received(part, ctypes.c_uint16(len(part)))

    def take_bytes(self) -> bytes:
        """Do what is due, and return what goes out over the serial line."""
        self._library.bb_coordinator_poll()
        length = self._library.bb_host_take_uart(self._uart, ctypes.c_uint16(0xFFFF))
        return self._uart.raw[:length]

    def take_sent(self) -> list[Sent]:
        """Return what the radio was given to send."""
        sent = []
        one = _Sent()
        while self._library.bb_host_take_sent(ctypes.byref(one)):
            sent.append(Sent(handle=one.handle, destination=one.destination, payload=bytes(one.payload[: one.length])))
        return sent

    def take_from_radio(self, payload: bytes, *, source: int, rssi_dbm: int, lqi: int) -> bool:
        """Hear a payload; False: no room."""
        return bool(
            self._library.bb_coordinator_radio_received(
                ctypes.c_uint16(source), ctypes.c_int8(rssi_dbm), ctypes.c_uint8(lqi), payload, ctypes.c_uint8(len(payload))
            )
        )

    def confirm(self, handle: int, status: int) -> None:
        """Say what became of a payload that the radio was given."""
        self._library.bb_coordinator_radio_sent(ctypes.c_uint16(handle), ctypes.c_uint8(status))

    def node_joined(self, address: int, eui64: int) -> bool:
        """Say that a node has joined; False: no room."""
        return bool(self._library.bb_coordinator_node_joined(ctypes.c_uint16(address), eui64.to_bytes(8, "little")))

    def log(self, *, level: int, code: int, text: bytes) -> bool:
        """Write a line to the base station's log; False: no room, or too long."""
        return bool(self._library.bb_coordinator_log(ctypes.c_uint8(level), ctypes.c_uint16(code), text, ctypes.c_uint8(len(text))))

    def counters(self) -> dict[str, int]:
        """Return what was counted."""
        counters = self._library.bb_coordinator_counters().contents
        return {name: getattr(counters, name) for name in _COUNTERS}
