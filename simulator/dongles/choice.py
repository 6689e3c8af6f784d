"""Which dialects a virtual dongle can speak, and one that speaks it."""

from collections.abc import Callable

from firmware_protocol.dialects.can import DEFAULT_UNIT
from firmware_protocol.dialects.choice import CAN_DIALECTS
from simulator.dongles.can import CanDongle
from simulator.dongles.interface import Dongle
from simulator.dongles.native import NativeDongle, NativeDongleConfig

DEFAULT_DIALECT = "native"

_EUI64 = 0x00124B0000000000  # Texas Instruments' number
_PAN_ID = 0xB10B


def make_dongle(dialect: str, *, index: int) -> Dongle:
    """Return the ``index``-th dongle of a swarm, which speaks a dialect of ``DIALECTS``; it has a network of its own.

    ``can`` and ``canfd`` may have a unit number behind them: ``can:7``.
    """
    eui64, pan_id = _EUI64 + (0x10000 + index if index else 0), _PAN_ID + index
    name, _, unit = dialect.partition(":")
    if name in CAN_DIALECTS:
        config = NativeDongleConfig(eui64=eui64, pan_id=pan_id)
        return CanDongle(config=config, unit=int(unit or DEFAULT_UNIT), is_fd=name == "canfd")
    return _MAKERS[dialect](eui64, pan_id)


def _make_native(eui64: int, pan_id: int) -> Dongle:
    return NativeDongle(config=NativeDongleConfig(eui64=eui64, pan_id=pan_id))


_MAKERS: dict[str, Callable[[int, int], Dongle]] = {"native": _make_native}
DIALECTS = (*_MAKERS, *CAN_DIALECTS)
