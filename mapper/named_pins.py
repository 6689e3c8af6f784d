"""Pins of a live map: places that the operator named, kept in the store."""

import msgspec


class NamedPin(msgspec.Struct, frozen=True, kw_only=True):
    """What the operator calls a place: ``place`` is text as `mapper.places` reads it.

    ``x`` and ``y`` say where it is in the operator's frame [m]; None, both, where it is only named.
    """

    name: str
    place: str
    x: float | None = None
    y: float | None = None

    @property
    def at(self) -> tuple[float, float] | None:
        """Its known place; None: it has none."""
        return None if self.x is None or self.y is None else (self.x, self.y)


class PinOnMap(msgspec.Struct, frozen=True, kw_only=True):
    """Where a pin is on the map, or (``problem``) why not; ``residual_m``: how far from there its known place puts it."""

    x: float | None = None
    y: float | None = None
    component: int | None = None
    gap_s: float | None = None
    residual_m: float | None = None
    problem: str | None = None


class Framing(msgspec.Struct, frozen=True, kw_only=True):
    """Pins, where each of them is on the map, the frame as JSON ("null": there is none), and what stands in the way of one."""

    pins: tuple[NamedPin, ...] = ()
    places: tuple[PinOnMap, ...] = ()
    frame_json: bytes = b"null"
    problems: tuple[str, ...] = ()
