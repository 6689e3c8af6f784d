"""Which dialects a virtual dongle can speak, and one that speaks it."""

from collections.abc import Callable

from simulator.dongles.interface import Dongle
from simulator.dongles.native import NativeDongle, NativeDongleConfig
from simulator.dongles.znp import ZnpDongle, ZnpDongleConfig

DEFAULT_DIALECT = "native"

_EUI64 = 0x00124B0000000000  # Texas Instruments' number
_PAN_ID = 0xB10B


def make_dongle(dialect: str, *, index: int) -> Dongle:
    """Return the ``index``-th dongle of a swarm, which speaks a dialect of ``DIALECTS``; it has a network of its own."""
    return _MAKERS[dialect](_EUI64 + (0x10000 + index if index else 0), _PAN_ID + index)


def _make_native(eui64: int, pan_id: int) -> Dongle:
    return NativeDongle(config=NativeDongleConfig(eui64=eui64, pan_id=pan_id))


def _make_znp(eui64: int, pan_id: int) -> Dongle:
    return ZnpDongle(config=ZnpDongleConfig(eui64=eui64, pan_id=pan_id))


_MAKERS: dict[str, Callable[[int, int], Dongle]] = {"native": _make_native, "znp": _make_znp}
DIALECTS = tuple(_MAKERS)
