"""The native dialect over CAN from both ends: the framing that a host or a dongle of some unit speaks (WIRE_FORMAT.md §10)."""

from functools import partial

from firmware_protocol.dialects.native import Framing, NativeHost
from firmware_protocol.framing.can import CanDecoder, encode_message
from firmware_protocol.framing.can_frame import Direction

DEFAULT_UNIT = 1


def make_can_host(*, unit: int = DEFAULT_UNIT, is_fd: bool, first_handle: int = 0, idle_ns: int | None = None) -> NativeHost:
    """Return the base station's end for the coordinator that has this unit number on its bus."""
    return NativeHost(
        framing=can_framing(unit=unit, is_fd=is_fd, sends=Direction.TO_COORDINATOR), first_handle=first_handle, idle_ns=idle_ns
    )


def can_framing(*, unit: int, is_fd: bool, sends: Direction) -> Framing:
    """Return the framing of the end that sends in one direction; it takes CAN FD and classic frames, whichever come."""
    hears = Direction(1 - sends)
    return Framing(
        make_decoder=partial(CanDecoder, direction=hears, unit=unit),
        encode=partial(encode_message, unit=unit, direction=sends, is_fd=is_fd),
    )
