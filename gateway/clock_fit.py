"""The lines that a backpack's clock can follow: bounds of offset and rate from messages whose delay is not known. Pure.

Seen over the backpack's time s, the offset o(s) to the gateway's clock lies below every point (sent, received - sent) and above every
point (arrived, requested - arrived): no message comes before it was sent. Of all straight lines between the two sets of points the
steepest and the flattest bound the rate, and the nearest points the offset (the idea of a clock's convex hulls: Zhang, Liu, Xia, "Clock
synchronization algorithms for network measurements", INFOCOM 2002). Delay loosens a bound and never falsifies one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

MAX_DRIFT = 100e-6
"""Largest difference in rate of the two clocks: a backpack's crystal (40 ppm for IEEE 802.15.4) and the host's, with margin."""

MAX_WANDER = 5e-6
"""A rate over one part of the window differs by at most this from that over another: a crystal cut for radios moves by about 1 ppm a kelvin
at most away from its turning point, and a backpack's temperature by a few kelvin in minutes. An assumption."""

Point: TypeAlias = tuple[int, int]
"""An instant of the backpack's clock, and an offset of the gateway's that its own is not above (or not below) there [ns]."""


@dataclass(frozen=True, slots=True)
class ClockFit:
    """What is known of an offset: at ``at_ns`` of the backpack's clock it is between two values, and it goes on at a rate known so well.

    Parameters
    ----------
    upper_ns, lower_ns
        Bounds of the offset at ``at_ns`` [ns].
    rate, rate_error
        How fast the offset grows with the backpack's time, and how wrong that may be.
    """

    at_ns: int
    upper_ns: int
    lower_ns: int
    rate: float
    rate_error: float


def fit(upper: Sequence[Point], lower: Sequence[Point], *, at_ns: int, assumed_delay_ns: int) -> ClockFit | None:
    """Return what the points leave possible; None where they contradict each other, as after a jump of a clock.

    Parameters
    ----------
    upper, lower
        The offset is not above the first (at least one) and not below the second.
    at_ns
        Where the bounds of the offset are wanted.
    assumed_delay_ns
        Without a point of ``lower``, the offset is taken to be no further than this below its upper bound [ns].
    """
    slowest, fastest = -MAX_DRIFT, MAX_DRIFT
    for t_upper, o_upper in upper:
        for t_lower, o_lower in lower:
            room, span = o_upper - o_lower, t_upper - t_lower
            if span > 0:
                fastest = min(fastest, room / span)
            elif span < 0:
                slowest = max(slowest, room / span)
            elif room < 0:
                return None
    slowest, fastest = max(slowest - MAX_WANDER, -MAX_DRIFT), min(fastest + MAX_WANDER, MAX_DRIFT)
    if slowest > fastest:
        return None
    rate, rate_error = (slowest + fastest) / 2, (fastest - slowest) / 2
    upper_ns = min(o + int((at_ns - t) * rate + abs(at_ns - t) * rate_error) for t, o in upper) + 1  # rounded outwards
    if lower:
        lower_ns = max(o + int((at_ns - t) * rate - abs(at_ns - t) * rate_error) for t, o in lower) - 1
        if lower_ns > upper_ns:
            return None
    else:
        lower_ns = upper_ns - assumed_delay_ns
    return ClockFit(at_ns, upper_ns, lower_ns, rate, rate_error)
