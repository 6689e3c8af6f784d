"""A commander that moves biobots until it is killed, for `studies.dead_man`: ``python -m studies.commander SITE END NAME HOLD_S NODE...``.

It says ``moving`` when all have confirmed that they walk, and then only beats.
"""

import sys
import time
import uuid
from typing import Final

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.sessions import TlsTable
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.bus_commander import CommanderSession

_TICK_S: Final = 0.02
_AGAIN_S: Final = 0.25


def main() -> int:
    """Move them."""
    site, endpoint, name, hold_s = sys.argv[1], sys.argv[2], sys.argv[3], float(sys.argv[4])
    nodes = [NodeId(int(node)) for node in sys.argv[5:]]
    session = CommanderSession.open(name=name, site=site, gateway=None, connect=[endpoint], tls=TlsTable())
    waiting: dict[str, NodeId] = {}
    due_s = dict.fromkeys(nodes, 0.0)
    while True:
        now_s = time.monotonic()
        session.beat(now_s=now_s)
        for node in [node for node, at_s in due_s.items() if at_s <= now_s]:
            del due_s[node]
            request = _start(node, name=name, hold_s=hold_s)
            waiting[request.command_id] = node
            session.send(request)
        for heard in session.take():
            if not isinstance(heard, CommandStage):
                print(heard, file=sys.stderr, flush=True)
            elif heard.is_final and (told := waiting.pop(heard.command_id, None)) is not None:
                if heard.stage is not Stage.BIOBOT_CONFIRMED:
                    due_s[told] = now_s + _AGAIN_S
                    print(f"{told}: {heard.stage.value}: {heard.reason}", file=sys.stderr, flush=True)
                elif not waiting and not due_s:
                    print("moving", flush=True)
        time.sleep(_TICK_S)


def _start(node: NodeId, *, name: str, hold_s: float) -> StimulationRequest:
    return StimulationRequest(
        command_id=uuid.uuid4().hex,
        node=node,
        action=StimulationAction.START,
        operator="study",
        issued_wall_ns=Nanoseconds(time.time_ns()),
        hold_ms=int(hold_s * 1000),
        commander=name,
    )


if __name__ == "__main__":
    raise SystemExit(main())
