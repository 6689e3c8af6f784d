"""Orders of operators: each is taken once, while it is fresh, and answered again when it is repeated. Pure."""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field

from firmware_protocol.contract.mission_orders import MissionAction, MissionAnswer, MissionOrder
from firmware_protocol.contract.records import MissionRecord
from firmware_protocol.units import NS_PER_MS, NS_PER_S
from gateway.mission.steps import MissionState

_MAX_REMEMBERED = 1024
_MAX_AHEAD_MS = 2_000

_ALWAYS_FRESH = {MissionAction.PAUSE, MissionAction.SHOW}
"""A pause commands nobody, and whose clock is wrong may give it too."""

_COMMANDING = {MissionAction.START, MissionAction.RESUME, MissionAction.SELECT, MissionAction.REDISPERSE}


def refusal_of(order: MissionOrder, *, now_wall_ns: int, journal_fault: str | None) -> str | None:
    """Return why an order is not taken, whatever the mission does, or None."""
    age_ms = (now_wall_ns - order.issued_wall_ns) // NS_PER_MS
    if order.action not in _ALWAYS_FRESH:
        if age_ms < -_MAX_AHEAD_MS:
            return f"it was issued {-age_ms} ms in the future; set the clocks"
        if age_ms > order.ttl_ms:
            return f"it is stale: issued {age_ms} ms ago with a time to live of {order.ttl_ms} ms; give it anew"
    if journal_fault is not None and order.action in _COMMANDING:
        return (
            f"the journal takes nothing ({journal_fault}): a mission that is not on disk commands nobody; make room, or pause or finish it"
        )
    return None


def answer_of(
    order: MissionOrder,
    state: MissionState,
    *,
    gateway: str,
    refusal: str | None,
    remaining_ns: int | None,
    possible: tuple[MissionAction, ...],
) -> MissionAnswer:
    """Return the answer to an order: how the mission stands, or why the order was not taken."""
    return MissionAnswer(
        order_id=order.order_id,
        gateway=gateway,
        is_taken=refusal is None,
        phase=state.phase,
        landmarks=tuple(sorted(state.landmarks)),
        reason=refusal or state.reason,
        round=state.round,
        remaining_s=None if remaining_ns is None else remaining_ns / NS_PER_S,
        possible=possible,
    )


@dataclass(slots=True, kw_only=True)
class OrderMemory:
    """Answers to the newest orders, by id. Orders that were taken are known after a restart too, from the phases that they began."""

    gateway: str
    _answers: OrderedDict[str, tuple[MissionAction | None, MissionAnswer]] = field(default_factory=OrderedDict)

    def restore(self, records: Iterable[MissionRecord]) -> None:
        """Know the orders of earlier processes, oldest first."""
        for record in records:
            if record.order_id:
                answer = MissionAnswer(
                    order_id=record.order_id,
                    gateway=self.gateway,
                    is_taken=True,
                    phase=record.phase,
                    landmarks=record.landmarks,
                    reason="it was taken before",
                    round=record.round,
                )
                self._keep(record.order_id, None, answer)

    def recall(self, order: MissionOrder) -> MissionAnswer | None:
        """Return the answer to an order that was given before, or None."""
        known = self._answers.get(order.order_id)
        if known is None:
            return None
        action, answer = known
        if action is not None and action is not order.action:
            reason = f"this id was used for the order {action.value!r}; give each order its own"
            return MissionAnswer(order_id=order.order_id, gateway=self.gateway, is_taken=False, phase=answer.phase, reason=reason)
        return answer

    def note(self, order: MissionOrder, answer: MissionAnswer) -> None:
        """Remember an answer; that to ``SHOW`` is another one each time."""
        if order.action is not MissionAction.SHOW:
            self._keep(order.order_id, order.action, answer)

    def _keep(self, order_id: str, action: MissionAction | None, answer: MissionAnswer) -> None:
        self._answers[order_id] = (action, answer)
        while len(self._answers) > _MAX_REMEMBERED:
            self._answers.popitem(last=False)
