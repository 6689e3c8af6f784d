"""Whether a biobot is there: one rule, for the table of biobots and for the alerts. Pure."""

from collections.abc import Mapping
from enum import Enum
from typing import Final

from mapper.fleet import BiobotView, GatewayView

_UP: Final = "up"


class Presence(Enum):
    """What can be said of a biobot now."""

    ONLINE = "online"
    """Heard lately."""
    LOST = "lost"
    """Silent for too long, though its gateway and radio listen."""
    UNKNOWN = "unknown"
    """It has not spoken yet, or nobody tells: its gateway is away or kept from its work, or the radio that heard it last is not up."""


_A_WARNING: Final = "MiB are free"
"""Of what a gateway says is wrong: its disk fills up, and it still works."""


def gateway_faults(gateway: GatewayView) -> tuple[str, ...]:
    """Return what a gateway says that keeps it from its work, in its words."""
    return tuple(fault for fault in (() if gateway.status is None else gateway.status.faults) if _A_WARNING not in fault)


def presence_of(biobot: BiobotView, *, gateways: Mapping[str, GatewayView], lost_s: float) -> Presence:
    """Say whether a biobot is there; ``gateways`` by name, ``lost_s``: the longest silence of one that is."""
    home = gateways.get(biobot.gateway)
    if home is None or not home.is_alive or home.status is None or biobot.silence_s is None:
        return Presence.UNKNOWN
    if gateway_faults(home):
        return Presence.UNKNOWN  # what it hears waits for its disk, and is told when it has been recorded
    if biobot.radio is not None and home.status.radios.get(biobot.radio, _UP) != _UP:
        return Presence.UNKNOWN
    return Presence.LOST if biobot.silence_s > lost_s else Presence.ONLINE
