"""Runs the site through its plan of faults, and measures how long each recovery takes."""

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from studies.campaign.levels import Level, read_levels
from studies.campaign.plan import JUMPS_S, Fault, Kind, Unit
from studies.campaign.services import Service, YardHandle
from studies.campaign.surroundings import Disk, Network, WallClocks

_POLL_S = 0.05
_LONGEST_RECOVERY_S = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a fault: how long it took from its end until the site was whole again [s].

    None where it was not to be measured: the mapper was down then, or the order was void.
    """

    kind: Kind
    recovery_s: float | None
    is_late: bool = False
    """It had not recovered within `_LONGEST_RECOVERY_S`."""
    is_void: bool = False


@dataclass(slots=True, kw_only=True)
class GatewayPost:
    """A gateway with all that belongs to it."""

    name: str
    service: Service
    yard: YardHandle
    disk: Disk
    journal: Path
    n_lines: int


@dataclass(slots=True, kw_only=True)
class MapperPost:
    """The mapper with all that belongs to it."""

    service: Service
    disk: Disk
    store: Path
    has_started: asyncio.Event = field(default_factory=asyncio.Event)


@dataclass(slots=True, kw_only=True)
class Director:
    """See the module. Times of the plan count from ``t0_s`` on the loop's clock."""

    gateways: Sequence[GatewayPost]
    mapper: MapperPost
    router: Service | None
    network: Network
    clocks: WallClocks
    t0_s: float
    outcomes: list[Outcome] = field(default_factory=list)
    _heads: dict[str, int] = field(default_factory=dict)
    _last_order: int = 0
    _ends: dict[int, asyncio.Future[bool]] = field(default_factory=dict)
    _recoveries: dict[int, asyncio.Future[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for post in self.gateways:
            post.yard.on_news = self._hear

    async def play(self, plan: Sequence[Fault]) -> None:
        """Let all faults of a plan happen; on each unit one after the other, and the next not before it has recovered."""
        units: dict[tuple[Unit, int], list[Fault]] = {}
        for fault in plan:
            units.setdefault((fault.unit, fault.index), []).append(fault)
        async with asyncio.TaskGroup() as group:
            for members in units.values():
                group.create_task(self._play_unit(members))

    async def levels(self) -> dict[str, Level]:
        """Return how far the mapper is with each gateway; of a journal that cannot be read now, with what was last known of it."""
        journals = {post.name: (post.disk.window or post.disk.place) / post.journal.name for post in self.gateways}
        levels = await asyncio.to_thread(read_levels, journals, self.mapper.store, window=self.mapper.disk.window)
        for name, level in levels.items():
            self._heads[name] = max(level.head, self._heads.get(name, 0))
        return {name: Level(head=self._heads[name], watermark=level.watermark) for name, level in levels.items()}

    async def _play_unit(self, faults: Sequence[Fault]) -> None:
        for fault in faults:
            await asyncio.sleep(self.t0_s + fault.at_s - asyncio.get_running_loop().time())
            self.outcomes.append(await self._befall(fault))

    async def _befall(self, fault: Fault) -> Outcome:
        match fault.unit:
            case Unit.LINE:
                return await self._befall_line(fault)
            case Unit.GATEWAY:
                return await self._befall_gateway(fault, self.gateways[fault.index])
            case Unit.MAPPER:
                return await self._befall_mapper(fault)
            case Unit.ROUTER:
                return await self._befall_router(fault)

    async def _befall_line(self, fault: Fault) -> Outcome:
        post, line = self._post_of_line(fault.index)
        order, ended, recovered = self._number()
        n_bytes = 1024 * round(1 + 63 * fault.draw)
        post.yard.order(order=order, do=fault.kind.name.lower(), line=line, lasts_s=fault.lasts_s, bytes=n_bytes)
        if await ended:
            return Outcome(kind=fault.kind, recovery_s=None, is_void=True)
        return await self._measure(fault.kind, recovered)

    async def _befall_gateway(self, fault: Fault, post: GatewayPost) -> Outcome:
        await self._do(fault, post.service, disk=post.disk, host=post.name)
        if fault.kind is Kind.CUT_GATEWAY:
            return await self._measure_level(fault.kind)
        order, _, recovered = self._number()
        post.yard.order(order=order, do="watch", lines=list(range(post.n_lines)))
        return await self._measure(fault.kind, recovered)

    async def _befall_mapper(self, fault: Fault) -> Outcome:
        await self.mapper.has_started.wait()
        await self._do(fault, self.mapper.service, disk=self.mapper.disk, host="mapper")
        return await self._measure_level(fault.kind)

    async def _befall_router(self, fault: Fault) -> Outcome:
        assert self.router is not None, "without a router there is no plan for it"
        await self._do(fault, self.router, disk=None, host="hall")
        return await self._measure_level(fault.kind)

    async def _do(self, fault: Fault, service: Service, *, disk: Disk | None, host: str) -> None:
        match fault.kind:
            case Kind.KILL_GATEWAY | Kind.KILL_MAPPER | Kind.KILL_ROUTER:
                service.kill()
                await asyncio.sleep(fault.lasts_s)
                service.start()
            case Kind.TERM_GATEWAY:
                await service.stop()
                await asyncio.sleep(fault.lasts_s)
                service.start()
            case Kind.FREEZE_GATEWAY | Kind.FREEZE_MAPPER | Kind.FREEZE_ROUTER:
                service.freeze()
                await asyncio.sleep(fault.lasts_s)
                service.thaw()
            case Kind.FULL_JOURNAL | Kind.FULL_STORE:
                assert disk is not None, "only what has a disk of its own can have it filled"
                await asyncio.to_thread(disk.fill)
                await asyncio.sleep(fault.lasts_s)
                disk.free()
            case Kind.CUT_GATEWAY | Kind.CUT_MAPPER:
                self.network.cut(host)
                await asyncio.sleep(fault.lasts_s)
                self.network.heal(host)
            case Kind.JUMP_GATEWAY | Kind.JUMP_MAPPER:
                self.clocks.shift(host, JUMPS_S[int(fault.draw * len(JUMPS_S))])
            case _:
                raise ValueError(f"{fault.kind} befalls lines")

    async def _measure(self, kind: Kind, recovered: "asyncio.Future[float]") -> Outcome:
        begun_s = time.monotonic()
        try:
            async with asyncio.timeout(_LONGEST_RECOVERY_S):
                return Outcome(kind=kind, recovery_s=await recovered - begun_s)
        except TimeoutError:
            return Outcome(kind=kind, recovery_s=None, is_late=True)

    async def _measure_level(self, kind: Kind) -> Outcome:
        """Wait until the store has all that was in the journals at the end of the fault."""
        if not self.mapper.has_started.is_set():
            return Outcome(kind=kind, recovery_s=None)
        begun_s = time.monotonic()
        wanted = {name: level.head for name, level in (await self.levels()).items()}
        while time.monotonic() - begun_s < _LONGEST_RECOVERY_S:
            levels = await self.levels()
            if all(level.watermark >= wanted[name] for name, level in levels.items()):
                return Outcome(kind=kind, recovery_s=time.monotonic() - begun_s)
            await asyncio.sleep(_POLL_S)
        return Outcome(kind=kind, recovery_s=None, is_late=True)

    def _post_of_line(self, index: int) -> tuple[GatewayPost, int]:
        for post in self.gateways:
            if index < post.n_lines:
                return post, index
            index -= post.n_lines
        raise IndexError(f"there are {index} lines too few")

    def _number(self) -> "tuple[int, asyncio.Future[bool], asyncio.Future[float]]":
        self._last_order = order = self._last_order + 1
        loop = asyncio.get_running_loop()
        self._ends[order], self._recoveries[order] = loop.create_future(), loop.create_future()
        return order, self._ends[order], self._recoveries[order]

    def _hear(self, news: dict[str, Any]) -> None:
        with contextlib.suppress(asyncio.InvalidStateError):
            if "ended" in news:
                self._ends[news["ended"]].set_result(bool(news.get("is_void")))
            elif "recovered" in news:
                self._recoveries[news["recovered"]].set_result(time.monotonic())


async def wait_until(claim: Callable[[], bool], *, timeout_s: float = math.inf) -> bool:
    """Wait for a claim to become true; return whether it did in time."""
    deadline_s = time.monotonic() + timeout_s
    while not claim():
        if time.monotonic() > deadline_s:
            return False
        await asyncio.sleep(_POLL_S)
    return True
