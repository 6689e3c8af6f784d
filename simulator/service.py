"""A swarm in real time behind a serial line, until the time or a signal ends it.

The first SIGTERM or SIGINT lets the insects stand still and the backpacks finish; the second leaves at once.
"""

import asyncio
import contextlib
import dataclasses
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId
from simulator.backpack import BackpackConfig
from simulator.clock import Clock
from simulator.errors import LineError
from simulator.events import Event
from simulator.line import LineSpec, SerialEnd
from simulator.log import EventLog
from simulator.radio import choose_radio
from simulator.sensed_run import sensing_config
from simulator.serial_port import SerialPortEnd
from simulator.serve_config import ServeConfig
from simulator.setting import Setting
from simulator.swarm import Swarm, SwarmConfig
from simulator.tcp_port import TcpEnd
from simulator.truth import TruthRecorder
from simulator.virtual_serial import PtyEnd
from simulator.world import World

log = EventLog(__name__)

_MAX_BACKLOG = 64 * 1024
"""Bytes that wait for a slow listener at most [B]; frames beyond that are lost, as in an overrun, and the link repeats them."""

_SHORTEST_SLEEP_NS = 2 * NS_PER_MS
_LAG_BEGINS_NS = 1 * NS_PER_S
_LAG_ENDS_NS = 200 * NS_PER_MS
_STATUS_PERIOD_NS = NS_PER_S // 2


