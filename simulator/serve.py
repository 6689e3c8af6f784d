"""``biobot-sim serve``: its flags, its world, and what becomes of a run's results."""

import argparse
import asyncio
import contextlib
import dataclasses
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

import msgspec

from simulator import motion_flags
from simulator.arenas import arena_flags
from simulator.arenas.scenarios import find_scenario
from simulator.clock import WallClock
from simulator.config_sources import load_config
from simulator.doors import Doors
from simulator.errors import ParameterError
from simulator.events import Event
from simulator.lines.faults import FAULT_KEYS, FaultFlag
from simulator.lines.line import EXAMPLES, LineSpec, parse_line
from simulator.log import EventLog, set_up_logging
from simulator.output import OutputDirectory
from simulator.pictures.watch import Watch
from simulator.presets import find_preset
from simulator.radios import radio_flags
from simulator.radios.coverage import CoverageConfig, spread_places
from simulator.radios.radio import choose_radio
from simulator.radios.radio_keys import BEACON_KEYS
from simulator.sensed_run import sensing_config
from simulator.serve_config import ServeConfig
from simulator.service import Cast, Service
from simulator.setting import Setting, choose_setting
from simulator.swarm_config import check_node_numbers
from simulator.truth import TruthRecorder
from simulator.truth_stream import TruthStream
from simulator.world import World

log = EventLog(__name__)

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_NAMELESS_UNIT_M = 0.04  # see ServeConfig.metres_per_unit


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``serve``."""
    arena_flags.add_arguments(parser)
    motion_flags.add_arguments(parser)
    radio_flags.add_arguments(parser)
    imu = "backpacks report how far they were carried between encounters"
    parser.add_argument("--imu", action="store_true", default=None, help=imu)
    walls = "backpacks can have their insects follow walls, by command"
    parser.add_argument("--wall-following", action="store_true", default=None, help=walls)
    parser.add_argument("--watch", action="store_true", default=None, help="show the insects in the terminal")
    add_line_arguments(parser)
    parser.add_argument("--preset", metavar="NAME", help="parameters of insects (default: paper-units)")
    parser.add_argument("--biobots", type=int, metavar="N", help="how many insects (default: the preset's)")
    parser.add_argument("--seed", type=int, metavar="N", help="same seed, same insects")
    parser.add_argument("--duration", dest="duration_s", type=float, metavar="S", help="end after this many seconds (default: on a signal)")
    parser.add_argument("--duration-s", dest="duration_s", type=float, help=argparse.SUPPRESS)  # the key's name, as messages have it
    parser.add_argument(
        "--speed",
        "--speed-factor",
        dest="speed_factor",
        type=float,
        metavar="X",
        help="insects are X times faster than life; all else keeps real time",
    )
    add_backpack_arguments(parser)


def add_line_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of coordinators and their lines."""
    parser.add_argument(
        "--link",
        action="append",
        metavar="SPEC",
        help="what the gateway opens: pty:PATH, tcp:HOST:PORT or serial:DEVICE, each with ?baud=N&dialect=D (native, xbee, xbee-ap1, znp "
        "and others), or slcan:PATH?unit=N, a CAN adapter; again for a further coordinator",
    )
    parser.add_argument(
        "--coordinator-place",
        dest="coordinator_places",
        action="append",
        type=_place,
        metavar="X,Y",
        help="where a coordinator is; again for each further --link (default: spread over the arena)",
    )
    parser.add_argument(
        "--fault",
        action=FaultFlag,
        metavar="KEY=VALUE",
        help=f"a fault of lines and dongles, as bit-flip=1e-4 or unplug=0.1; may come again; docs/wire.md explains: {FAULT_KEYS}",
    )
    parser.add_argument("--coverage-radius", type=float, metavar="R", help="how far a coordinator is heard (default: everywhere)")


