"""One round: a site is set up, lives through its faults, comes to rest, and is accounted for."""

import asyncio
import contextlib
import json
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec

from firmware_protocol.units import NS_PER_S
from studies.campaign.accounting import settle
from studies.campaign.director import Director, GatewayPost, MapperPost, wait_until
from studies.campaign.ledger import read_ledger
from studies.campaign.meetings import QUICK_PACE, Pace, count_biobots
from studies.campaign.plan import Kind, Unit, draw_faults
from studies.campaign.services import Service, YardHandle
from studies.campaign.surroundings import Disk, Network, WallClocks, is_in_namespaces
from studies.campaign.yard_config import YardConfig
from studies.errors import CampaignError
from studies.ports import free_port

DIALECTS = (
    ("pty native", "tcp native", "pty xbee", "slcan can"),
    ("pty znp", "tcp can", "pty xbee-ap1", "pty canfd"),
)
"""What stands behind each gateway: kind of line and dialect of dongle."""

_HOSTS = ("g1", "g2", "mapper")
HAS_ROUTER = find_spec("gateway.router") is not None
_BYTES_PER_ENCOUNTER = 4_000
_SMALLEST_DISK = 128 << 20
_READY_S = 60.0
_LONGEST_DRAIN_S = 600.0
_SAY_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundPlan:
    """What a round is to be. ``rate`` is meetings a second; a quick one is over some seconds after its last meeting began."""

    seed: int
    n_encounters: int
    n_faults: int
    rate: float
    is_mapper_down_half: bool
    is_quick: bool
    directory: Path


@dataclass(slots=True, kw_only=True)
class Site:
    """Everything of a round that runs."""

    plan: RoundPlan
    network: Network = field(default_factory=lambda: Network(hosts=_HOSTS))
    clocks: WallClocks = field(init=False)
    disks: list[Disk] = field(default_factory=list)
    services: list[Service] = field(default_factory=list)
    yards: list[YardHandle] = field(default_factory=list)
    bus_port: int = field(default_factory=free_port)

    def __post_init__(self) -> None:
        self.clocks = WallClocks(self.plan.directory / "clocks")

    def hall_endpoint(self, host: str) -> str:
        """Return where a host finds the router."""
        return f"tcp/{self.network.address_of_hall(host)}:{self.bus_port}"

    def own_endpoint(self, host: str) -> str:
        """Return where a host is to be found by others."""
        return f"tcp/{self.network.address_of(host)}:{self.bus_port + _HOSTS.index(host)}"

    @property
    def n_meetings(self) -> int:
        """Meetings that have begun."""
        return sum(int(yard.state.get("meetings", 0)) for yard in self.yards)

    @property
    def n_waiting(self) -> int:
        """Encounters that backpacks hold."""
        return sum(int(yard.state.get("waiting", 0)) for yard in self.yards)

    async def watch_yards(self) -> None:
        """Raise where a yard has ended: without it there is no account.

        Raises
        ------
        CampaignError
            Naming the yard and its log.
        """
        while True:
            await asyncio.sleep(0.5)
            for yard in self.yards:
                if yard.has_ended.is_set():
                    raise CampaignError(f"yard {yard.name} has ended; its log is {yard.log}")

    def impossible(self) -> dict[str, str]:
        """Return what cannot be done on this machine, and why."""
        problems = {"cutting networks": self.network.problem, "setting wall clocks": self.clocks.problem}
        problems["filling disks"] = next((disk.problem for disk in self.disks if disk.problem), None)
        problems["killing routers"] = None if HAS_ROUTER else "this gateway has no router"
        return {what: why for what, why in problems.items() if why}

    def close(self) -> None:
        """End what still runs, and take away what was set up."""
        for yard in self.yards:
            yard.kill()
        for service in self.services:
            service.kill()
        for disk in self.disks:
            disk.close()
        self.network.close()


async def run_round(plan: RoundPlan) -> dict[str, Any]:
    """Run a round; return its facts, those of its account among them.

    Raises
    ------
    CampaignError
        It could not be run to its end.
    """
    plan.directory.mkdir(parents=True, exist_ok=True)
    site = Site(plan=plan)
    try:
        return await _run(site)
    finally:
        site.close()


