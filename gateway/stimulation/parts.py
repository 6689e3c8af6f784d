"""Stops that come of another stop: of one biobot, where that is of all; or once more, where something came after it. Pure."""

import hashlib

from firmware_protocol.contract.commands import StimulationAction, StimulationRequest
from firmware_protocol.units import NodeId

_MAX_ID = 64
_DIGEST = 16


def stop_of(whole: StimulationRequest, node: NodeId, *, suffix: str) -> StimulationRequest:
    """Return the stop of one biobot that comes of a stop. Its id is the other's and the suffix, of a few letters; a long one is cut."""
    command_id = f"{whole.command_id}.{suffix}"
    if len(command_id) > _MAX_ID:
        digest = hashlib.sha256(whole.command_id.encode()).hexdigest()[:_DIGEST]
        command_id = f"{whole.command_id[: _MAX_ID - _DIGEST - 2 - len(suffix)]}-{digest}.{suffix}"
    return StimulationRequest(
        command_id=command_id,
        node=node,
        action=StimulationAction.STOP,
        operator=whole.operator,
        issued_wall_ns=whole.issued_wall_ns,
        ttl_ms=whole.ttl_ms,
        hold_ms=whole.hold_ms,
    )
