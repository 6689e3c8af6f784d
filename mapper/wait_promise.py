"""Whether a wait may be promised: the encounters that are missing come only while encounters come at all. Pure."""

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from mapper.served_bytes import ServedBytes

RATE_MINUTES: Final = 5
"""The rate to come is that of so many minutes before the newest encounter."""
_INTERVALS: Final = 3.0
"""Where encounters are rare, so many of their mean intervals without one, if that is longer: by chance once in twenty (exp(-3))."""
_NS_PER_MIN: Final = 60_000_000_000


def why_nothing_arrives(
    *, newest_ns: int | None, rate_per_min: float, now_ns: int, is_connected: bool, are_alive: Sequence[bool]
) -> str | None:
    """Say why no encounters are to be expected now; None where they come, or nothing speaks against it.

    Parameters
    ----------
    newest_ns
        When the newest encounter was over [ns since 1970]; None: there is none, or what came since is not counted yet.
    rate_per_min
        Of encounters, before the newest.
    is_connected, are_alive
        Whether the mapper is joined to the bus, and of each gateway that was ever on it whether it is there.

    Notes
    -----
    The text does not change while its cause lasts.
    """
    if not is_connected:
        return "nothing arrives: the mapper is not connected to any gateway or router"
    if are_alive and not any(are_alive):
        gateways = "its gateway" if len(are_alive) == 1 else f"each of its {len(are_alive)} gateways"
        return f"nothing arrives: {gateways} is away"
    patience_min = max(float(RATE_MINUTES), _INTERVALS / rate_per_min if rate_per_min > 0.0 else 0.0)
    if newest_ns is not None and now_ns - newest_ns > patience_min * _NS_PER_MIN:
        return (
            f"nothing arrives: no encounter of the last {patience_min:.0f} minutes is known; "
            "see whether biobots walk, and whether the gateways hear them"
        )
    return None


def judge_promise(coverage: ServedBytes, *, now_ns: int, has_newer: bool, is_connected: bool, are_alive: Sequence[bool]) -> ServedBytes:
    """Return a description of coverage as it holds now: without a wait where nothing arrives, and with the reason.

    Parameters
    ----------
    coverage
        What `mapper.coverage.describe_coverage` says, as JSON.
    has_newer
        Records came that it does not count yet.
    """
    told: dict[str, Any] = msgspec.json.decode(coverage.plain)
    data = told["data"]
    if data is None or not data["expected_wait_s"]:  # none was promised, or it is over
        return coverage
    newest_ns = max((one["last_encounter_wall_ns"] for one in told["biobots"]), default=None)
    reason = why_nothing_arrives(
        newest_ns=None if has_newer else newest_ns,
        rate_per_min=told["rate_per_min"],
        now_ns=now_ns,
        is_connected=is_connected,
        are_alive=are_alive,
    )
    if reason is None:
        return coverage
    return ServedBytes.of(msgspec.json.encode(told | {"data": data | {"expected_wait_s": None, "nothing_arrives": reason}}))
