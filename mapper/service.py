"""``biobot-mapper serve``: bus, store, map and web server in one process, and the computing process beside it."""

import argparse
import asyncio
import contextlib
import gc
import ipaddress
import os
import secrets
import signal
import socket
import sys
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path

import uvicorn

from firmware_protocol.contract.access import parse_identity
from firmware_protocol.contract.handshakes import CertificateFacts
from firmware_protocol.errors import ConfigurationError
from mapper.access import Access, Rate, RateLimits, TokenRegister, open_register
from mapper.alert_rules import AlertLimits
from mapper.alert_watch import AlertWatch
from mapper.api.app import create_app
from mapper.api.event_stream import EventStream
from mapper.api.services import Engines, Services
from mapper.bus import Bus
from mapper.changes import Changes
from mapper.command_log import CommandLog
from mapper.commander import Commander
from mapper.commands import CommandDesk
from mapper.config import LimitsConfig, MapperConfig, ServiceConfig, load_mapper_config, make_recipe, tokens_path
from mapper.connection import ConnectionWatch
from mapper.current_map import CurrentMap
from mapper.emergency_stop import EmergencyStop
from mapper.encounter_export import Exports
from mapper.errors import EngineMissingError, ListenError, MapError, OutputFileError
from mapper.fleet import Fleet
from mapper.intake import Intake
from mapper.jobs import JobDesk
from mapper.kernels import choose_kernels
from mapper.log import EventLog, set_up_logging
from mapper.map_history import MapHistory
from mapper.map_snapshot import fingerprint
from mapper.mission_orders import MissionDesk
from mapper.pin_board import PinBoard
from mapper.rips_engines import name_engine
from mapper.service_checks import check_service
from mapper.service_manager import ServiceManager
from mapper.stimulation_accounts import StimulationAccounts
from mapper.store_thread import StoreThread
from mapper.thinning import make_ladder
from mapper.tls_files import check_tls_files
from mapper.types import Method, MetricKind
from mapper.watermarks import Watermarks

_log = EventLog(__name__)

_FLAGS = (
    "site", "name", "connect", "listen", "store", "host", "port", "allow_remote", "tokens", "min_interval_s",
    "window_s", "log_level",
)  # fmt: skip
_LOOPBACK_NAMES = ("127.0.0.1", "localhost", "::1")
_GRACEFUL_S = 5
_SWITCH_S = 0.0005
"""A thread that wants to go on while another is busy waits so long for the interpreter: the store's thread asks for it at every
statement, and Python's 5 ms would add up."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``serve``; one that is not given is None and leaves the word to environment and configuration file."""
    parser.add_argument(
        "--connect", action="append", metavar="EP", help="Zenoh endpoint of a gateway or router (default: tcp/127.0.0.1:7447)"
    )
    parser.add_argument("--listen", action="append", metavar="EP", help="Zenoh endpoint to be found at (default: none)")
    parser.add_argument("--site", help="site whose gateways are heard (default: local)")
    parser.add_argument("--name", help="this mapper's own name on the bus (default: its certificate's, or its store's)")
    parser.add_argument("--store", metavar="FILE", help="keep records in this file (default: in memory, filled again from the gateways)")
    parser.add_argument("--host", help="address of the page (default: 127.0.0.1)")
    parser.add_argument("--port", type=int, help="its port; 0 takes a free one (default: 8080)")
    parser.add_argument("--allow-remote", action="store_const", const=True, help="let other machines in; to look then needs a token too")
    parser.add_argument("--tokens", metavar="FILE", help="who may command (default: mapper-tokens.json beside the store)")
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="write the first token there when there is none yet")
    parser.add_argument("--url-file", type=Path, metavar="FILE", help="write the page's URL there when it is up")
    parser.add_argument("--min-interval-s", type=float, metavar="S", help="shortest time from one map to the next (default: 1)")
    parser.add_argument(
        "--window-s", type=float, metavar="S", help="map what was not over S before the newest encounter's end (default: all)"
    )
    parser.add_argument("--speed-mps", type=float, metavar="V", help="walking speed [m/s]: lengths are then metres, else seconds")
    parser.add_argument("--method", choices=[str(method) for method in Method], help="the whole recipe (default: default)")
    parser.add_argument(
        "--metric", choices=[str(metric) for metric in MetricKind], help="how encounters are compared (default: by the method)"
    )
    parser.add_argument("--log-level", choices=["DEBUG", "INFO", "WARNING", "ERROR"], help="(default: INFO)")