def add_backpack_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of radios and backpacks, and those of results."""
    parser.add_argument("--drain-s", type=float, metavar="S", help="wait this long for the last acknowledgements (default: 3)")
    parser.add_argument("--loss", type=float, metavar="P", help="probability that a radio payload is lost (default: 0)")
    parser.add_argument("--report-period-s", type=float, metavar="S", help="an encounter waits this long for company (default: 1)")
    parser.add_argument("--neighbours-period-s", type=float, metavar="S", help="how often neighbours are told (default: 5)")
    parser.add_argument("--boot", type=int, metavar="N", help="count of starts the backpacks tell (default: from the wall clock)")
    parser.add_argument("--out", metavar="DIR", help="directory for truth, reports and run.json; made if missing")
    parser.add_argument("--force", action="store_true", default=None, help="write into a directory that is not empty")
    parser.add_argument("--ready-file", metavar="FILE", help="holds the lines' addresses while they are up")


def main(args: argparse.Namespace) -> int:
    """Serve until the end; return the exit status.

    Raises
    ------
    ConfigurationError, SimulationError
        The configuration is faulty, or lines or output cannot be had.
    """
    config = load_config(ServeConfig, args)
    if args.check_config:
        find_preset(config.preset)
        choose_radio(config, loss=config.loss)
        if config.scenario is not None:
            find_scenario(config.scenario)
        sys.stdout.write(f"{args.config or 'defaults and environment'}: the configuration is valid\n")
        return 0
    set_up_logging()  # the setting has warnings of its own
    setting = choose_setting(config)
    check_node_numbers(setting.ids)
    lines = parse_lines(config.links)
    with contextlib.ExitStack() as stack:
        output = open_output(stack, out=config.out, force=config.force)
        world = World(
            setting.arena,
            motion=setting.motion,
            ranges=setting.ranges,
            ids=setting.ids,
            seed=setting.seed,
            speed_factor=config.speed_factor,
            keeps_legs=output is not None,
        )
        recorder = TruthRecorder(world)
        doors = Doors(world, setting.arena_changes)
        stream = TruthStream(output.unfinished) if output is not None else None
        cast = Cast(
            world=world,
            seed=setting.seed,
            coverage=_coverage(config, setting),
            end_s=config.duration_s,
            observe=observers(recorder, stream),
            tend=doors.tend,
            picture=_make_picture(config, setting, world),
            radio=choose_radio(config, loss=config.loss),
            sensing=sensing_config(config, setting, loss=config.loss) if config.sensing == "beacon" else None,
            wander_ppm=config.wander_ppm,
            has_imu=config.imu,
            can_follow_walls=config.wall_following,
            flush=stream.flush if stream is not None else lambda: None,
            response=config.response,
            metres_per_unit=_metres_per_unit(config, setting),
            speed_factor=config.speed_factor,
        )
        service = Service(config, cast, lines=lines, clock=WallClock())
        if stream is not None and output is not None:
            stream.describe({**_describe(config, setting), "t0_wall_ns": service.t0_wall_ns})
            log.info("serve.recording", unfinished=str(output.unfinished))
        asyncio.run(service.run())
        if output is not None:
            run = merge_descriptions(_describe(config, setting), service.describe())
            truth = recorder.files(
                zero_s=0.0,
                run=run | {"arena_changes": doors.describe(setting)},
                position_samples=config.position_samples,
                arena=setting.arena,
                changes=doors.done,
            )
            output.commit({"reported.csv": service.reported(), **truth})
            log.info("serve.written", out=config.out)
    return 0


def parse_lines(links: Sequence[str]) -> list[LineSpec]:
    """Read the lines of a configuration, or raise ParameterError where there is none."""
    if not links:
        raise ParameterError(name="link", got=None, wanted=f"the line that the gateway opens: {EXAMPLES}")
    return [parse_line(link) for link in links]


def open_output(stack: contextlib.ExitStack, *, out: str | None, force: bool) -> OutputDirectory | None:
    """Hold a place free for the results, if they are wanted, until the stack is closed."""
    return None if out is None else stack.enter_context(OutputDirectory(Path(out), force=force))


def observers(recorder: TruthRecorder, stream: TruthStream | None) -> tuple[Callable[[Sequence[Event]], None], ...]:
    """Return who is told of events: nobody where nothing is written, so that a run without end does not fill the memory."""
    return () if stream is None else (recorder.record, stream.record)


def merge_descriptions(setting: dict[str, object], done: dict[str, object]) -> dict[str, object]:
    """Put what was asked for and what was done into one ``run.json``, their parameters into one table."""
    first, second = setting.get("parameters"), done.get("parameters")
    assert isinstance(first, dict)
    assert isinstance(second, dict)
    return {**setting, **done, "parameters": {**first, **second}}


def _place(text: str) -> tuple[float, float]:
    x, comma, y = text.partition(",")
    try:
        if comma:
            return float(x), float(y)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is no place; wanted two numbers, as in 12.5,25")


def _make_picture(config: ServeConfig, setting: Setting, world: World) -> Watch | None:
    if not config.watch:
        return None
    title = f"{setting.arena_name}, {setting.preset}, seed {setting.seed}: {setting.biobots} biobots at {', '.join(config.links)}"
    return Watch(world, title=title, end_s=config.duration_s)


def _coverage(config: ServeConfig, setting: Setting) -> CoverageConfig:
    return CoverageConfig(
        places=config.coordinator_places or spread_places(setting.arena.polygon.bounds, len(config.links)),
        radius=config.coverage_radius,
        handover_db=config.handover_db,
    )


def _metres_per_unit(config: ServeConfig, setting: Setting) -> float:
    return config.metres_per_unit or _METRES.get(setting.unit, _NAMELESS_UNIT_M)


def _describe(config: ServeConfig, setting: Setting) -> dict[str, object]:
    return {
        "program": "biobot-sim serve",
        "version": version("biobot-gateway"),
        "scenario": config.scenario,
        "arena": config.arena,
        "preset": setting.preset,
        "seed": setting.seed,
        "unit_of_length": setting.unit,
        "speed_factor": config.speed_factor,
        "parameters": {
            "speed": setting.motion.speed,
            "mean_leg": setting.motion.mean_leg,
            "detection_radius": setting.ranges.detection,
            "communication_radius": setting.ranges.communication,
            "metres_per_unit": _metres_per_unit(config, setting),
            "response": msgspec.structs.asdict(config.response),
            "position_samples": config.position_samples,
            "sensing": config.sensing,
            "beacon_period_s": config.beacon_period_s if config.sensing == "beacon" else None,
            "radio": config.radio,
            **{name: value for name in BEACON_KEYS if (value := getattr(config, name)) is not None},
        },
        "motion": dataclasses.asdict(setting.motion),
        "arena_area": setting.arena.area,
        "betti_numbers": [setting.arena.betti.components, setting.arena.betti.holes],
    }
