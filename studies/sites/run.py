"""The topology is set up, lives through its faults while insects walk, comes to rest, and is accounted for."""

import asyncio
import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from firmware_protocol.contract.sessions import TlsTable
from studies.campaign.levels import Level, read_levels
from studies.campaign.services import Service
from studies.errors import SitesError
from studies.ledger import Ledger, check_ledger
from studies.sites.faults import Fault, Troubles
from studies.sites.house import House, Registry
from studies.sites.orders import CONFIRMED, Order, OrderDesk, find_lies
from studies.sites.page import Page
from studies.sites.plan import MEADOW, MOVED, ROUTERS, SITES, STRANGERS_HOST, SitePlan, all_cables, find_cut_off
from studies.sites.strangers import FORGED_PAIR, StrangersPlan, problems_with_stranger, try_strangers
from studies.sites.wires import Wires

_START_S: Final = 90.0
_LEVEL_S: Final = 60.0
_DRAIN_S: Final = 120.0
_POLL_S: Final = 0.05
_KNOWN_S: Final = 2.5
"""So long after a cut the mapper knows of it: the lease of a link is 2 s."""

_WAIT_S: Final = 15.0
_STRANGERS_S: Final = 6.0
_MOST_TRIES: Final = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """``out``: where all files are; ``speed``: insects are so much faster than life; ``calm_s``: before each fault [s]."""

    out: Path
    faults: Sequence[Fault]
    speed: float
    calm_s: float


