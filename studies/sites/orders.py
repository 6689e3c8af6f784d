"""Commands that are given while links are cut and when they are healed, and what the insects truly did.

Each biobot is given one order at most, so that the simulator's truth alone says what came of it: what is confirmed was carried out, what is
said not to have been delivered was not, no train was given twice, and nothing was carried out without an order.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from studies.sites.page import Page

CONFIRMED: Final = "biobot_confirmed"
_NOTHING_DONE: Final = frozenset({"undelivered", "refused"})


@dataclass(slots=True, kw_only=True)
class Order:
    """An order: to whom, through which gateway, what was answered at first and what was known of it in the end."""

    biobot: int
    gateway: str
    action: str
    occasion: str
    is_cut: bool
    """The gateway could not be reached when it was given."""
    status: int
    command_id: str
    first: str | None
    last: str | None = None


@dataclass(slots=True, kw_only=True)
class OrderDesk:
    """Gives orders to biobots of one site, to each at most one."""

    page: Page
    given: list[Order] = field(default_factory=list)

    def give(self, action: str, *, gateway: str, occasion: str, is_cut: bool, wait_s: float) -> Order | None:
        """Order something of a biobot that a gateway heard last; None where there is none left."""
        used = {one.biobot for one in self.given}
        heard = [one for one in self.page.get("/api/v1/biobots")["biobots"] if one["gateway"] == gateway and one["id"] not in used]
        newest = max(heard, key=lambda one: one["last_heard_wall_ns"] or 0, default=None)
        if newest is None:
            return None
        command_id = f"{action}-{newest['id']}"
        body = {"biobot": newest["id"], "action": action, "id": command_id, "wait_s": wait_s}
        status, answer = self.page.post("/api/v1/commands", body)
        order = Order(
            biobot=newest["id"],
            gateway=gateway,
            action=action,
            occasion=occasion,
            is_cut=is_cut,
            status=status,
            command_id=command_id,
            first=answer.get("outcome"),
        )
        self.given.append(order)
        return order

    def follow_up(self) -> list[Order]:
        """Ask what is known of all orders now; return those that have not ended."""
        for order in self.given:
            order.last = self.page.get(f"/api/v1/commands/{order.command_id}")["outcome"]
        return [order for order in self.given if order.last is None]


def find_lies(orders: Iterable[Order], commands: Iterable[Mapping[str, Any]]) -> list[str]:
    """Say which orders ended otherwise than the insects were truly told, one line each; and what nobody had ordered.

    ``commands`` is what each backpack carried out, as `biobot-sim serve` tells it in ``run.json``. A stop may be carried out twice, where
    two gateways give it; its train is given once.
    """
    done: dict[tuple[int, str], list[bool]] = defaultdict(list)
    for one in commands:
        if one["action"] is not None:
            done[one["id"], one["action"]].append(one["responded"] is not None)
    lies = []
    for order in orders:
        trains = done.pop((order.biobot, order.action), [])
        told = f"{order.action} of {order.biobot} at {order.gateway} ({order.occasion})"
        if order.last is None:
            lies.append(f"{told} has no end")
        elif order.last == CONFIRMED and not trains:
            lies.append(f"{told} is confirmed, and was not carried out")
        elif order.last in _NOTHING_DONE and trains:
            lies.append(f"{told} is {order.last}, and was carried out")
        elif sum(trains) > 1:
            lies.append(f"{told} gave {sum(trains)} trains")
    return lies + [f"{action} of {biobot} was carried out, and nobody ordered it" for biobot, action in done]
