"""Which dialects a base station can speak, and a host that speaks one."""

from collections.abc import Callable

from firmware_protocol.dialects.interface import Host
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.dialects.znp import ZnpHost

DEFAULT_DIALECT = "native"


def make_host(dialect: str, *, first_handle: int = 0) -> Host:
    """Return the base station's end of a line in a dialect of ``DIALECTS``.

    Parameters
    ----------
    first_handle
        Where numbers of payloads begin, in dialects that have them: anywhere else than in an earlier process.
    """
    return _MAKERS[dialect](first_handle)


def _make_native(first_handle: int) -> Host:
    return NativeHost(first_handle=first_handle)


def _make_znp(first_handle: int) -> Host:
    return ZnpHost(first_handle=first_handle)


_MAKERS: dict[str, Callable[[int], Host]] = {"native": _make_native, "znp": _make_znp}
DIALECTS = tuple(_MAKERS)
