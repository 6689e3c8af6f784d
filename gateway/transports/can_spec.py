"""How a CAN bus and a coordinator on it are named: ``can:socketcan:can0?fd=1&unit=1``."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from firmware_protocol.dialects.can import DEFAULT_UNIT
from firmware_protocol.dialects.interface import NetworkWish
from firmware_protocol.framing.can_frame import MAX_UNIT
from gateway.errors import TransportSpecError

INTERFACES = ("socketcan", "slcan", "virtual")
OPTIONS = ("unit", "fd", "bitrate", "dbitrate", "settle")

_SLCAN_BITRATES = (10_000, 20_000, 50_000, 83_300, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000)
_SLCAN_DATA_BITRATES = (2_000_000, 5_000_000)
_MAX_SETTLE_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CanSpec:
    """A coordinator on a CAN bus.

    Parameters
    ----------
    interface, channel
        Of python-can: ``socketcan`` and ``can0``, ``slcan`` and a serial port, ``virtual`` and any name within this process.
    unit
        The coordinator's number on the bus.
    is_fd
        Whether CAN FD frames are sent.
    bitrate, data_bitrate
        Of an slcan adapter [bit/s]; socketcan interfaces have theirs from ``ip link``.
    settle_s
        How long an adapter that restarts when its port is opened is left alone [s].
    """

    interface: str
    channel: str
    unit: int = DEFAULT_UNIT
    is_fd: bool = False
    bitrate: int = 500_000
    data_bitrate: int = 2_000_000
    settle_s: float = 0.0

    @property
    def name(self) -> str:
        """What the port is called; two units on one bus are two ports."""
        return f"{self.bus_name}?unit={self.unit}"

    @property
    def bus_name(self) -> str:
        """What the bus is called."""
        return f"can:{self.interface}:{self.channel}"

    @property
    def bus_options(self) -> str:
        """What all units of a bus share, as text."""
        return f"fd={self.is_fd:d}" + (f", bitrate={self.bitrate}, dbitrate={self.data_bitrate}" if self.interface == "slcan" else "")

    @property
    def network(self) -> NetworkWish | None:
        """Nothing: coordinators on CAN are told by ``biobot-gateway configure``."""
        return None

    @property
    def dialect(self) -> str:
        """What ``make_host`` is asked for."""
        return f"{'canfd' if self.is_fd else 'can'}:{self.unit}"


def read_can_spec(spec: str, place: str, options: Mapping[str, str]) -> CanSpec:
    """Return what the parts of a port's name mean; ``place`` is ``INTERFACE:CHANNEL``.

    Raises
    ------
    TransportSpecError
        They mean nothing.
    """
    interface, _, channel = place.partition(":")
    if interface not in INTERFACES or not channel:
        reason = f"must be can:INTERFACE:CHANNEL with the interface {', '.join(INTERFACES[:-1])} or {INTERFACES[-1]}"
        raise TransportSpecError(spec=spec, reason=reason)
    for key in ("bitrate", "dbitrate", "settle"):
        if key in options and interface != "slcan":
            raise TransportSpecError(spec=spec, reason=f"{key} is an option of slcan alone; a socketcan interface has it from `ip link`")
    if "dbitrate" in options and options.get("fd") != "1":
        raise TransportSpecError(spec=spec, reason="dbitrate is the rate of CAN FD data: it needs fd=1")
    return CanSpec(
        interface=interface,
        channel=channel,
        unit=_number(spec, "unit", options.get("unit", str(DEFAULT_UNIT)), tuple(range(MAX_UNIT + 1)), f"a number from 0 to {MAX_UNIT}"),
        is_fd=bool(_number(spec, "fd", options.get("fd", "0"), (0, 1), "0 or 1")),
        bitrate=_number(spec, "bitrate", options.get("bitrate", "500000"), _SLCAN_BITRATES),
        data_bitrate=_number(spec, "dbitrate", options.get("dbitrate", "2000000"), _SLCAN_DATA_BITRATES),
        settle_s=_settle(spec, options.get("settle", "0")),
    )


def _number(spec: str, key: str, text: str, allowed: tuple[int, ...], wanted: str = "") -> int:
    if re.fullmatch(r"[0-9]{1,10}", text) is None or int(text) not in allowed:
        raise TransportSpecError(spec=spec, reason=f"{key} is {text!r}, but must be {wanted or f'one of {allowed}'}")
    return int(text)


def _settle(spec: str, text: str) -> float:
    value = float(text) if re.fullmatch(r"[0-9]{1,3}(\.[0-9]{1,6})?", text) else -1.0
    if not 0 <= value <= _MAX_SETTLE_S:
        raise TransportSpecError(spec=spec, reason=f"settle is {text!r}, but must be 0 to {_MAX_SETTLE_S:g} s")
    return value
