"""Errors of the gateway, named for what the caller or the operator can do about them.

GatewayError
├── TransportError
│   ├── TransportSpecError    a port is named in a way that cannot be opened: correct the name
│   ├── TransportOpenError    a port cannot be opened now: try again later
│   │   └── TransportHangsError   an opening does not come back: wait until it has
│   └── TransportClosedError  a port has gone: close it and open it again
│       └── TransportSilentError  the device behind it hangs: reset it, where that can be done, and open it again
├── RadioUnavailableError     nothing can be sent by this radio now
├── JournalError
│   ├── JournalUnfitError     the file is no journal of ours, or not ours to write: choose another
│   └── JournalFullError      too much waits for the disk: wait until it takes records again
├── RecordingError            a file is no recording, or cannot be written: choose another
├── BusError                  Zenoh cannot be opened as configured
├── MonitorError              the monitor cannot answer where it is to: choose another address
├── InstallationError         services cannot be installed or removed as asked: the message says what to do first
└── CommandError              a command could not be brought to a gateway
"""

from collections.abc import Callable


class GatewayError(Exception):
    """Root of every error the gateway raises."""


class TransportError(GatewayError):
    """Something about a port."""


class TransportSpecError(TransportError):
    """A port is named in a way that cannot be opened."""

    def __init__(self, *, spec: str, reason: str) -> None:
        super().__init__(
            f"port {spec!r}: {reason}; examples: serial:/dev/ttyACM0?baud=115200, tcp:192.168.1.20:6638, can:socketcan:can0?unit=1"
        )
        self.spec = spec
        self.reason = reason


class TransportOpenError(TransportError):
    """A port cannot be opened now."""

    def __init__(self, *, name: str, reason: str) -> None:
        super().__init__(f"cannot open {name}: {reason}")
        self.name = name
        self.reason = reason


class TransportHangsError(TransportOpenError):
    """An opening does not come back, and holds a thread; no other should be begun until ``is_over()``."""

    def __init__(self, *, name: str, timeout_s: float, is_over: Callable[[], bool]) -> None:
        super().__init__(
            name=name, reason=f"the operating system has not opened it within {timeout_s:g} s; is the device, or its name server, ill?"
        )
        self.is_over = is_over


class TransportClosedError(TransportError):
    """A port has gone, or was closed by this side."""

    def __init__(self, *, name: str, reason: str) -> None:
        super().__init__(f"{name} is closed: {reason}")
        self.name = name
        self.reason = reason


class TransportSilentError(TransportClosedError):
    """The device takes nothing, or does not answer, on a port that is there."""


class RadioUnavailableError(GatewayError):
    """A radio cannot take a payload now; nothing was sent."""

    def __init__(self, *, radio: str, reason: str) -> None:
        super().__init__(f"radio {radio} takes nothing now: {reason}")
        self.radio = radio
        self.reason = reason


class JournalError(GatewayError):
    """Something about the journal."""


class JournalUnfitError(JournalError):
    """A file cannot serve as the journal."""

    def __init__(self, *, path: str, reason: str, advice: str) -> None:
        super().__init__(f"journal {path}: {reason}; {advice}")
        self.path = path
        self.reason = reason


class JournalFullError(JournalError):
    """More writes wait for the disk than may wait."""

    def __init__(self, *, limit: int) -> None:
        super().__init__(f"{limit} writes wait for the disk, the limit; try again when the journal takes records")
        self.limit = limit


class ExportError(JournalError):
    """A journal cannot be exported as asked."""

    def __init__(self, *, path: str, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


class RecordingError(GatewayError):
    """A recording, or what is made of one, cannot be read or written."""

    def __init__(self, *, path: str, reason: str, what: str = "recording") -> None:
        super().__init__(f"{what} {path}: {reason}")
        self.path = path
        self.reason = reason


class CertificateError(GatewayError):
    """A file of the authority or of a certificate cannot be made, read or used."""

    def __init__(self, *, path: str, reason: str, advice: str) -> None:
        super().__init__(f"{path}: {reason}; {advice}")
        self.path = path
        self.reason = reason


class BusError(GatewayError):
    """Zenoh cannot be opened as configured."""


class MonitorError(GatewayError):
    """The monitor cannot answer where it is to."""

    def __init__(self, *, address: str, reason: str, next_step: str) -> None:
        super().__init__(f"monitor {address}: {reason}; {next_step}")
        self.address = address
        self.reason = reason


class InstallationError(GatewayError):
    """Services cannot be installed or removed as asked."""

    def __init__(self, *, what: str, reason: str, next_step: str) -> None:
        super().__init__(f"{what}: {reason}; {next_step}")
        self.what = what
        self.reason = reason
        self.next_step = next_step


class CommandError(GatewayError):
    """A command could not be brought to a gateway; nothing was sent to the biobot."""


def first_transport_error(group: BaseExceptionGroup[BaseException]) -> TransportError:
    """Return the error that ended reading or writing first, of a group of nothing else; the other task may have met the same cause."""
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, TransportError)
    return error
