"""A swarm in real time behind serial lines, until the time or a signal ends it.

The first SIGTERM or SIGINT lets the insects stand still and the backpacks finish; the second leaves at once.
"""

import asyncio
import contextlib
import dataclasses
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.clock import Clock
from simulator.errors import LineError
from simulator.events import Event
from simulator.habitat import Habitat
from simulator.lines.carrier import Carrier, open_line
from simulator.lines.faults import FaultDraws
from simulator.lines.line import LineSpec
from simulator.log import EventLog
from simulator.pictures.watch import Watch
from simulator.radios.coverage import CoverageConfig
from simulator.radios.radio import RadioConfig
from simulator.radios.sensing import SensingConfig
from simulator.replay_config import ReplayConfig
from simulator.response import ResponseConfig
from simulator.serve_config import ServeConfig
from simulator.swarm import Swarm
from simulator.swarm_config import SwarmConfig

log = EventLog(__name__)

_SHORTEST_SLEEP_NS = 2 * NS_PER_MS
_LAG_BEGINS_NS = 1 * NS_PER_S
_LAG_ENDS_NS = 200 * NS_PER_MS
_STATUS_PERIOD_NS = NS_PER_S // 2
_FLUSH_PERIOD_NS = NS_PER_S
_NEVER_NS = 1 << 62


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Cast:
    """What a run puts behind the lines.

    Parameters
    ----------
    world
        Before its first ``advance``.
    end_s
        End by itself then [s of the run]; None: on a signal.
    insects_obey
        False in a replay: commands are answered and change nothing.
    can_follow_walls
        Backpacks can have their insects keep to walls, and say so.
    radio, sensing, wander_ppm, has_imu
        The air between all; how encounters are formed from beacons (None: they are exact); how much clocks' rates wander; whether
        backpacks measure how far they are carried.
    observe
        Are given the world's events as they happen.
    flush
        Called about every second of the wall clock, so that what was observed is not lost with the process.
    tend
        Called after every step until the world ends, to do what is due besides: close doors.
    picture
        Shows the world while it runs, in place of a line of state.
    """

    world: Habitat
    seed: int
    coverage: CoverageConfig
    end_s: float | None
    observe: tuple[Callable[[Sequence[Event]], None], ...] = ()
    flush: Callable[[], None] = lambda: None
    tend: Callable[[], None] = lambda: None
    picture: Watch | None = None
    insects_obey: bool = True
    can_follow_walls: bool = False
    radio: RadioConfig = dataclasses.field(default_factory=RadioConfig)
    sensing: SensingConfig | None = None
    wander_ppm: float = 0.0
    has_imu: bool = False
    response: ResponseConfig = dataclasses.field(default_factory=ResponseConfig)
    metres_per_unit: float = 1.0
    speed_factor: float = 1.0


