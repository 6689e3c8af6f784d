"""Which dialects a virtual dongle can speak, and one that speaks it."""

from collections.abc import Callable
from functools import partial

from firmware_protocol.dialects.can import DEFAULT_UNIT
from firmware_protocol.dialects.choice import CAN_DIALECTS
from simulator.dongles.can import CanDongle
from simulator.dongles.interface import Dongle
from simulator.dongles.native import NativeDongle, NativeDongleConfig
from simulator.dongles.xbee import XBeeDongle, XBeeDongleConfig
from simulator.dongles.znp import ZnpDongle, ZnpDongleConfig
from simulator.dongles.znp_stack import ZStack

DEFAULT_DIALECT = "native"

_EUI64 = 0x00124B0000000000  # Texas Instruments' number
_DIGI_EUI64 = 0x0013A20000000000
_PAN_ID = 0xB10B


def make_dongle(dialect: str, *, index: int) -> Dongle:
    """Return the ``index``-th dongle of a swarm, which is one of ``DONGLES``; it has a network of its own.

    ``can`` and ``canfd`` may have a unit number behind them: ``can:7``.
    """
    eui64, pan_id = _EUI64 + (0x10000 + index if index else 0), _PAN_ID + index
    name, _, unit = dialect.partition(":")
    if name in CAN_DIALECTS:
        config = NativeDongleConfig(eui64=eui64, pan_id=pan_id)
        return CanDongle(config=config, unit=int(unit or DEFAULT_UNIT), is_fd=name == "canfd")
    return (_MAKERS | _VARIANTS)[dialect](eui64, pan_id)


def host_dialect(dongle: str) -> str:
    """Return what a base station calls the dialect of a dongle of ``DONGLES``."""
    return dongle.partition("-")[0] if dongle in _VARIANTS else dongle


def _make_native(eui64: int, pan_id: int) -> Dongle:
    return NativeDongle(config=NativeDongleConfig(eui64=eui64, pan_id=pan_id))


def _make_xbee(eui64: int, pan_id: int, *, mode: int = 2) -> Dongle:
    eui64 = _DIGI_EUI64 | eui64 & 0xFFFF_FFFF
    return XBeeDongle(config=XBeeDongleConfig(eui64=eui64, pan_id=pan_id, memory={"CE": 1, "AP": mode}))


def _make_znp(eui64: int, pan_id: int, *, firmware: ZStack = ZStack.V3_X_0) -> Dongle:
    is_stick = firmware is ZStack.V1_2
    return ZnpDongle(config=ZnpDongleConfig(eui64=eui64, pan_id=pan_id, firmware=firmware, has_boot_loader=is_stick))


_MAKERS: dict[str, Callable[[int, int], Dongle]] = {"native": _make_native, "xbee": _make_xbee, "znp": _make_znp}
_VARIANTS: dict[str, Callable[[int, int], Dongle]] = {
    "xbee-ap0": partial(_make_xbee, mode=0),
    "xbee-ap1": partial(_make_xbee, mode=1),
    "znp-cc2531": partial(_make_znp, firmware=ZStack.V1_2),
}
"""The same dialects in another state: an XBee in transparent mode, as it comes from the factory, or in API mode 1; a CC2531
with Z-Stack 1.2 that is in its boot loader when it is plugged in."""
DIALECTS = (*_MAKERS, *CAN_DIALECTS)
DONGLES = (*DIALECTS, *_VARIANTS)
"""All that ``make_dongle`` makes."""
