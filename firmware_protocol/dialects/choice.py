"""Which dialects a base station can speak, and a host that speaks one."""

from collections.abc import Callable

from firmware_protocol.dialects.can import DEFAULT_UNIT, make_can_host
from firmware_protocol.dialects.interface import Host
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.dialects.xbee import XBeeHost
from firmware_protocol.dialects.znp import ZnpHost

DEFAULT_DIALECT = "native"


def make_host(dialect: str, *, first_handle: int = 0) -> Host:
    """Return the base station's end of a line in a dialect of ``DIALECTS``.

    Parameters
    ----------
    dialect
        ``can`` and ``canfd`` may have a unit number behind them: ``can:7``.
    first_handle
        Where numbers of payloads begin, in dialects that have them: anywhere else than in an earlier process.
    """
    name, _, unit = dialect.partition(":")
    if name in CAN_DIALECTS:
        return make_can_host(unit=int(unit or DEFAULT_UNIT), is_fd=name == "canfd", first_handle=first_handle)
    return _MAKERS[dialect](first_handle)


def _make_native(first_handle: int) -> Host:
    return NativeHost(first_handle=first_handle)


def _make_xbee(first_handle: int) -> Host:  # noqa: ARG001  # frame ids have no memory in a module
    return XBeeHost()


def _make_znp(first_handle: int) -> Host:
    return ZnpHost(first_handle=first_handle)


_MAKERS: dict[str, Callable[[int], Host]] = {"native": _make_native, "xbee": _make_xbee, "znp": _make_znp}
CAN_DIALECTS = ("can", "canfd")
DIALECTS = (*_MAKERS, *CAN_DIALECTS)
