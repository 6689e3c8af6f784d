"""One CAN bus through python-can, blocking: frames in and out, and what its errors mean. The only module that opens CAN."""

import contextlib
import errno
import fcntl
import logging
import os
import socket
from collections import Counter
from pathlib import Path

import can
from can.interfaces.slcan import slcanBus

from firmware_protocol.framing.can_frame import FD_SIZES, MAX_CLASSIC_DATA, CanFrame
from gateway.errors import TransportClosedError, TransportOpenError
from gateway.log import EventLog
from gateway.transports.can_spec import CanSpec

_log = EventLog(__name__)

_SERIAL_SEND_S = 5.0
_SEND_S = 0.05
"""How long one attempt to send may wait [s]; python-can's socketcan gives up at once all the same where the queue is full."""

_FULL = frozenset({errno.ENOBUFS, errno.EAGAIN})
_MANY_FD_CLOCK_HZ = 80_000_000  # any clock that divides into the rates: slcan takes nothing but the rates from it

# <linux/can/error.h>: classes in the identifier of an error frame, and the controller's troubles in its second byte.
_ERR_BUS_OFF, _ERR_CONTROLLER, _ERR_RESTARTED = 0x40, 0x04, 0x100
_PASSIVE, _WARNING = 0x10 | 0x20, 0x04 | 0x08


class CanBus:
    """An open bus. One thread receives, one sends.

    Parameters
    ----------
    bus
        Of python-can.
    lock
        A descriptor that keeps other processes off the adapter, or None.
    """

    def __init__(self, bus: can.BusABC, *, name: str, is_serial: bool = False, lock: int | None = None) -> None:
        self.faults: Counter[str] = Counter()
        """What came in and was no frame, by name."""
        self.state = "active"
        """Of the controller: active, warning or passive, as far as it tells."""
        self._bus = bus
        self._name = name
        self._send_s = _SERIAL_SEND_S if is_serial else _SEND_S
        self._lock = lock

    def receive(self, timeout_s: float) -> CanFrame | None:
        """Wait for a data frame with a 29-bit identifier; None: none came, or something else did.

        Raises
        ------
        TransportClosedError
            The adapter has gone, or its controller is bus-off.
        """
        try:
            message = self._bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            if isinstance(self._bus, slcanBus) and isinstance(error.__cause__, UnicodeDecodeError):
                self._bus.flush()  # else it would trip over the same characters for ever
                self.faults["line"] += 1
                return None
            raise self._gone(error) from error
        except (ValueError, IndexError):  # what python-can's slcan makes of a damaged line
            self.faults["line"] += 1
            return None
        if message is None:
            return None
        if message.is_error_frame:
            self._take_error(message)
            return None
        size = len(message.data)
        if message.is_remote_frame or not message.is_extended_id:
            return None
        if size != message.dlc or (size not in FD_SIZES if message.is_fd else size > MAX_CLASSIC_DATA):
            self.faults["length"] += 1
            return None
        return CanFrame(can_id=message.arbitration_id, data=bytes(message.data), is_fd=message.is_fd)

    def send(self, frame: CanFrame) -> bool:
        """Hand a frame to the controller; False: its queue is full, try again soon.

        Raises
        ------
        TransportClosedError
            The adapter has gone, or takes nothing.
        """
        message = can.Message(
            arbitration_id=frame.can_id, data=frame.data, is_extended_id=True, is_fd=frame.is_fd, bitrate_switch=frame.is_fd
        )
        try:
            self._bus.send(message, timeout=self._send_s)
        except can.CanOperationError as error:
            if error.error_code in _FULL or "buffer full" in str(error):
                self.faults["queue_full"] += 1
                return False
            raise self._gone(error) from error
        except (can.CanError, OSError) as error:
            raise self._gone(error) from error
        return True

    def close(self) -> None:
        """Close, however ill the adapter is."""
        with contextlib.suppress(can.CanError, OSError, ValueError):
            self._bus.shutdown()
        if isinstance(self._bus, slcanBus):  # it leaves its port open where its last command fails
            with contextlib.suppress(OSError):
                self._bus.serialPortOrig.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _take_error(self, message: can.Message) -> None:
        classes = message.arbitration_id
        self.faults["error_frame"] += 1
        if classes & _ERR_BUS_OFF:
            reason = (
                "its controller is bus-off after too many errors: look for the bit rate, the termination and a second node; "
                "`ip link set DEVICE type can restart-ms 100` lets it come back by itself"
            )
            raise TransportClosedError(name=self._name, reason=reason)
        trouble = message.data[1] if classes & _ERR_CONTROLLER and len(message.data) > 1 else 0
        state = "passive" if trouble & _PASSIVE else "warning" if trouble & _WARNING else self.state
        if classes & _ERR_RESTARTED or trouble & 0x40:
            state = "active"
        if state != self.state:
            self.state = state
            (_log.info if state == "active" else _log.warning)("can.controller", bus=self._name, state=state)

    def _gone(self, error: Exception) -> TransportClosedError:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if number == errno.ENETDOWN:
            return TransportClosedError(name=self._name, reason="the interface is down; `ip link set DEVICE up`, see docs/dongles.md")
        return TransportClosedError(name=self._name, reason=f"gone ({error})")


