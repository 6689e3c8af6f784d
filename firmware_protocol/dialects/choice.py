"""Which dialects a base station can speak, and a host that speaks one."""

from collections.abc import Callable
from dataclasses import replace

from firmware_protocol.dialects.can import DEFAULT_UNIT, make_can_host
from firmware_protocol.dialects.interface import Host, NetworkWish
from firmware_protocol.dialects.native import NativeHost
from firmware_protocol.dialects.xbee import XBeeHost, XBeeHostConfig
from firmware_protocol.dialects.znp import ZnpHost
from firmware_protocol.dialects.znp_opening import ZnpHostConfig

DEFAULT_DIALECT = "native"


def make_host(dialect: str, *, first_handle: int = 0, network: NetworkWish | None = None, idle_ns: int | None = None) -> Host:
    """Return the base station's end of a line in a dialect of ``DIALECTS``.

    Parameters
    ----------
    dialect
        ``can`` and ``canfd`` may have a unit number behind them: ``can:7``.
    first_handle
        Where numbers of payloads begin, in dialects that have them: anywhere else than in an earlier process.
    network
        What a dongle without a network is to form, in dialects of ``FORMING_DIALECTS``.
    idle_ns
        After how much silence a dongle is asked whether it is there; None: the dialect's own, 3 or 5 s.
    """
    name, _, unit = dialect.partition(":")
    if name in CAN_DIALECTS:
        return make_can_host(unit=int(unit or DEFAULT_UNIT), is_fd=name == "canfd", first_handle=first_handle, idle_ns=idle_ns)
    return _MAKERS[dialect](first_handle, network or NetworkWish(), idle_ns)


def _make_native(first_handle: int, _network: NetworkWish, idle_ns: int | None) -> Host:
    return NativeHost(first_handle=first_handle, idle_ns=idle_ns)


def _make_xbee(first_handle: int, _network: NetworkWish, idle_ns: int | None) -> Host:
    return XBeeHost(config=None if idle_ns is None else XBeeHostConfig(keepalive_ns=idle_ns), first_handle=first_handle)


def _make_znp(first_handle: int, network: NetworkWish, idle_ns: int | None) -> Host:
    config = ZnpHostConfig(pan_id=network.pan_id, channel=network.channel, permit_join_s=network.permit_join_s)
    if idle_ns is not None:
        config = replace(config, check_ns=idle_ns)
    return ZnpHost(config=config, first_handle=first_handle)


_MAKERS: dict[str, Callable[[int, NetworkWish, int | None], Host]] = {"native": _make_native, "xbee": _make_xbee, "znp": _make_znp}
CAN_DIALECTS = ("can", "canfd")
FORMING_DIALECTS = ("znp",)
"""Those whose dongles form the network that they are told to."""
DIALECTS = (*_MAKERS, *CAN_DIALECTS)