async def _run(site: Site) -> dict[str, Any]:
    plan, loop = site.plan, asyncio.get_running_loop()
    site.network.open()
    site.clocks.open()
    begun_s = time.monotonic()
    async with asyncio.TaskGroup() as group:
        posts = await _open_gateways(site, group)
        router, mapper = _make_router(site), _make_mapper(site)
        site.services += [*([router] if router else []), *(post.service for post in posts), mapper.service]
        keepers = [group.create_task(service.keep()) for service in site.services]
        for service in [*([router] if router else []), *(post.service for post in posts)]:
            service.start()
        await wait_until(lambda: all(post.yard.state.get("open") == post.n_lines for post in posts), timeout_s=_READY_S)
        begins_at_ns = time.monotonic_ns() + NS_PER_S
        for yard in site.yards:
            yard.order(do="begin", at_ns=begins_at_ns)
        span_s = plan.n_encounters / plan.rate
        mapper_from_s = 0.5 * span_s if plan.is_mapper_down_half else 0.0
        faults = draw_faults(
            plan.seed, n_faults=plan.n_faults, span_s=span_s, kinds=_kinds(site, router), counts=_COUNTS,
            mapper_from_s=mapper_from_s + 1.0, brevity=0.4 if plan.is_quick else 1.0,
        )  # fmt: skip
        director = Director(
            gateways=posts, mapper=mapper, router=router, network=site.network, clocks=site.clocks, t0_s=loop.time()
        )  # fmt: skip
        keepers.append(group.create_task(site.watch_yards()))
        keepers.append(group.create_task(_say_progress(site, director, n_faults=len(faults))))
        keepers.append(group.create_task(_start_mapper(site, mapper)))
        await director.play(faults)
        await wait_until(lambda: site.n_meetings >= plan.n_encounters and mapper.has_started.is_set())
        for yard in site.yards:
            yard.order(do="stop")
        pace = QUICK_PACE if plan.is_quick else Pace()
        await asyncio.sleep(0.5)
        is_settled = await wait_until(
            lambda: all(y.state.get("is_settled") for y in site.yards), timeout_s=_LONGEST_DRAIN_S + pace.longest_s
        )
        is_level = await _wait_level(director)
        levels = await director.levels()
        seconds = time.monotonic() - begun_s
        for task in keepers:
            task.cancel()
        for yard in site.yards:
            yard.order(do="quit")
        for service in reversed(site.services):
            await service.stop()
    _say("accounting")
    account = await asyncio.to_thread(
        settle, {yard.name: read_ledger(yard.config.parent / "ledger.bin") for yard in site.yards}, mapper.store
    )
    facts: dict[str, Any] = {
        "seed": plan.seed,
        "rate": plan.rate,
        "mapper_down_half": plan.is_mapper_down_half,
        "seconds": seconds,
        "is_settled": is_settled,
        "is_level": is_level,
        "is_sound": account.is_sound and is_settled and is_level,
        "account": asdict(account),
        "outcomes": [[one.kind.name, one.recovery_s, one.is_late, one.is_void] for one in director.outcomes],
        "levels": {name: [level.head, level.watermark] for name, level in levels.items()},
        "left_out": sum(int(yard.state["left_out"]) for yard in site.yards),
        "dropped": sum(int(yard.state["dropped"]) for yard in site.yards),
        "ended_by_itself": {service.name: service.n_ended for service in site.services},
        "hung": {service.name: service.n_hung for service in site.services},
        "peak_rss": {one.name: one.peak_rss for one in site.services} | {f"yard {one.name}": one.peak_rss for one in site.yards},
        "said": {service.name: _count_said(service.log) for service in site.services},
        "impossible": site.impossible(),
        "disks": sorted({disk.kind for disk in site.disks if disk.problem is None}),
    }
    (plan.directory / "facts.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    if account.is_sound:
        for yard in site.yards:
            (yard.config.parent / "ledger.bin").unlink()
    else:
        _keep_evidence(plan.directory, mapper, posts)
    return facts


_COUNTS = {Unit.LINE: sum(map(len, DIALECTS)), Unit.GATEWAY: len(DIALECTS), Unit.MAPPER: 1, Unit.ROUTER: 1}


async def _open_gateways(site: Site, group: asyncio.TaskGroup) -> list[GatewayPost]:
    """Start the yards, and say how the gateways in front of them are to be run."""
    plan = site.plan
    t0_ns = time.monotonic_ns()
    posts = []
    for number, dialects in enumerate(DIALECTS):
        name = _HOSTS[number]
        place = plan.directory / name
        place.mkdir(exist_ok=True)
        (place / "ledger.bin").unlink(missing_ok=True)
        lines = tuple(_link(site, name, at, *one.split()) for at, one in enumerate(dialects))
        config = YardConfig(
            seed=plan.seed, rate=plan.rate, n_biobots=count_biobots(plan.rate), lines=lines,
            dongles_before=sum(map(len, DIALECTS[:number])), n_dongles=_COUNTS[Unit.LINE], t0_ns=t0_ns, is_quick=plan.is_quick,
            directory=str(place), mode_period_s=20.0 if plan.is_quick else 30.0,
        )  # fmt: skip
        (place / "yard.json").write_bytes(msgspec.json.encode(config))
        yard = YardHandle(name=name, config=place / "yard.json", log=place / "yard.log")
        await yard.start()
        site.yards.append(yard)
        group.create_task(yard.listen())
        posts.append(_make_gateway(site, name, yard, n_lines=len(lines)))
    for post in posts:
        async with asyncio.timeout(_READY_S):
            await post.yard.ready.wait()
        _write_gateway_config(site, post)
    return posts


def _link(site: Site, gateway: str, at: int, kind: str, dialect: str) -> str:
    path = site.plan.directory / gateway / f"line{at}"
    match kind:
        case "tcp":
            return f"tcp:{site.network.address_of_hall(gateway)}:0?dialect={dialect}"
        case "slcan":
            return f"slcan:{path}?unit=3"
        case _:
            return f"pty:{path}?dialect={dialect}"


def _make_gateway(site: Site, name: str, yard: YardHandle, *, n_lines: int) -> GatewayPost:
    place = site.plan.directory / name
    disk = _open_disk(site, place / "disk")
    service = Service(
        name=name,
        arguments=["gateway", "run", "--config", str(place / "gateway.toml")],
        prefix=site.network.prefix(name),
        environment=site.clocks.environment(name),
        log=place / "gateway.log",
    )
    return GatewayPost(name=name, service=service, yard=yard, disk=disk, journal=disk.place / "journal.sqlite", n_lines=n_lines)


def _write_gateway_config(site: Site, post: GatewayPost) -> None:
    lines = [
        f"name = {json.dumps(post.name)}",
        f"ports = {json.dumps(list(post.yard.addresses))}",
        f"journal = {json.dumps(str(post.journal))}",
        f"listen = {json.dumps([] if HAS_ROUTER else [site.own_endpoint(post.name)])}",
        f"connect = {json.dumps([site.hall_endpoint(post.name)] if HAS_ROUTER else [])}",
        "[link]",
        "max_backoff_s = 2.0",
    ]
    (site.plan.directory / post.name / "gateway.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _make_router(site: Site) -> Service | None:
    if not HAS_ROUTER:
        return None
    return Service(
        name="router",
        arguments=["gateway", "router", "--listen", f"tcp/0.0.0.0:{site.bus_port}"],
        prefix=[],
        environment={},
        log=site.plan.directory / "router.log",
    )


def _make_mapper(site: Site) -> MapperPost:
    place = site.plan.directory / "mapper"
    place.mkdir(exist_ok=True)
    disk = _open_disk(site, place / "disk")
    store = disk.place / "store.sqlite"
    # The map is not what is looked at here: a short window keeps its computation small.
    connect = [site.hall_endpoint("mapper")] if HAS_ROUTER else [site.own_endpoint(name) for name in _HOSTS[: len(DIALECTS)]]
    arguments = [
        "mapper", "serve", *(word for end in connect for word in ("--connect", end)), "--store", str(store), "--port", "0",
        "--window-s", "20", "--min-interval-s", "120",
    ]  # fmt: skip
    service = Service(
        name="mapper", arguments=arguments, prefix=site.network.prefix("mapper"), environment=site.clocks.environment("mapper"),
        log=place / "mapper.log",
    )  # fmt: skip
    return MapperPost(service=service, disk=disk, store=store)


def _open_disk(site: Site, place: Path) -> Disk:
    disk = Disk(place, size=_SMALLEST_DISK + site.plan.n_encounters * _BYTES_PER_ENCOUNTER)
    disk.open()
    site.disks.append(disk)
    return disk


def _kinds(site: Site, router: Service | None) -> list[Kind]:
    """Return the kinds of faults that are possible here."""
    without: set[Kind] = set()
    if site.network.problem:
        without |= {Kind.CUT_GATEWAY, Kind.CUT_MAPPER}
    if site.clocks.problem:
        without |= {Kind.JUMP_GATEWAY, Kind.JUMP_MAPPER}
    if any(disk.problem for disk in site.disks):
        without |= {Kind.FULL_JOURNAL, Kind.FULL_STORE}
    if router is None:
        without |= {Kind.KILL_ROUTER, Kind.FREEZE_ROUTER}
    return [kind for kind in Kind if kind not in without]


async def _start_mapper(site: Site, mapper: MapperPost) -> None:
    if site.plan.is_mapper_down_half:
        await wait_until(lambda: site.n_meetings >= site.plan.n_encounters / 2)
    mapper.service.start()
    mapper.has_started.set()


async def _wait_level(director: Director) -> bool:
    deadline_s = time.monotonic() + _LONGEST_DRAIN_S
    while not all(level.is_level and level.head for level in (await director.levels()).values()):
        if time.monotonic() > deadline_s:
            return False
        await asyncio.sleep(0.2)
    return True


async def _say_progress(site: Site, director: Director, *, n_faults: int) -> None:
    begun_s = time.monotonic()
    while True:
        await asyncio.sleep(_SAY_S)
        levels = await director.levels()
        behind = sum(max(0, level.head - level.watermark) for level in levels.values())
        lag_s = max((float(yard.state.get("behind_s", 0.0)) for yard in site.yards), default=0.0)
        _say(
            f"{time.monotonic() - begun_s:6.0f} s  {site.n_meetings:,} of {site.plan.n_encounters:,} meetings, {len(director.outcomes)} of "
            f"{n_faults} faults over, {site.n_waiting} encounters in backpacks, mapper {behind} records behind, yards {lag_s:.1f} s late"
        )


def _count_said(log: Path) -> dict[str, int]:
    """Count the warnings and errors of a service, by event."""
    counts: Counter[str] = Counter()
    if log.exists():
        with log.open(encoding="utf-8", errors="replace") as lines:
            for line in lines:
                with contextlib.suppress(ValueError):
                    said = json.loads(line)
                    if isinstance(said, dict) and str(said.get("level", "")).upper() in {"WARNING", "ERROR"}:
                        counts[str(said.get("event"))] += 1
    return dict(counts.most_common(12))


def _keep_evidence(directory: Path, mapper: MapperPost, posts: list[GatewayPost]) -> None:
    """Copy store and journals out of disks that are about to go."""
    evidence = directory / "evidence"
    evidence.mkdir(exist_ok=True)
    for name, path in (("store", mapper.store), *((post.name, post.journal) for post in posts)):
        for part in path.parent.glob(path.name + "*"):
            (evidence / f"{name}-{part.name}").write_bytes(part.read_bytes())


def _say(text: str) -> None:
    sys.stderr.write(f"{time.strftime('%H:%M:%S')}  {text}\n")
    sys.stderr.flush()


def describe_place() -> str:
    """Say where the services run."""
    return "network, mount and process namespaces of their own" if is_in_namespaces() else "this machine, without namespaces"