@dataclass(slots=True, kw_only=True)
class Post:
    """A site as it runs. ``dongles``: where each gateway, by its name, finds its dongle."""

    plan: SitePlan
    swarm: Service
    mapper: Service
    page: Page
    gateways: dict[str, Service] = field(default_factory=dict)
    dongles: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a fault did: who was cut off, and how long after the healing [s] all were seen again, and all journaled by then was stored."""

    name: str
    lasts_s: float
    cut_off: list[str]
    seen_after_s: float
    level_after_s: float


@dataclass(slots=True, kw_only=True)
class Findings:
    """All that came out; what must not be is in ``problems``."""

    outcomes: list[Outcome] = field(default_factory=list)
    orders: list[Order] = field(default_factory=list)
    ledgers: dict[str, Ledger] = field(default_factory=dict)
    strangers: list[dict[str, Any]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    n_wanderers: int = 0
    """Biobots of the first site that the mapper saw at two gateways or more."""
    n_joint: int = 0
    """Encounters of the first site that two gateways recorded, each in part or whole."""
    seconds: float = 0.0
    cpu_s: dict[str, float] = field(default_factory=dict)
    peak_rss: dict[str, int] = field(default_factory=dict)
    n_ended: dict[str, int] = field(default_factory=dict)
    """How often a process ended by itself, and was started again."""
    carried: dict[str, int] = field(default_factory=dict)
    """Bytes by cable."""


class Topology:
    """Runs once; `close` ends whatever still runs."""

    def __init__(self, *, plan: Plan, house: House) -> None:
        self.found = Findings()
        self._plan = plan
        self._house = house
        self._routers = {name: house.router(name) for name in ROUTERS}
        self._troubles = Troubles(wires=house.wires, routers=self._routers)
        self._posts: dict[str, Post] = {}
        self._at = {one.host: one.router for site in SITES for one in site.gateways}
        self._homes: dict[int, set[str]] = defaultdict(set)
        self._keepers: list[asyncio.Task[None]] = []

    async def live(self) -> Findings:
        """See the module.

        Raises
        ------
        SitesError
            A part did not do what it was started for.
        """
        begun_s = time.monotonic()
        strangers = _tables_of_strangers(self._house.registry, out=self._plan.out)
        for router in self._routers.values():
            self._start(router)
        for site in SITES:
            await self._open(site)
        await self._wait(lambda: all(map(_is_whole, self._posts.values())), what="all gateways are seen by their mappers", limit_s=_START_S)
        late = self._house.registry.table(f"{MEADOW.name}/gateway/late")  # after the routers have read their roster
        desk = OrderDesk(page=self._posts[MEADOW.name].page)
        attempts = asyncio.create_task(self._let_strangers_try({**strangers, "not on the roster": late}))
        for fault in self._plan.faults:
            await asyncio.sleep(self._plan.calm_s)
            self._note_homes()
            await self._befall(fault, desk)
        self.found.strangers = await attempts
        await asyncio.sleep(self._plan.calm_s)
        await self._come_to_rest(desk)
        self.found.seconds = time.monotonic() - begun_s
        self.found.cpu_s = {name: service.cpu_s() for name, service in self._services().items()}
        self.found.n_ended = {name: service.n_ended for name, service in self._services().items() if service.n_ended}
        self.found.peak_rss = {name: service.peak_rss for name, service in self._services().items()}
        for service in reversed(self._services().values()):
            await service.stop()
        return self.found

    def close(self) -> None:
        """End what still runs."""
        for keeper in self._keepers:
            keeper.cancel()
        for service in self._services().values():
            service.kill()

    def _services(self) -> dict[str, Service]:
        services = [*self._routers.values()]
        for post in self._posts.values():
            services += [post.swarm, *post.gateways.values(), post.mapper]
        return {service.name: service for service in services}

    async def _open(self, site: SitePlan) -> None:
        house = self._house
        mapper, page = house.mapper(site)
        post = Post(plan=site, swarm=house.swarm(site, speed=self._plan.speed), mapper=mapper, page=page)
        self._posts[site.name] = post
        self._start(post.swarm)
        await self._wait(lambda: bool(house.dongles(site)), what=f"the swarm of {site.name} is there", limit_s=_START_S)
        for one, dongle in zip(site.gateways, house.dongles(site), strict=True):
            post.dongles[one.name] = dongle
            post.gateways[one.name] = house.gateway(site, one, dongle=dongle)
            self._start(post.gateways[one.name])
        self._start(mapper)

    def _start(self, service: Service) -> None:
        """Start a service, and have it started again where it ends by itself, as under a service manager."""
        service.start()
        self._keepers.append(asyncio.create_task(service.keep()))

    async def _befall(self, fault: Fault, desk: OrderDesk) -> None:
        """Let a fault begin, give orders across it, heal it, and see how soon all is well; then give orders again."""
        _say(fault.name)
        troubles = self._troubles
        fault.begin(troubles)
        cut_off = find_cut_off(MEADOW, routers=self._at, cut=troubles.cut, dead=troubles.dead)
        if fault.has_move:
            await self._move()
        await asyncio.sleep(min(_KNOWN_S, fault.lasts_s))
        if cut_off:
            gateway = cut_off[0]
            for action, wait_s in (("turn_left", _WAIT_S), ("stop", 0.0)):
                await asyncio.to_thread(desk.give, action, gateway=gateway, occasion=f"cut: {fault.name}", is_cut=True, wait_s=wait_s)
        await asyncio.sleep(max(0.0, fault.lasts_s - _KNOWN_S))
        fault.heal(troubles)
        healed_s = time.monotonic()
        heads = {name: level.head for name, level in (await self._levels(MEADOW)).items()}

        def is_level(levels: dict[str, Level]) -> bool:
            return all(levels[name].watermark >= head for name, head in heads.items())

        seen, level = await asyncio.gather(
            self._wait(lambda: _is_whole(self._posts[MEADOW.name]), what=f"{fault.name}: all are seen again", limit_s=_LEVEL_S),
            self._wait_level(is_level, what=f"{fault.name}: the store has all"),
        )
        outcome = Outcome(
            name=fault.name, lasts_s=fault.lasts_s, cut_off=cut_off, seen_after_s=seen - healed_s, level_after_s=level - healed_s
        )
        self.found.outcomes.append(outcome)
        for gateway in cut_off or [MEADOW.gateways[0].name]:
            for action in ("turn_left", "stop"):
                await self._order_until_done(desk, action, gateway=gateway, occasion=f"healed: {fault.name}")

    async def _order_until_done(self, desk: OrderDesk, action: str, *, gateway: str, occasion: str) -> None:
        """Order something of one biobot after the other until one has done it: the others had walked out of this gateway's reach."""
        for _ in range(_MOST_TRIES):
            order = await asyncio.to_thread(desk.give, action, gateway=gateway, occasion=occasion, is_cut=False, wait_s=_WAIT_S)
            if order is None or order.first == CONFIRMED:
                return
        self.found.problems.append(f"{action} at {gateway}, {occasion}: none of {_MOST_TRIES} biobots did it")

    async def _move(self) -> None:
        """Start the gateway that is moved at its other router; its journal goes with it."""
        post, (other,) = self._posts[MEADOW.name], (name for name in ROUTERS if name != self._at[MOVED.host])
        service = post.gateways[MOVED.name]
        await service.stop()
        self._house.connect_gateway(MEADOW, MOVED, router=other, dongle=post.dongles[MOVED.name])
        self._at[MOVED.host] = other
        service.start()

    async def _come_to_rest(self, desk: OrderDesk) -> None:
        """End the insects' walk, wait until all is stored, and make the account."""
        for post in self._posts.values():
            post.swarm.end()
        await self._wait(lambda: not any(p.swarm.is_running for p in self._posts.values()), what="the swarms' end", limit_s=_DRAIN_S)
        for name, post in self._posts.items():
            truth = self._house.truth(post.plan)
            if post.swarm.exit_status or not (truth / "run.json").exists():
                raise SitesError(f"the swarm of {name} ended with status {post.swarm.exit_status}; its log is {post.swarm.log}")
            await self._settle(post)
            self.found.ledgers[name] = self._account(post, truth)
        truth = self._house.truth(MEADOW)
        await self._wait(lambda: not desk.follow_up(), what="all orders have ended", limit_s=_LEVEL_S)
        self.found.orders = desk.given
        self.found.problems += find_lies(desk.given, json.loads((truth / "run.json").read_text(encoding="utf-8"))["commands"])
        self.found.n_wanderers = sum(len(homes) > 1 for homes in self._homes.values())
        self.found.carried = {" - ".join(cable): self._house.wires.carried(cable) for cable in all_cables()}

    async def _settle(self, post: Post) -> None:
        def is_level(levels: dict[str, Level]) -> bool:
            return all(level.is_level and level.head for level in levels.values())

        await self._wait_level(is_level, what=f"the store of {post.plan.name} has all", site=post.plan)
        await self._wait(lambda: _is_mapped(post), what=f"the mapper of {post.plan.name} has taken in all", limit_s=_LEVEL_S)

    def _account(self, post: Post, truth: Path) -> Ledger:
        """Hold a site's store against what its backpacks reported, and look for anything from elsewhere."""
        name, problems = post.plan.name, self.found.problems
        records = post.page.encounters()
        ledger = check_ledger(truth, records)
        problems += [f"{name}: {node_a} and {node_b} at {start_s:.3f} s is missing" for node_a, node_b, start_s in ledger.missing]
        problems += [f"{name}: {node_a} and {node_b} at {start_s:.3f} s is there twice" for node_a, node_b, start_s in ledger.doubled]
        own = set(post.plan.hosts)
        gateways = {record["gateway"] for record in records} | {one["name"] for one in post.page.get("/api/v1/gateways")["gateways"]}
        problems += [f"{name}: its mapper heard of gateway {other}" for other in sorted(gateways - own)]
        journals = {record["journal"] for record in records}
        if len(journals) > len(own):
            problems.append(f"{name}: its mapper has records of {len(journals)} journals, but {len(own)} gateways")
        sites = [one["name"] for one in post.page.get("/api/v1/sites")["sites"]]
        problems += [f"{name}: its mapper sees site {other}" for other in sites if other != name]
        if any((record["node_a"], record["node_b"]) == FORGED_PAIR for record in records):
            problems.append(f"{name}: what strangers forged is in the store")
        if post.plan is MEADOW:
            self.found.n_joint = sum(bool(record["joint"]) and record["joint"]["is_counted"] for record in records)
        return ledger

    async def _let_strangers_try(self, tables: dict[str, TlsTable]) -> list[dict[str, Any]]:
        """Let all strangers try at once, on a machine of their own."""
        await asyncio.sleep(self._plan.calm_s)
        plan = StrangersPlan(
            endpoint=self._house.endpoint("r1", cable=(STRANGERS_HOST, "r1")),
            site=MEADOW.name,
            gateway=MEADOW.gateways[0].name,
            seconds=_STRANGERS_S,
            tables=tables,
        )
        prefix, file = self._house.wires.prefix(STRANGERS_HOST), self._plan.out / "strangers.json"
        told = await asyncio.to_thread(try_strangers, plan, prefix=prefix, file=file)
        for one in told:
            self.found.problems += problems_with_stranger(one, may_hear=one["name"] == VIEWER)
        return told

    def _note_homes(self) -> None:
        for one in self._posts[MEADOW.name].page.get("/api/v1/biobots")["biobots"]:
            self._homes[one["id"]].add(one["gateway"])

    async def _levels(self, site: SitePlan) -> dict[str, Level]:
        journals = {one.name: self._house.journal(one) for one in site.gateways}
        return await asyncio.to_thread(read_levels, journals, self._house.store(site), window=None)

    async def _wait_level(self, is_level: Callable[[dict[str, Level]], bool], *, what: str, site: SitePlan = MEADOW) -> float:
        deadline_s = time.monotonic() + _LEVEL_S
        while not is_level(levels := await self._levels(site)):
            if time.monotonic() > deadline_s:
                raise SitesError(f"{what}: not after {_LEVEL_S:g} s: {levels}; the logs are in {self._plan.out}")
            await asyncio.sleep(_POLL_S)
        return time.monotonic()

    async def _wait(self, claim: Callable[[], bool], *, what: str, limit_s: float) -> float:
        """Return when a claim was true; it is asked on a thread, and an answer that does not come counts as no."""
        deadline_s = time.monotonic() + limit_s
        while not await asyncio.to_thread(_holds, claim):
            if time.monotonic() > deadline_s:
                raise SitesError(f"{what}: not after {limit_s:g} s; the logs are in {self._plan.out}")
            await asyncio.sleep(_POLL_S)
        return time.monotonic()