class Service:
    """Drives a swarm by a clock and carries bytes between it and its lines.

    Parameters
    ----------
    lines
        One for each coordinator of the cast.
    clock
        Whose monotonic time the run follows.
    """

    def __init__(self, config: ServeConfig | ReplayConfig, cast: Cast, *, lines: Sequence[LineSpec], clock: Clock) -> None:
        self._config = config
        self._cast = cast
        self._lines = tuple(lines)
        self._clock = clock
        self._t0_ns = clock.monotonic_ns()
        self.t0_wall_ns = clock.wall_ns()
        self.boot = BootId(self.t0_wall_ns // NS_PER_S % (1 << 16) if config.boot is None else config.boot)
        self._world = cast.world
        self._swarm = Swarm(
            self._world,
            config=_swarm_config(config, cast, boot=self.boot, dialects=tuple(line.dialect for line in lines)),
            observe=self._observe,
        )
        self._carriers: tuple[Carrier, ...] = ()
        self._wake = asyncio.Event()
        self._n_signals = 0
        self._end_ns = _NEVER_NS if cast.end_s is None else round(cast.end_s * NS_PER_S)
        self._is_behind = False
        self._status_at_ns = self._flush_at_ns = 0

    async def run(self) -> None:
        """Open the lines and serve to the end.

        Raises
        ------
        LineError
            A line or the ready file cannot be had.
        """
        loop = asyncio.get_running_loop()
        async with contextlib.AsyncExitStack() as stack:
            self._carriers = tuple([await self._open(index, stack) for index in range(len(self._lines))])
            self._t0_ns, self.t0_wall_ns = self._clock.monotonic_ns(), self._clock.wall_ns()
            if self._end_ns < _NEVER_NS:
                self._swarm.end_at(self._end_ns)
            for number in (signal.SIGTERM, signal.SIGINT):
                loop.add_signal_handler(number, self._take_signal)
                stack.callback(loop.remove_signal_handler, number)
            addresses = [carrier.address for carrier in self._carriers]
            stack.enter_context(_ready_file(self._config.ready_file, addresses))
            if self._cast.picture is not None:
                stack.enter_context(self._cast.picture)
            log.info(
                "serve.ready", line=", ".join(addresses), biobots=len(self._world.ids), speed=self._config.speed_factor, boot=self.boot
            )  # fmt: skip
            async with asyncio.TaskGroup() as group:
                tasks = [
                    group.create_task(work)
                    for carrier in self._carriers
                    for work in (carrier.receive(), carrier.send(), carrier.misbehave())
                ]
                await self._pace()
                for task in tasks:
                    task.cancel()
        self._report_end()

    def describe(self) -> dict[str, object]:
        """List what was done, for ``run.json``: parameters of radios and backpacks, and what came of them."""
        config, swarm = self._config, self._swarm
        return {
            "t0_wall_ns": self.t0_wall_ns,
            "speed_factor": config.speed_factor,
            "boot": self.boot,
            "links": list(config.links),
            "coordinator_places": [list(place) for place in self._cast.coverage.places],
            "parameters": {
                "biobots": len(self._world.ids),
                "duration_s": self._world.now_s,
                "coverage_radius": self._cast.coverage.radius,
                "handover_db": self._cast.coverage.handover_db,
                "loss": config.loss,
                "drift_ppm": config.drift_ppm,
                "report_period_s": config.report_period_s,
                "status_period_s": config.status_period_s,
                "neighbours_period_s": config.neighbours_period_s,
                "provisional_s": config.provisional_s,
                "battery_life_s": config.battery_life_s,
            },
            "commands": [dataclasses.asdict(one) for one in swarm.executed],
            "reports": swarm.reports.n_reports,
            "reports_unacknowledged": swarm.reports.n_unacknowledged,
            "encounters_dropped_by_backpacks": swarm.n_dropped,
            "encounters_not_taken": swarm.n_buffered,
            "encounters_lost_with_backpacks": swarm.n_lost,
            "silenced": {str(node): reason for node, reason in sorted(swarm.silenced.items())},
            "rejoined": swarm.n_rejoined,
            "out_of_coverage_at_the_end": swarm.n_uncovered,
            "line_faults": self._line_faults(),
            "injected_faults": [carrier.injected for carrier in self._carriers],
            "air": swarm.air_counts,
        }

    def reported(self) -> bytes:
        """Return the content of ``reported.csv``."""
        return self._swarm.reports.to_csv()

    async def _open(self, index: int, stack: contextlib.AsyncExitStack) -> Carrier:
        line = await open_line(self._lines[index])
        stack.push_async_callback(line.aclose)

        def feed(data: bytes) -> None:
            self._swarm.feed(data, now_ns=self._now_ns(), coordinator=index)
            self._carriers[index].pump()
            self._wake.set()

        faults = self._config.faults.of_line(index)
        draws = None if faults is None else FaultDraws(config=faults, seed=self._cast.seed, line=index)
        options = self._lines[index].gateway_options
        return Carrier(self._swarm.coordinators[index], line=line, feed=feed, faults=draws, options=options)

    async def _pace(self) -> None:
        drained_ns: int | None = None
        while True:
            now_ns = self._now_ns()
            if self._n_signals and not self._swarm.has_ended:
                self._swarm.end_at(min(now_ns, self._end_ns))
            self._swarm.step(now_ns)
            if not self._swarm.has_ended:
                self._cast.tend()
            for carrier in self._carriers:
                carrier.pump()
            self._watch(now_ns)
            if self._swarm.has_ended:
                if drained_ns is None:
                    drained_ns = now_ns + round(self._config.drain_s * NS_PER_S)
                    log.info("world.ended", t_s=round(self._world.now_s, 3), not_yet_taken=self._swarm.n_buffered)
                if self._swarm.is_settled or now_ns >= drained_ns:
                    break
            if self._n_signals > 1:
                break
            await self._sleep(now_ns, until_ns=min(self._swarm.next_due_ns(), drained_ns or self._swarm.next_due_ns()))

    async def _sleep(self, now_ns: int, *, until_ns: int) -> None:
        if self._is_behind:
            await asyncio.sleep(0)
            return
        delay_ns = max(_SHORTEST_SLEEP_NS, until_ns - now_ns)
        alarm = asyncio.get_running_loop().call_later(delay_ns / NS_PER_S, self._wake.set)
        await self._wake.wait()
        alarm.cancel()
        self._wake.clear()

    def _watch(self, now_ns: int) -> None:
        lag_ns = self._swarm.lag_ns(now_ns)
        if not self._is_behind and lag_ns > _LAG_BEGINS_NS:
            self._is_behind = True
            log.warning("world.behind", lag_s=round(lag_ns / NS_PER_S, 1), hint="fewer biobots, or a lower --speed")
        elif self._is_behind and lag_ns < _LAG_ENDS_NS:
            self._is_behind = False
            log.info("world.caught_up")
        if now_ns >= self._flush_at_ns:
            self._flush_at_ns = now_ns + _FLUSH_PERIOD_NS
            self._cast.flush()
        if self._cast.picture is not None:
            self._cast.picture.show(more=self._state())
        elif sys.stderr.isatty() and now_ns >= self._status_at_ns:
            self._status_at_ns = now_ns + _STATUS_PERIOD_NS
            sys.stderr.write(f"\r{now_ns / NS_PER_S:8.1f} s  {len(self._world.ids)} biobots  {self._state()}  \x1b[K")
            sys.stderr.flush()

    def _state(self) -> str:
        n_open = sum(carrier.is_open for carrier in self._carriers)
        gateways = ("connected" if n_open else "absent") if len(self._carriers) == 1 else f"on {n_open} of {len(self._carriers)} lines"
        uncovered = f"  {n_out} out of coverage" if (n_out := self._swarm.n_uncovered) else ""
        return f"gateway {gateways}  {self._swarm.reports.n_reports} reports, {self._swarm.n_buffered} not yet taken{uncovered}"

    def _report_end(self) -> None:
        swarm = self._swarm
        report = log.warning if swarm.reports.n_unacknowledged or swarm.n_dropped or swarm.n_buffered else log.info
        report(
            "serve.ended",
            reports=swarm.reports.n_reports,
            unacknowledged=swarm.reports.n_unacknowledged,
            not_taken=swarm.n_buffered,
            out_of_coverage=swarm.n_uncovered,
            dropped=swarm.n_dropped,
            lost_with_backpacks=swarm.n_lost,
            line_faults=self._line_faults(),
            **({"injected": injected} if any(injected := [carrier.injected for carrier in self._carriers]) else {}),
        )

    def _observe(self, events: Sequence[Event]) -> None:
        if self._cast.picture is not None:
            self._cast.picture.note(events)
        for observe in self._cast.observe:
            observe(events)

    def _take_signal(self) -> None:
        self._n_signals += 1
        self._wake.set()

    def _now_ns(self) -> int:
        return self._clock.monotonic_ns() - self._t0_ns

    def _line_faults(self) -> dict[str, int]:
        total: Counter[str] = Counter()
        for carrier in self._carriers:
            total.update(carrier.faults)
        return dict(total)


def _swarm_config(config: ServeConfig | ReplayConfig, cast: Cast, *, boot: BootId, dialects: tuple[str, ...]) -> SwarmConfig:
    sensing = cast.sensing
    return SwarmConfig(
        seed=cast.seed,
        boot=boot,
        drift_ppm=config.drift_ppm,
        wander_ppm=cast.wander_ppm,
        has_imu=cast.has_imu,
        sensing=sensing,
        backpack=BackpackConfig(
            report_period_ms=round(config.report_period_s * 1000),
            status_period_ms=round(config.status_period_s * 1000),
            neighbours_period_ms=round(config.neighbours_period_s * 1000),
            provisional_ms=round(config.provisional_s * 1000),
            battery_life_ms=round(config.battery_life_s * 1000),
            insect_obeys=cast.insects_obey,
            can_follow_walls=cast.can_follow_walls,
            beacon_period_ms=0 if sensing is None else round(sensing.period_s * 1000),
            proximity=None if sensing is None else sensing.proximity(per_s=1000),
        ),
        radio=cast.radio,
        coverage=cast.coverage,
        response=cast.response,
        metres_per_unit=cast.metres_per_unit,
        speed_factor=cast.speed_factor,
        keeps_history=config.out is not None,
        dialects=dialects,
        faults=config.faults,
    )


@contextlib.contextmanager
def _ready_file(path: str | None, addresses: Sequence[str]) -> Iterator[None]:
    """Keep a file with the lines' addresses, one a line, while they are up; it appears whole."""
    if path is None:
        yield
        return
    place = Path(path)
    fresh = place.with_name(f".{place.name}.partial")
    try:
        fresh.write_text("".join(f"{address}\n" for address in addresses))
        fresh.replace(place)
    except OSError as error:
        raise LineError(line=path, problem=f"the ready file cannot be written: {error.strerror or error}") from error
    try:
        yield
    finally:
        place.unlink(missing_ok=True)
