"""The running gateway: every part wired to the others, in the one task group."""

import asyncio
import contextlib
import gc
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import GatewayStatus, NodeStatus
from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.interface import Host
from firmware_protocol.messages import Diagnostic, Level
from firmware_protocol.units import NS_PER_S, Nanoseconds, NodeId
from gateway.acknowledger import Acknowledger
from gateway.audit_log import AuditLog
from gateway.bus import Bus
from gateway.clocks import ClockBook
from gateway.commanding import Commanding
from gateway.config import GatewayConfig, LinkTable
from gateway.config_loading import read_address
from gateway.configurator import Configurator
from gateway.coordinator import Coordinator
from gateway.downlink import DownlinkSender
from gateway.health import Health, RadioState
from gateway.inquiries import Inquirer
from gateway.intake import Intake, IntakeListeners
from gateway.issuer import RecordIssuer
from gateway.journal import Journal
from gateway.journal_file import Retention
from gateway.line_pace import LinePace
from gateway.log import EventLog, log_what_nobody_caught
from gateway.mission import Mission
from gateway.monitor.server import Monitor
from gateway.nodes import NodeBook
from gateway.recordings.listing import list_recordings
from gateway.recordings.radio_recorders import open_recorded, recording_radios
from gateway.recordings.recorder import Recorder
from gateway.service_manager import ServiceManager
from gateway.stimulation import StimulationGate
from gateway.transports.can_port import CanBuses
from gateway.transports.fair_share import BEGUN, FairShare, LoopLoad
from gateway.transports.spec import PortSpec, bytes_per_s, can_reset, parse_port_spec
from gateway.vitals import Vitals

_log = EventLog(__name__)
_SAY = {Level.DEBUG: _log.debug, Level.INFO: _log.info, Level.WARNING: _log.warning, Level.ERROR: _log.error}

_STATUS_PERIOD_S = 1.0
_SWITCH_S = 0.0005
"""A thread that wants to go on while the loop is busy waits so long for the interpreter. A commit asks for it some times over; with
Python's 5 ms each, commits took 20 ms under load instead of 3, and a dongle with 16 unconfirmed payloads stood still for as long
(measured 2026-11)."""

_COLLECTED_AFTER = (1_000, 20, 100)
"""New objects until the youngest are searched for cycles, and such searches until the older ones are, and all: less often than usual."""

_DRAIN_TIMEOUT_S = 5.0
_CANCEL_AGAIN_S = 0.5


