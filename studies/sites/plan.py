"""The topology: which machines there are, which cables lie between them, and what runs where. Plain data; no I/O."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from studies.sites.wires import HALL, Cable

ROUTERS: Final = ("r1", "r2")
STRANGERS_HOST: Final = "x"

BETWEEN_ROUTERS: Final = ("r1", "r2")


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayPlan:
    """A gateway: its name on the bus, its machine, and the router that it is connected to at first."""

    name: str
    host: str
    router: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SitePlan:
    """A site with a swarm of its own. ``seed`` and ``n_biobots`` are the swarm's; each gateway has one dongle, in its part of the arena."""

    name: str
    gateways: tuple[GatewayPlan, ...]
    mapper: str
    mapper_host: str
    mapper_router: str
    n_biobots: int
    seed: int

    @property
    def hosts(self) -> dict[str, str]:
        """Each gateway's machine."""
        return {one.name: one.host for one in self.gateways}


MEADOW: Final = SitePlan(
    name="meadow",
    gateways=(
        GatewayPlan(name="base1", host="a1", router="r1"),
        GatewayPlan(name="base2", host="a2", router="r1"),
        GatewayPlan(name="base3", host="a3", router="r2"),
    ),
    mapper="map1",
    mapper_host="am",
    mapper_router="r2",
    n_biobots=120,
    seed=1,
)

BARN: Final = SitePlan(
    name="barn",
    gateways=(GatewayPlan(name="base1", host="b1", router="r2"),),
    mapper="map1",
    mapper_host="bm",
    mapper_router="r1",
    n_biobots=40,
    seed=2,
)
"""A second site behind the same routers. Its gateway, its mapper and its biobots are called as some of the first site are, on purpose."""

SITES: Final = (MEADOW, BARN)

MOVED: Final = MEADOW.gateways[1]
"""The gateway that is carried from its router to the other one."""


def radio_cable(host: str) -> Cable:
    """Return the cable between a gateway and its dongle; it is never cut."""
    return HALL, host


def page_cable(site: SitePlan) -> Cable:
    """Return the cable over which the mapper is asked; it is never cut."""
    return HALL, site.mapper_host


def all_cables() -> tuple[Cable, ...]:
    """Return all cables of the topology."""
    cables: list[Cable] = [BETWEEN_ROUTERS]
    for site in SITES:
        cables += [(one.host, one.router) for one in site.gateways]
        cables += [(site.mapper_host, site.mapper_router), page_cable(site)]
        cables += [radio_cable(one.host) for one in site.gateways]
    return (*cables, (MOVED.host, "r2"), (STRANGERS_HOST, "r1"))


def find_cut_off(site: SitePlan, *, routers: Mapping[str, str], cut: Collection[Cable], dead: Collection[str]) -> list[str]:
    """Name the gateways of a site that its mapper cannot reach.

    Parameters
    ----------
    routers
        The router that each gateway's machine is connected to now.
    cut, dead
        Cables that carry nothing, and routers that do not run.
    """
    joined = BETWEEN_ROUTERS not in cut

    def is_up(host: str, router: str) -> bool:
        return router not in dead and (host, router) not in cut

    names = []
    for one in site.gateways:
        router = routers[one.host]
        is_one_router = router == site.mapper_router
        if not (is_up(one.host, router) and is_up(site.mapper_host, site.mapper_router) and (is_one_router or joined)):
            names.append(one.name)
    return names
