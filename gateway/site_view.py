"""What is known of the gateways of a site, made of what they say: how each stands, and how fast things go. Pure: time is an argument."""

from collections import deque
from dataclasses import dataclass, field
from typing import TypeAlias, assert_never

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import GatewayStatus, RadioReport
from firmware_protocol.units import NS_PER_S

SILENT_S = 3.5
"""A gateway that has said nothing for so long is told as silent: it speaks every second."""

_RATE_STATUSES = 6
_MAX_EVENTS = 50
_MAX_GATEWAYS = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Presence:
    """A gateway came to the bus, or left it."""

    gateway: str
    is_alive: bool


Arrival: TypeAlias = GatewayStatus | GatewayEvent | Presence


@dataclass(slots=True)
class GatewayView:
    """One gateway.

    Parameters
    ----------
    heard_s, gone_s
        When its newest status came, and when it left; None: it has not.
    """

    name: str
    statuses: deque[GatewayStatus] = field(default_factory=lambda: deque(maxlen=_RATE_STATUSES))
    heard_s: float | None = None
    gone_s: float | None = None

    @property
    def status(self) -> GatewayStatus | None:
        """The newest status, or None: it has said none."""
        return self.statuses[-1] if self.statuses else None

    def reports(self) -> dict[str, RadioReport]:
        """Return how each radio stands; an older gateway tells its state alone, and since when nobody knows."""
        status = self.status
        if status is None:
            return {}
        since = status.started_wall_ns or status.wall_ns
        return status.radio_reports or {name: RadioReport(state=state, since_wall_ns=since) for name, state in status.radios.items()}

    def records_per_s(self) -> float:
        """Return how many records were journaled a second, of late."""
        return self._rate([status.head_offset for status in self.statuses])

    def messages_per_s(self, radio: str) -> float:
        """Return how many payloads came from a radio a second, of late."""
        return self._rate([status.radio_reports[radio].n_messages for status in self.statuses if radio in status.radio_reports])

    def bytes_per_s(self, radio: str) -> float:
        """Return how many bytes came from a radio a second, of late."""
        return self._rate([status.radio_reports[radio].n_bytes for status in self.statuses if radio in status.radio_reports])

    def _rate(self, values: list[int]) -> float:
        if len(values) != len(self.statuses) or len(values) < 2:
            return 0.0
        passed_s = (self.statuses[-1].wall_ns - self.statuses[0].wall_ns) / NS_PER_S
        return max(0.0, (values[-1] - values[0]) / passed_s) if passed_s > 0 else 0.0


class SiteView:
    """All gateways that were heard, and the newest events of all."""

    def __init__(self) -> None:
        self.events: deque[GatewayEvent] = deque(maxlen=_MAX_EVENTS)
        self._gateways: dict[str, GatewayView] = {}

    def gateways(self) -> list[GatewayView]:
        """Return the gateways, by name."""
        return [self._gateways[name] for name in sorted(self._gateways)]

    def take(self, arrival: Arrival, *, now_s: float) -> None:
        """Take note of what came in."""
        match arrival:
            case GatewayStatus():
                view = self._view(arrival.gateway)
                if view.status is not None and (view.status.boot, view.status.journal) != (arrival.boot, arrival.journal):
                    view.statuses.clear()  # it was started anew: what it counts begins at 0
                view.statuses.append(arrival)
                view.heard_s, view.gone_s = now_s, None
            case Presence(gateway=gateway, is_alive=is_alive):
                self._view(gateway).gone_s = None if is_alive else now_s
            case GatewayEvent():
                self.events.append(arrival)
            case _:
                assert_never(arrival)

    def _view(self, name: str) -> GatewayView:
        if name not in self._gateways and len(self._gateways) >= _MAX_GATEWAYS:
            self._gateways.pop(next(iter(self._gateways)))
        return self._gateways.setdefault(name, GatewayView(name))