def open_bus(spec: CanSpec) -> CanBus:
    """Open a bus; an slcan adapter for this process alone. Blocks.

    Raises
    ------
    TransportOpenError
        It cannot be opened now; the message says what to do.
    """
    logging.getLogger("can").setLevel(logging.CRITICAL)  # it logs what it raises, too
    lock = _lock_adapter(spec) if spec.interface == "slcan" else None
    try:
        bus = _open_python_can(spec)
    except (can.CanError, OSError, ValueError, NotImplementedError) as error:
        if lock is not None:
            os.close(lock)
        raise TransportOpenError(name=spec.bus_name, reason=_explain(error, spec)) from error
    return CanBus(bus, name=spec.bus_name, is_serial=spec.interface == "slcan", lock=lock)


def _open_python_can(spec: CanSpec) -> can.BusABC:
    match spec.interface:
        case "slcan":
            timing = None
            if spec.is_fd:
                timing = can.BitTimingFd.from_sample_point(
                    f_clock=_MANY_FD_CLOCK_HZ,
                    nom_bitrate=spec.bitrate,
                    nom_sample_point=80.0,
                    data_bitrate=spec.data_bitrate,
                    data_sample_point=75.0,
                )
            return can.Bus(
                interface="slcan",
                channel=spec.channel,
                ignore_config=True,
                bitrate=None if timing else spec.bitrate,
                timing=timing,
                sleep_after_open=spec.settle_s,
            )
        case "socketcan":
            bus = can.Bus(interface="socketcan", channel=spec.channel, ignore_config=True, fd=spec.is_fd)
            # The least the kernel allows, a handful of frames: what is urgent does not wait behind a long queue.
            bus.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 0)  # type: ignore[attr-defined]
            return bus
        case _:
            protocol = can.CanProtocol.CAN_FD if spec.is_fd else can.CanProtocol.CAN_20
            return can.Bus(interface="virtual", channel=spec.channel, ignore_config=True, protocol=protocol)


def _lock_adapter(spec: CanSpec) -> int:
    """Keep other processes off an adapter before anything is said to it."""
    try:
        lock = os.open(spec.channel, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise TransportOpenError(name=spec.bus_name, reason=_explain(error, spec)) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise TransportOpenError(name=spec.bus_name, reason=f"{spec.channel} is in use by another process") from error
    return lock


def _explain(error: Exception, spec: CanSpec) -> str:
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if number == errno.EAFNOSUPPORT:
        return "this kernel has no CAN sockets (AF_CAN); `modprobe can_raw`, or use slcan"
    if number == errno.ENODEV:
        return f"there is no CAN interface {spec.channel}; `ip link show type can` shows what there is"
    if number == errno.ENETDOWN:
        return f"{spec.channel} is down; `ip link set {spec.channel} up`, see docs/dongles.md"
    if number == errno.ENOENT or (spec.interface == "slcan" and not Path(spec.channel).exists()):
        return f"there is no {spec.channel}; `biobot-gateway list-ports` shows what there is"
    if number == errno.EACCES:
        return f"{spec.channel} may not be opened by this user; join the group that owns it, often `dialout`"
    return str(error)
