"""What befalls the topology, in order, and how it heals."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Final

from studies.campaign.services import Service
from studies.sites.plan import BETWEEN_ROUTERS, MEADOW, MOVED
from studies.sites.wires import Cable, Wires


@dataclass(slots=True, kw_only=True)
class Troubles:
    """What is out of order now; the deeds that make it so, and undo them."""

    wires: Wires
    routers: dict[str, Service]
    cut: set[Cable] = field(default_factory=set)
    dead: set[str] = field(default_factory=set)

    def pull(self, cable: Cable) -> None:
        """Pull a cable."""
        self.cut.add(cable)
        self.wires.pull(cable)

    def plug(self, cable: Cable) -> None:
        """Put it in again."""
        self.wires.plug(cable)
        self.cut.discard(cable)

    def swallow(self, cable: Cable) -> None:
        """Have all that a cable carries vanish."""
        self.cut.add(cable)
        self.wires.swallow(cable)

    def pass_on(self, cable: Cable) -> None:
        """Have it carried again."""
        self.wires.pass_on(cable)
        self.cut.discard(cable)

    def kill(self, router: str) -> None:
        """Kill a router."""
        self.dead.add(router)
        self.routers[router].kill()

    def revive(self, router: str) -> None:
        """Start it again."""
        self.routers[router].start()
        self.dead.discard(router)

    def freeze(self, router: str) -> None:
        """Stop a router where it is."""
        self.dead.add(router)
        self.routers[router].freeze()

    def thaw(self, router: str) -> None:
        """Let it go on."""
        self.routers[router].thaw()
        self.dead.discard(router)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """``begin`` and ``heal`` are deeds on `Troubles`; ``has_move``: the gateway `MOVED` is started at its other router before it heals."""

    name: str
    lasts_s: float
    begin: Callable[[Troubles], None]
    heal: Callable[[Troubles], None]
    has_move: bool = False


Mover = Callable[[], Awaitable[None]]

_SHORT_S: Final = 4.0
_LONG_S: Final = 14.0
"""Longer than a stop is given again to a gateway that is away (10 s)."""


def all_faults() -> tuple[Fault, ...]:
    """Return the faults, in order. Whatever has healed has healed before the next begins."""
    a1, a2, a3 = ((one.host, one.router) for one in MEADOW.gateways)
    mapper = (MEADOW.mapper_host, MEADOW.mapper_router)
    return (
        _swallowed("gateway - router 1", a1, _SHORT_S),
        _pulled("gateway - router 2", a3, _SHORT_S),
        _swallowed("gateway - router 1, for long", a1, _LONG_S),
        _swallowed("router - router", BETWEEN_ROUTERS, _SHORT_S),
        _pulled("router - router, for long", BETWEEN_ROUTERS, _LONG_S),
        _swallowed("mapper - router 2", mapper, _SHORT_S),
        _pulled("mapper - router 2, for long", mapper, _LONG_S),
        _killed("r1", 2.0),
        _killed("r2", 2.0),
        _killed("r2", _LONG_S),
        _frozen("r1", _SHORT_S),
        _frozen("r2", _SHORT_S),
        Fault(
            name=f"{MOVED.name} carried from router 1 to router 2",
            lasts_s=_SHORT_S,
            begin=lambda now: now.pull(a2),
            heal=lambda _: None,
            has_move=True,
        ),
        _killed("r1", _SHORT_S),
        _swallowed("router - router, once more", BETWEEN_ROUTERS, _SHORT_S),
    )


def _swallowed(where: str, cable: Cable, lasts_s: float) -> Fault:
    return Fault(
        name=f"packets vanish, {where}", lasts_s=lasts_s, begin=lambda now: now.swallow(cable), heal=lambda now: now.pass_on(cable)
    )


def _pulled(where: str, cable: Cable, lasts_s: float) -> Fault:
    return Fault(name=f"cable pulled, {where}", lasts_s=lasts_s, begin=lambda now: now.pull(cable), heal=lambda now: now.plug(cable))


def _killed(router: str, lasts_s: float) -> Fault:
    return Fault(
        name=f"router {router[1]} killed, started again",
        lasts_s=lasts_s,
        begin=lambda now: now.kill(router),
        heal=lambda now: now.revive(router),
    )


def _frozen(router: str, lasts_s: float) -> Fault:
    return Fault(
        name=f"router {router[1]} stands still", lasts_s=lasts_s, begin=lambda now: now.freeze(router), heal=lambda now: now.thaw(router)
    )