class Service:
    """A gateway, from open to closed. ``run`` opens everything, runs until ``stop``, and closes it in reverse order."""

    def __init__(self, config: GatewayConfig, *, manager: ServiceManager | None = None) -> None:
        self._config = config
        self._health = Health()
        self._vitals = Vitals(health=self._health, journal=Path(config.journal), connect=config.connect)
        self._manager = manager or ServiceManager(address=None)
        self._stopping = asyncio.Event()

    def stop(self) -> None:
        """Have ``run`` finish what is under way and return."""
        self._stopping.set()

    async def run(self, *, on_ready: Callable[[], None] | None = None) -> None:
        """Run until stopped.

        Raises
        ------
        TransportSpecError, MonitorError, JournalUnfitError, BusError, RecordingError
            The configuration names what cannot be opened. A radio that is not there is no error: it is waited for.
        """
        with self._monitoring():
            await self._run_open(on_ready)

    @contextlib.contextmanager
    def _monitoring(self) -> Iterator[None]:
        if not self._config.monitor.listen:
            yield
            return
        host, port = read_address(self._config.monitor.listen)
        monitor = Monitor.start(host=host, port=port, vitals=self._vitals)
        try:
            yield
        finally:
            monitor.close()

    async def _run_open(self, on_ready: Callable[[], None] | None) -> None:
        ports = {spec.name: spec for spec in map(parse_port_spec, self._config.ports)}
        config = self._config
        self._journal = Journal.open(Path(config.journal), health=self._health, retention=_retention_of(config), gateway=config.name)
        try:
            bus = await asyncio.to_thread(Bus.open, self._config, health=self._health)
            try:
                async with recording_radios(self._config.recording, self._config.ports) as recorders:
                    await self._run_parts(ports, recorders, bus, on_ready)
            finally:
                await asyncio.to_thread(bus.close)
        finally:
            await asyncio.to_thread(self._journal.close)
        head = self._journal.audit_head
        _log.info("gateway.stopped", head_offset=self._journal.head_offset, audit_rows=head.n_rows, audit_head=head.chain.hex())

    async def _run_parts(
        self, ports: dict[str, PortSpec], recorders: Mapping[str, Recorder], bus: Bus, on_ready: Callable[[], None] | None
    ) -> None:
        config, journal, health = self._config, self._journal, self._health
        now_ns = time.monotonic_ns()
        issuer = RecordIssuer(
            gateway=config.name,
            journal=journal.journal_id,
            boot=journal.boot,
            wall_anchor_ns=journal.identity.wall_anchor_ns,
            earlier_anchors=journal.identity.earlier_anchors,
        )
        reader = journal.reader()
        nodes = NodeBook(gateway=config.name)
        # Starts begin 16 session numbers apart; times an odd number these are far apart among the tokens.
        clocks = ClockBook(window_ns=int(config.clocks.window_s * NS_PER_S), first_token=journal.identity.first_session * 40_503)
        intake = Intake(
            issuer=issuer,
            journal=journal,
            reader=reader,
            nodes=nodes,
            clocks=clocks,
            health=health,
            config=config.encounters,
            now_ns=now_ns,
        )
        can_buses = CanBuses()
        load, on_flood = LoopLoad(n_radios=len(ports)), partial(self._on_flood, bus)
        shares = {
            name: FairShare(
                radio=name, load=load, max_bytes_per_s=config.link.max_bytes_per_s, health=health.of_radio(name), on_flood=on_flood
            )
            for name in ports
        }
        coordinators = {
            name: Coordinator(
                radio=name,
                make_host=partial(_make_host, spec, config.link),
                open_port=shares[name].opening(partial(open_recorded, spec, recorders.get(name), can_buses=can_buses)),
                reset_port=shares[name].opening(partial(open_recorded, spec, recorders.get(name), is_reset=True))
                if can_reset(spec)
                else None,
                on_radio=intake.take,
                config=config.link,
                health=health.of_radio(name),
                first_session=journal.identity.first_session,
                on_state=partial(self._on_radio_state, bus),
                pace=LinePace(bytes_per_s=bytes_per_s(spec)),
            )
            for name, spec in ports.items()
        }
        sender = DownlinkSender(coordinators=coordinators, nodes=nodes)
        acknowledger = Acknowledger(sender=sender, window_of=intake.window_of, health=health)
        inquirer = Inquirer(sender=sender, nodes=nodes, clocks=clocks, sync_period_s=config.clocks.sync_period_s, health=health)
        configurator = Configurator(
            sender=sender,
            nodes=nodes,
            wanted=config.backpacks,
            health=health,
            on_refused=partial(self._on_unconfigured, bus),
            first_token=journal.identity.first_session,
        )
        audit = AuditLog(journal=journal, reader=reader, health=health)
        commanding = Commanding.wire(
            config=config, journal=journal, reader=reader, nodes=nodes, sender=sender, audit=audit, bus=bus, health=health
        )
        gate = commanding.gate
        intake.connect(
            IntakeListeners(
                on_committed=acknowledger.mark,
                on_status=partial(self._on_status, bus, gate),
                on_neighbours=bus.publish_neighbours,
                on_reply=gate.on_reply,
                on_answer=gate.on_answer,
                on_duplicate=partial(self._on_duplicate, bus),
                on_diagnostic=partial(self._on_diagnostic, bus),
                on_configuration=configurator.on_report,
                on_limits=audit.note_announced,
                on_unknown_clock=inquirer.note_refused,
            )
        )
        mission = Mission(
            config=config.mission,
            issuer=issuer,
            journal=journal,
            reader=reader,
            nodes=nodes,
            handle=gate.handle,
            health=health,
            note=audit.note,
            on_event=partial(self._publish_event, bus),
            controlled=commanding.dead_man.controlled,
        )
        gate.listen(mission.on_stage)
        gate.listen(intake.halts.hear)
        journal.listen(mission.take_records)
        journal.listen(bus.publish_records)
        journal.listen(lambda committed: self._vitals.take_records(committed.records, committed.head_offset))
        journal.listen_for_fault(partial(self._on_journal_fault, bus))
        journal.listen_for_alarm(partial(self._publish_event, bus, "error"))
        try:
            async with asyncio.TaskGroup() as tasks:
                signs_of_life = [tasks.create_task(self._vitals.run()), tasks.create_task(self._manager.watch())]
                running = [tasks.create_task(journal.run()), tasks.create_task(audit.run())]
                audit.begin({"name": config.name, "site": config.site, "version": version("biobot-gateway"), "ports": config.ports})
                audit.note_limits(config.stimulation)
                bus.start(
                    on_command=partial(commanding.take, tasks),
                    on_order=lambda order, answer: mission.take_order(order, answer.tell),
                    on_turned_away=audit.turn_away,
                    open_reader=journal.reader,
                    journal=journal.journal_id,
                    commanders=commanding.commanders,
                    on_watermark=journal.note_watermark,
                    on_damage=journal.note_damage,
                    list_recordings=partial(list_recordings, config.recording.directory, gateway=config.name),
                )
                for account in gate.accounts():
                    bus.publish_account(account)
                running.append(tasks.create_task(self._publish_status(bus, intake, nodes)))
                running.append(tasks.create_task(acknowledger.run()))
                running.append(tasks.create_task(inquirer.run()))
                running.append(tasks.create_task(commanding.dead_man.run()))
                running.append(tasks.create_task(configurator.run()))
                running.append(tasks.create_task(mission.run()))
                running += [tasks.create_task(coordinator.run()) for coordinator in coordinators.values()]
                _log.info("gateway.started", name=config.name, site=config.site, journal=journal.journal_id, boot=journal.boot)
                self._manager.ready()
                if on_ready is not None:
                    on_ready()
                await self._stopping.wait()
                await self._wind_down(running, commanding, audit)
                for task in signs_of_life:
                    task.cancel()
        finally:
            reader.close()

    async def _wind_down(self, running: list[asyncio.Task[None]], commanding: Commanding, audit: AuditLog) -> None:
        """Stop in the reverse order of the start; the journal, started first, is drained before it ends."""
        _log.info("gateway.stopping")
        self._vitals.is_stopping = True
        self._manager.stopping()
        command_tasks = await commanding.wind_down(self._config)
        journal_task, *others = running
        others += command_tasks
        pending = set(others)
        while pending:
            # A cancellation that meets a port's closing in the same step is lost (Python 3.11): it is asked for again.
            for task in reversed(others):
                task.cancel()
            _, pending = await asyncio.wait(pending, timeout=_CANCEL_AGAIN_S)
        audit.end("asked to stop")
        try:
            async with asyncio.timeout(_DRAIN_TIMEOUT_S):
                await self._journal.drain()
        except TimeoutError:
            lost = {"reason": self._journal.fault or "slow disk", "seconds": _DRAIN_TIMEOUT_S, **self._journal.unwritten()}
            _log.error("gateway.undrained", **lost, advice="these are lost; make room before the next start, and keep this log")
        journal_task.cancel()

    def _on_status(self, bus: Bus, gate: StimulationGate, status: NodeStatus) -> None:
        gate.on_mode(status.node, status.mode)
        bus.publish_node_status(status)

    def _on_radio_state(self, bus: Bus, radio: str, state: RadioState, reason: str) -> None:
        bus.set_radio(radio, is_up=state is RadioState.UP)
        level = "info" if state is RadioState.UP else "warning"
        self._publish_event(bus, level, f"radio.{state.value}", {"radio": radio, "reason": reason})

    def _on_flood(self, bus: Bus, radio: str, kind: str, text: str) -> None:
        level = "warning" if kind == BEGUN else "info"
        self._publish_event(bus, level=level, kind=kind, facts={"radio": radio, "reason": text})

    def _on_duplicate(self, bus: Bus, node: NodeId, before: int, after: int) -> None:
        facts = {"node": str(node), "eui64_before": f"{before:016x}", "eui64": f"{after:016x}"}
        _log.warning("node.duplicate", **facts)
        self._publish_event(bus, "warning", "node.duplicate", facts)

    def _on_diagnostic(self, bus: Bus, node: NodeId, diagnostic: Diagnostic) -> None:
        facts = {"node": str(node), "code": str(diagnostic.code), "argument": str(diagnostic.argument), "text": diagnostic.text}
        _SAY[diagnostic.level]("node.diagnostic", **facts)
        self._publish_event(bus, diagnostic.level.name.lower(), "node.diagnostic", facts)

    def _on_unconfigured(self, bus: Bus, node: NodeId, reason: str) -> None:
        facts = {"node": str(node), "reason": reason}
        _log.warning("node.not_configured", **facts)
        self._publish_event(bus, "warning", "node.not_configured", facts)

    def _on_journal_fault(self, bus: Bus, reason: str | None) -> None:
        self._vitals.journal_fault = reason
        level, kind = ("info", "journal.recovered") if reason is None else ("error", "journal.fault")
        self._publish_event(bus, level, kind, {"path": self._config.journal, "reason": reason or ""})

    def _publish_event(self, bus: Bus, level: str, kind: str, facts: Mapping[str, str]) -> None:
        bus.publish_event(
            GatewayEvent(gateway=self._config.name, wall_ns=Nanoseconds(time.time_ns()), level=level, kind=kind, facts=dict(facts))
        )

    async def _publish_status(self, bus: Bus, intake: Intake, nodes: NodeBook) -> None:
        journal, vitals = self._journal, self._vitals
        vitals.head_offset = journal.head_offset
        while True:
            vitals.n_links, vitals.n_biobots, vitals.commit_s = bus.n_links(), len(nodes), journal.commit_s
            vitals.why_alone, vitals.watermarks = bus.missing, dict(journal.watermarks)
            self._manager.tell(vitals.headline())
            bus.publish_gateway_status(
                GatewayStatus(
                    gateway=self._config.name,
                    journal=journal.journal_id,
                    boot=journal.boot,
                    head_offset=journal.head_offset,
                    wall_ns=Nanoseconds(time.time_ns()),
                    radios=self._health.radios(),
                    counters=self._health.counters(),
                    oldest_offset=journal.oldest_offset,
                    watermarks=vitals.watermarks,
                    radio_reports=vitals.radio_reports(),
                    started_wall_ns=Nanoseconds(vitals.started_wall_ns),
                    n_biobots=vitals.n_biobots,
                    journal_bytes=None if vitals.disk is None else vitals.disk.journal_bytes,
                    disk_free_bytes=None if vitals.disk is None else vitals.disk.free_bytes,
                    faults=(*vitals.faults(), *vitals.warnings()),
                    missing=tuple(vitals.missing()),
                    audit_rows=journal.audit_head.n_rows,
                    audit_head=journal.audit_head.chain.hex(),
                )
            )
            await asyncio.sleep(_STATUS_PERIOD_S)
            intake.forget_old(now_ns=time.monotonic_ns())