class Service:
    """Drives a swarm by a clock and carries bytes between it and a line.

    Parameters
    ----------
    clock
        Whose monotonic time the run follows.
    """

    def __init__(self, config: ServeConfig, setting: Setting, *, line: LineSpec, clock: Clock) -> None:
        self._config = config
        self._setting = setting
        self._line = line
        self._clock = clock
        self._t0_wall_ns = clock.wall_ns()
        self._boot = BootId(self._t0_wall_ns // NS_PER_S % (1 << 16) if config.boot is None else config.boot)
        self._world = World(
            setting.arena,
            motion=setting.motion,
            ranges=setting.ranges,
            ids=setting.ids,
            seed=setting.seed,
            speed_factor=config.speed_factor,
        )
        self._recorder = TruthRecorder(self._world) if config.out is not None else None
        self._swarm = Swarm(self._world, config=_swarm_config(config, setting, boot=self._boot), observe=self._observe)
        self._backlog = bytearray()
        self._n_overruns = 0
        self._has_outgoing = asyncio.Event()
        self._wake = asyncio.Event()
        self._n_signals = 0
        self._t0_ns = 0
        self._is_behind = False
        self._was_open = False
        self._status_at_ns = 0

    async def run(self) -> None:
        """Open the line and serve to the end.

        Raises
        ------
        LineError
            The line or the ready file cannot be had.
        """
        line = await open_line(self._line)
        loop = asyncio.get_running_loop()
        try:
            self._t0_ns, self._t0_wall_ns = self._clock.monotonic_ns(), self._clock.wall_ns()
            if self._config.duration_s is not None:
                self._swarm.end_at(round(self._config.duration_s * NS_PER_S))
            for number in (signal.SIGTERM, signal.SIGINT):
                loop.add_signal_handler(number, self._take_signal)
            with _ready_file(self._config.ready_file, line.address):
                log.info("serve.ready", line=line.address, biobots=self._setting.biobots, speed=self._config.speed_factor, boot=self._boot)
                async with asyncio.TaskGroup() as group:
                    carriers = [group.create_task(self._receive(line)), group.create_task(self._send(line))]
                    await self._pace()
                    for carrier in carriers:
                        carrier.cancel()
        finally:
            for number in (signal.SIGTERM, signal.SIGINT):
                loop.remove_signal_handler(number)
            await line.aclose()
        unacknowledged = self._swarm.reports.n_unacknowledged
        report = log.warning if unacknowledged or self._swarm.n_dropped else log.info
        report(
            "serve.ended",
            reports=self._swarm.reports.n_reports,
            unacknowledged=unacknowledged,
            dropped=self._swarm.n_dropped,
            line_faults=self._line_faults(),
        )

    def files(self) -> Mapping[str, bytes]:
        """Return the files of the run by name, ``run.json`` last.

        Raises
        ------
        ValueError
            The configuration asks for no files, so no truth was kept.
        """
        if self._recorder is None:
            msg = "no truth was recorded: the configuration has no 'out'"
            raise ValueError(msg)
        truth = self._recorder.files(zero_s=0.0, run=self._describe(), position_samples=self._config.position_samples)
        return {"reported.csv": self._swarm.reports.to_csv(), **truth}

    async def _receive(self, line: SerialEnd) -> None:
        while True:
            self._swarm.feed(await line.read(), now_ns=self._now_ns())
            self._pump()
            self._wake.set()

    async def _send(self, line: SerialEnd) -> None:
        while True:
            await self._has_outgoing.wait()
            self._has_outgoing.clear()
            data = bytes(self._backlog)
            self._backlog.clear()
            await line.write(data)

    async def _pace(self) -> None:
        drained_ns: int | None = None
        while True:
            now_ns = self._now_ns()
            if self._n_signals and not self._swarm.has_ended:
                self._swarm.end_at(min(now_ns, self._end_ns()))
            self._swarm.step(now_ns)
            self._pump()
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

    def _pump(self) -> None:
        data = self._swarm.coordinator.take_bytes()
        if len(self._backlog) + len(data) > _MAX_BACKLOG:
            self._n_overruns += 1
        elif data:
            self._backlog += data
            self._has_outgoing.set()

    def _watch(self, now_ns: int) -> None:
        lag_ns = self._swarm.lag_ns(now_ns)
        if not self._is_behind and lag_ns > _LAG_BEGINS_NS:
            self._is_behind = True
            log.warning("world.behind", lag_s=round(lag_ns / NS_PER_S, 1), hint="fewer biobots, or a lower --speed")
        elif self._is_behind and lag_ns < _LAG_ENDS_NS:
            self._is_behind = False
            log.info("world.caught_up")
        if self._swarm.coordinator.is_open is not self._was_open:
            self._was_open = self._swarm.coordinator.is_open
            log.info("gateway.connected" if self._was_open else "gateway.gone")
        if sys.stderr.isatty() and now_ns >= self._status_at_ns:
            self._status_at_ns = now_ns + _STATUS_PERIOD_NS
            reports = self._swarm.reports
            sys.stderr.write(
                f"\r{now_ns / NS_PER_S:8.1f} s  {self._setting.biobots} biobots  gateway {'connected' if self._was_open else 'absent'}  "
                f"{reports.n_reports} reports, {self._swarm.n_buffered} not yet taken  \x1b[K"
            )
            sys.stderr.flush()

    def _observe(self, events: Sequence[Event]) -> None:
        if self._recorder is not None:
            self._recorder.record(events)

    def _take_signal(self) -> None:
        self._n_signals += 1
        self._wake.set()

    def _now_ns(self) -> int:
        return self._clock.monotonic_ns() - self._t0_ns

    def _end_ns(self) -> int:
        return 1 << 62 if self._config.duration_s is None else round(self._config.duration_s * NS_PER_S)

    def _line_faults(self) -> dict[str, int]:
        faults = dict(self._swarm.coordinator.faults)
        return faults | {"overrun": self._n_overruns} if self._n_overruns else faults

    def _describe(self) -> dict[str, object]:
        setting, config = self._setting, self._config
        return {
            "program": "biobot-sim serve",
            "version": version("biobot-gateway"),
            "scenario": config.scenario,
            "arena": config.arena,
            "preset": setting.preset,
            "seed": setting.seed,
            "unit_of_length": setting.unit,
            "t0_wall_ns": self._t0_wall_ns,
            "speed_factor": config.speed_factor,
            "boot": self._boot,
            "link": config.link,
            "parameters": {
                "biobots": setting.biobots,
                "speed": setting.motion.speed,
                "mean_leg": setting.motion.mean_leg,
                "detection_radius": setting.ranges.detection,
                "communication_radius": setting.ranges.communication,
                "duration_s": self._world.now_s,
                "loss": config.loss,
                "sensing": config.sensing,
                "beacon_period_s": config.beacon_period_s if config.sensing == "beacon" else None,
                "radio": config.radio,
                "drift_ppm": config.drift_ppm,
                "report_period_s": config.report_period_s,
                "status_period_s": config.status_period_s,
                "neighbours_period_s": config.neighbours_period_s,
                "provisional_s": config.provisional_s,
                "position_samples": config.position_samples,
            },
            "arena_area": setting.arena.area,
            "betti_numbers": [setting.arena.betti.components, setting.arena.betti.holes],
            "commands": [dataclasses.asdict(one) for one in self._swarm.executed],
            "reports": self._swarm.reports.n_reports,
            "reports_unacknowledged": self._swarm.reports.n_unacknowledged,
            "encounters_dropped_by_backpacks": self._swarm.n_dropped,
            "line_faults": self._line_faults(),
            "air": self._swarm.air_counts,
        }


async def open_line(spec: LineSpec) -> SerialEnd:
    """Make the simulator's end of a line.

    Raises
    ------
    LineError
        The name, the port or the device cannot be had.
    """
    match spec.kind:
        case "pty":
            return PtyEnd(Path(spec.target), baud=spec.baud)
        case "tcp":
            return await TcpEnd.listen(spec.target, spec.port, baud=spec.baud)
        case _:
            return SerialPortEnd(spec.target, baud=spec.baud or 115_200)


def _swarm_config(config: ServeConfig, setting: Setting, *, boot: BootId) -> SwarmConfig:
    sensing = sensing_config(config, setting, loss=config.loss) if config.sensing == "beacon" else None
    return SwarmConfig(
        seed=setting.seed,
        boot=boot,
        drift_ppm=config.drift_ppm,
        wander_ppm=config.wander_ppm,
        sensing=sensing,
        backpack=BackpackConfig(
            report_period_ms=round(config.report_period_s * 1000),
            status_period_ms=round(config.status_period_s * 1000),
            neighbours_period_ms=round(config.neighbours_period_s * 1000),
            provisional_ms=round(config.provisional_s * 1000),
            beacon_period_ms=0 if sensing is None else round(config.beacon_period_s * 1000),
            proximity=None if sensing is None else sensing.proximity(per_s=1000),
        ),
        radio=choose_radio(config, loss=config.loss),
    )


@contextlib.contextmanager
def _ready_file(path: str | None, address: str) -> Iterator[None]:
    """Keep a file with the line's address while the line is up; it appears whole."""
    if path is None:
        yield
        return
    place = Path(path)
    fresh = place.with_name(f".{place.name}.partial")
    try:
        fresh.write_text(address + "\n")
        fresh.replace(place)
    except OSError as error:
        raise LineError(line=path, problem=f"the ready file cannot be written: {error.strerror or error}") from error
    try:
        yield
    finally:
        place.unlink(missing_ok=True)