VIEWER: Final = "viewer of the site"


def _tables_of_strangers(registry: Registry, *, out: Path) -> dict[str, TlsTable]:
    """Return what strangers show; those of the authority are on the roster, but for whom a certificate is made later."""
    name = f"{MEADOW.name}/gateway/{MEADOW.gateways[0].name}"
    other = Registry(out / "other-pki").table(name)
    mine = registry.table(f"{MEADOW.name}/viewer/eve")
    return {
        "certificate of another authority": TlsTable(ca=mine.ca, certificate=other.certificate, key=other.key),
        "no certificate": TlsTable(ca=mine.ca),
        "certificate out of date": registry.table(f"{MEADOW.name}/operator/old", age_days=60),
        VIEWER: mine,
        "gateway of the site, under another's name": registry.table(f"{MEADOW.name}/gateway/rogue"),
        "gateway of the other site": registry.table("barn/gateway/base9"),
        "mapper of the other site": registry.table("barn/mapper/map9"),
        "operator of the other site": registry.table("barn/operator/olaf"),
    }


def counted(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the encounters that count, each once, whichever gateways told of it."""
    found = []
    for record in records:
        joint = record["joint"]
        if record["is_void"] or (joint and not joint["is_counted"]):
            continue
        found.append(record if joint is None else {**record, **{key: joint[key] for key in ("t_start_wall_ns", "t_end_wall_ns")}})
    return found


def _is_whole(post: Post) -> bool:
    return post.page.gateways_alive() == sorted(post.plan.hosts)


def _is_mapped(post: Post) -> bool:
    status = post.page.get("/api/v1/map/status")
    return not status["n_waiting"] and not status["is_computing"]


def _holds(claim: Callable[[], bool]) -> bool:
    try:
        return claim()
    except OSError:  # nobody answers yet
        return False


def _say(text: str) -> None:
    sys.stderr.write(f"{time.strftime('%H:%M:%S')}  {text}\n")
    sys.stderr.flush()


async def run(plan: Plan) -> Findings:
    """Run it all.

    Raises
    ------
    SitesError
        It could not be run to its end.
    """
    with Wires(all_cables()) as wires:
        topology = Topology(plan=plan, house=House(out=plan.out, wires=wires, registry=Registry(plan.out / "pki")))
        try:
            return await topology.live()
        finally:
            topology.close()
