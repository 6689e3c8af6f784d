"""Whether a wait may be promised: the encounters that are missing come only while encounters come at all. Pure."""

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from mapper.served_bytes import ServedBytes

RATE_MINUTES: Final = 5
"""The rate to come is that of so many minutes before the newest encounter."""
_INTERVALS: Final = 3.0
"""Where encounters are rare, so many of their mean intervals without one, if that is longer: by chance once in twenty (exp(-3))."""


def why_nothing_arrives(*, silent_s: float, rate_per_min: float, is_connected: bool, are_there: Sequence[bool]) -> str | None:
    """Say why no encounters are to be expected now; None where they come, or nothing speaks against it.

    Parameters
    ----------
    silent_s
        Since the last encounter arrived, or since the mapper was started [s].
    rate_per_min
        Of encounters, before the newest.
    is_connected, are_there
        Whether the mapper is joined to the bus, and of each gateway that was ever on it whether it is there.

    Notes
    -----
    The text does not change while its cause lasts.
    """
    if not is_connected:
        return "nothing arrives: the mapper is not connected to any gateway or router"
    if are_there and not any(are_there):
        gateways = "its gateway" if len(are_there) == 1 else f"each of its {len(are_there)} gateways"
        return f"nothing arrives: {gateways} is away"
    patience_min = max(float(RATE_MINUTES), _INTERVALS / rate_per_min if rate_per_min > 0.0 else 0.0)
    if silent_s > patience_min * 60.0:
        return (
            f"nothing arrives: the last {patience_min:.0f} minutes and more brought no encounter; see whether biobots walk, and the "
            "gateways hear them"
        )
    return None


def judge_promise(coverage: ServedBytes, *, silent_s: float, is_connected: bool, are_there: Sequence[bool]) -> ServedBytes:
    """Return a description of coverage as it holds now: without a wait where nothing arrives, and with the reason.

    Parameters
    ----------
    coverage
        What `mapper.coverage.describe_coverage` says, as JSON.
    silent_s, is_connected, are_there
        As for `why_nothing_arrives`.
    """
    told: dict[str, Any] = msgspec.json.decode(coverage.plain)
    data = told["data"]
    if data is None or not data["expected_wait_s"]:  # none was promised, or it is over
        return coverage
    reason = why_nothing_arrives(
        silent_s=silent_s,
        rate_per_min=told["rate_per_min"],
        is_connected=is_connected,
        are_there=are_there,
    )
    if reason is None:
        return coverage
    return ServedBytes.of(msgspec.json.encode(told | {"data": data | {"expected_wait_s": None, "nothing_arrives": reason}}))