async def run_gateway(config: GatewayConfig) -> None:
    """Run a gateway until SIGTERM or SIGINT; a second signal ends the process at once."""
    sys.setswitchinterval(_SWITCH_S)
    manager = ServiceManager.of(os.environ)
    service = Service(config, manager=manager)
    loop = asyncio.get_running_loop()
    log_what_nobody_caught(_log)

    def on_signal(number: signal.Signals) -> None:
        loop.remove_signal_handler(number)  # the next one has its default effect
        service.stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, on_signal, number)
    try:
        await service.run(on_ready=_spare_collector)
    finally:
        manager.close()


def _spare_collector() -> None:
    """Keep what stays for ever from Python's search for cycles: a search through all of it takes 0.1 s, and no stop goes out meanwhile."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_COLLECTED_AFTER)


def _retention_of(config: GatewayConfig) -> Retention:
    table = config.retention

    def days(value: float) -> int:
        return int(value * 86_400 * NS_PER_S)

    return Retention(
        max_age_ns=None if table.max_age_days is None else days(table.max_age_days),
        max_size=None if table.max_mb is None else int(table.max_mb * 1_000_000),
        keep_ns=int(config.encounters.window_s * NS_PER_S),
        # Trains that still count must be found again at a restart.
        audit_age_ns=max(days(table.audit_days), 2 * int(config.stimulation.window_s * NS_PER_S)),
        node_age_ns=days(table.node_days),
        mapper_age_ns=days(table.mapper_days),
    )


def _make_host(spec: PortSpec, link: LinkTable) -> Host:
    # A dongle may still tell of payloads of an earlier process: their numbers must not be those of this one.
    idle_ns = int(link.idle_s * NS_PER_S)
    return make_host(spec.dialect, first_handle=random.randrange(1 << 16), network=spec.network, idle_ns=idle_ns)