def main(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT; a second signal leaves at once.

    Raises
    ------
    ConfigurationError, MapError
        The configuration is unfit, or store, bus or address cannot be had.
    """
    config = load_mapper_config(args.config, environment=os.environ, flags=_flags(args), check=check_service)
    _, facts = check_tls_files(config)
    set_up_logging(level=config.serve.log_level)
    sys.setswitchinterval(_SWITCH_S)
    try:
        return asyncio.run(_serve(config, url_file=args.url_file, token_file=args.token_file, facts=facts))
    except ExceptionGroup as group:
        known = group.subgroup(MapError)
        if known is None:
            return _crashed(group)
        raise _first(known) from group
    except (MapError, ConfigurationError):
        raise
    except Exception as error:  # noqa: BLE001  # whatever ended the service is one event for those who watch its log
        return _crashed(error)


def _crashed(error: Exception) -> int:
    _log.error("mapper.crashed", error=f"{type(error).__name__}: {error}", trace="".join(traceback.format_exception(error)))
    return 1


def _first(group: BaseExceptionGroup[MapError]) -> MapError:
    first = group.exceptions[0]
    return _first(first) if isinstance(first, BaseExceptionGroup) else first


def _flags(args: argparse.Namespace) -> dict[str, object]:
    flags: dict[str, object] = {f"serve.{name}": getattr(args, name) for name in _FLAGS}
    return flags | {f"recipe.{name}": getattr(args, name) for name in ("method", "metric", "speed_mps")}


async def _serve(config: MapperConfig, *, url_file: Path | None, token_file: Path | None, facts: CertificateFacts | None) -> int:
    """Start address, store, tokens, bus, tasks, in this order; stop in reverse."""
    serve = config.serve
    stopping = asyncio.Event()
    engines = _name_engines()
    async with contextlib.AsyncExitStack() as stack:
        manager = stack.enter_context(contextlib.closing(ServiceManager.of(os.environ)))
        listener = stack.enter_context(contextlib.closing(_listen(serve)))
        records = await StoreThread.open(Path(serve.store) if serve.store is not None else None)
        stack.push_async_callback(records.aclose)
        register = open_register(tokens_path(serve), token_file=token_file)
        certified = None if facts is None else parse_identity(facts.common_name).name
        name = serve.name or certified or records.name or f"mapper-{secrets.token_hex(4)}"
        bus = await Bus.open(site=serve.site, connect=serve.connect, listen=serve.listen, tls=config.tls, timing=config.zenoh, name=name)
        stack.push_async_callback(bus.aclose)
        watch = ConnectionWatch(is_connected=lambda: bus.is_connected, connect=serve.connect, tls=config.tls, facts=facts)
        changes, fleet = Changes(), Fleet()
        log, accounts = CommandLog(changes=changes), StimulationAccounts()
        log.listen(fleet.take_stage)
        intake = Intake(bus=bus, records=records, fleet=fleet, changes=changes, commands=log, accounts=accounts)
        watermarks = Watermarks(bus=bus, records=records, name=name)
        commander = Commander(bus=bus, name=name)
        desk = CommandDesk(bus=bus, fleet=fleet, log=log, commander=commander)
        recipe, window_ns = make_recipe(config.recipe), None if serve.window_s is None else round(serve.window_s * 1e9)
        history = _make_history(config, records=records, changes=changes, made_by=fingerprint(recipe, window_ns=window_ns))
        pins = PinBoard(records=records, changes=changes)
        await pins.restore()
        current_map = CurrentMap(
            records=records,
            history=history,
            recipe=recipe,
            fleet=fleet,
            changes=changes,
            pins=pins,
            min_interval_s=serve.min_interval_s,
            window_ns=window_ns,
        )
        await current_map.restore()
        jobs = JobDesk(records=records, changes=changes, pins=pins, recipe=config.recipe, new_id=lambda: secrets.token_hex(6))

        access = _make_access(register, config)

        def counters() -> Mapping[str, int]:
            return {
                **intake.counters,
                **{f"bus_{name}": number for name, number in bus.counters.items()},
                "ignored": fleet.n_ignored + accounts.n_ignored,
                **access.refused,
            }

        def faults() -> list[str]:
            kept = [fault for fault in (intake.store_fault, history.fault, register.fault) if fault is not None]
            found = [*kept, *intake.losses.values(), *current_map.faults]
            return list(dict.fromkeys(found))

        alerts = AlertWatch(
            records=records,
            fleet=fleet,
            changes=changes,
            current_map=current_map,
            limits=AlertLimits(
                lost_s=config.alerts.lost_s,
                battery_mv=config.alerts.battery_mv,
                battery_critical_mv=config.alerts.battery_critical_mv,
            ),
            sure=config.alerts.hole_probability,
            is_connected=lambda: bus.is_connected,
            faults=faults,
        )
        await alerts.restore()
        services = Services(
            bus=bus,
            records=records,
            fleet=fleet,
            current_map=current_map,
            history=history,
            alerts=alerts,
            commands=desk,
            emergency_stop=EmergencyStop(desk),
            mission=MissionDesk(bus=bus),
            accounts=accounts,
            access=access,
            pins=pins,
            jobs=jobs,
            exports=Exports(records),
            changes=changes,
            is_connected=lambda: bus.is_connected,
            counters=counters,
            faults=faults,
            engines=engines,
        )
        stream = EventStream(changes)
        server = _Server(_server_config(services, stream, serve))
        if serve.allow_remote and serve.certificate is None:
            _log.warning(
                "access.readable", reason="tokens cross the network as plain text", next_step="give serve.certificate and serve.key"
            )
        stack.enter_context(_signals_set(stopping))
        async with asyncio.TaskGroup() as group:
            parts = (intake, desk, commander, history, current_map, alerts, jobs, watermarks, watch, register)
            tasks = [group.create_task(part.run(), name=type(part).__name__) for part in parts]
            serving = group.create_task(server.serve(sockets=[listener]), name="http")
            group.create_task(_announce(server, listener, manager, serve=serve, url_file=url_file), name="announce")
            tasks.append(group.create_task(manager.watch(), name="watchdog"))
            await stopping.wait()
            _log.info("mapper.stopping")
            manager.stopping()
            stream.close()
            server.should_exit = True
            # First of all: clients that wait for an answer may hold the server up.
            await desk.release()
            await serving
            await commander.resign()
            for task in tasks:
                task.cancel()
    _log.info("mapper.stopped")
    return 0


def _make_history(config: MapperConfig, *, records: StoreThread, changes: Changes, made_by: str) -> MapHistory:
    kept = config.history
    ladder = make_ladder(all_s=kept.all_s, minutes_s=kept.minutes_s, ten_minutes_s=kept.ten_minutes_s)
    return MapHistory(records=records, changes=changes, ladder=ladder, max_bytes=round(kept.max_mb * 1e6), made_by=made_by)


class _Server(uvicorn.Server):
    """Leaves signals to the service, which has more to stop than the server, and says when it is up."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.is_up = asyncio.Event()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.is_up.set()


def _name_engines() -> Engines:
    """Name what computes the maps, and tell what is missing or slow before anybody waits for it."""
    kernels = choose_kernels()
    if kernels.shortfall is not None:
        _log.warning("kernels.plain", reason=kernels.shortfall)
    try:
        persistence = name_engine()
    except EngineMissingError as error:
        _log.error("persistence.missing", reason=str(error))
        persistence = None
    return Engines(kernels=kernels.name, persistence=persistence)


def _make_access(register: TokenRegister, config: MapperConfig) -> Access:
    limits: LimitsConfig = config.limits
    return Access(
        register=register,
        limits=RateLimits(
            reads=Rate(per_s=limits.reads_per_s, burst=limits.reads_burst),
            writes=Rate(per_s=limits.writes_per_s, burst=limits.writes_burst),
        ),
        allows_anonymous_reading=config.serve.anonymous_reading and not config.serve.allow_remote,
    )


def _server_config(services: Services, stream: EventStream, serve: ServiceConfig) -> uvicorn.Config:
    allowed = None if serve.allow_remote else {*_LOOPBACK_NAMES, serve.host}
    return uvicorn.Config(
        create_app(services, stream=stream, allowed_hosts=allowed, is_tls=serve.certificate is not None),
        # Who asks is known by the connection alone: what a header says of it, anybody may have written.
        proxy_headers=False,
        ssl_certfile=serve.certificate,
        ssl_keyfile=serve.key,
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="none",
        timeout_graceful_shutdown=_GRACEFUL_S,
    )


async def _announce(
    server: _Server, listener: socket.socket, manager: ServiceManager, *, serve: ServiceConfig, url_file: Path | None
) -> None:
    await server.is_up.wait()
    gc.collect()
    gc.freeze()  # what was imported is searched for cycles no more: no stop goes out meanwhile
    url = _url(listener, scheme="http" if serve.certificate is None else "https")
    manager.tell(f"map and operator page: {url}")
    manager.ready()
    _log.info(
        "mapper.up",
        url=url,
        site=serve.site,
        connect=",".join(serve.connect),
        store=serve.store or "memory",
        tokens=str(tokens_path(serve)),
    )
    print(f"map and operator page: {url}", file=sys.stderr, flush=True)  # noqa: T201  # a person wants to see it among the logs
    if url_file is not None:
        try:
            partial = url_file.with_name(f".{url_file.name}.partial")
            partial.write_text(url + "\n", encoding="utf-8")
            partial.replace(url_file)
        except OSError as error:
            raise OutputFileError(path=str(url_file), reason=(error.strerror or str(error)).lower()) from error


def _listen(serve: ServiceConfig) -> socket.socket:
    address = f"{serve.host}:{serve.port}"
    try:
        family, _, _, _, target = socket.getaddrinfo(serve.host, serve.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except OSError as error:
        raise ListenError(
            address=address, reason=f"{serve.host!r} is no address of this machine ({error})", next_step="choose another --host"
        ) from error
    if not serve.allow_remote and not ipaddress.ip_address(target[0]).is_loopback:
        raise ListenError(
            address=address,
            reason="other machines could reach it",
            next_step="leave --host at 127.0.0.1, or let them in with --allow-remote: who looks or commands then needs a token",
        )
    # Named as TCP, so that connections get TCP_NODELAY: otherwise each answer of two packets waits 40 ms for an acknowledgement.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(target)
        listener.listen(512)
        listener.settimeout(0)
    except OSError as error:
        listener.close()
        raise ListenError(
            address=address, reason=(error.strerror or str(error)).lower(), next_step="choose another --port, or 0 for a free one"
        ) from error
    return listener


def _url(listener: socket.socket, *, scheme: str) -> str:
    host, port = listener.getsockname()[:2]
    shown = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104  # this is the address that is replaced
    # Without a slash at the end: `$URL/api/v1/map`, as all documents have it, is right then.
    return f"{scheme}://[{shown}]:{port}" if ":" in shown else f"{scheme}://{shown}:{port}"


@contextlib.contextmanager
def _signals_set(stopping: asyncio.Event) -> Iterator[None]:
    loop = asyncio.get_running_loop()

    def stop(signal_number: signal.Signals) -> None:
        if stopping.is_set():
            os._exit(128 + signal_number)
        stopping.set()

    for signal_number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(signal_number, stop, signal_number)
    try:
        yield
    finally:
        for signal_number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(signal_number)
