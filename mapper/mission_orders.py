"""Orders to missions: given to one gateway or to all, and what they answer."""

import time
import uuid
from collections.abc import Callable
from typing import Final

from firmware_protocol.contract.mission_orders import MissionAction, MissionAnswer, MissionOrder
from firmware_protocol.units import Nanoseconds
from mapper.bus import Bus
from mapper.errors import GatewayAwayError, OrderRefusedError, QueryError
from mapper.log import EventLog

_log = EventLog(__name__)

_PATIENCE_S: Final = 5.0


class MissionDesk:
    """Gives orders; the gateway remembers them by their ids."""

    def __init__(self, *, bus: Bus, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self._bus = bus
        self._wall_ns = wall_ns

    async def order(
        self, *, action: MissionAction, operator: str, gateway: str | None, ttl_ms: int, order_id: str | None
    ) -> tuple[MissionOrder, list[MissionAnswer]]:
        """Give the mission of a gateway, or (None) of each, an order; return it with the answers, one at least of which takes it.

        Raises
        ------
        OrderRefusedError
            Nobody who answered took it.
        GatewayAwayError
            Nobody answered.
        """
        order = MissionOrder(
            order_id=order_id or uuid.uuid4().hex,
            action=action,
            operator=operator,
            issued_wall_ns=Nanoseconds(self._wall_ns()),
            ttl_ms=ttl_ms,
        )
        _log.info("mission.ordered", id=order.order_id, action=action.value, operator=operator, gateway=gateway or "all")
        try:
            answers = await self._bus.send_order(order, gateway=gateway, timeout_s=ttl_ms / 1000 + _PATIENCE_S)
        except QueryError as error:
            raise GatewayAwayError(command_id=order.order_id, gateway=gateway, reason=str(error)) from error
        answers = sorted((answer for answer in answers if answer.order_id == order.order_id), key=lambda answer: answer.gateway)
        if not answers:
            raise GatewayAwayError(command_id=order.order_id, gateway=gateway)
        if not any(answer.is_taken for answer in answers):
            raise OrderRefusedError(order_id=order.order_id, answers=[(answer.gateway, answer.reason) for answer in answers])
        return order, answers
