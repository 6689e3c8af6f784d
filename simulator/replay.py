"""``biobot-sim replay``: a recorded run, once more, for a gateway to listen to."""

import argparse
import asyncio
import contextlib
import sys
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from simulator.backpacks.backpack import MAX_NODE
from simulator.clock import WallClock
from simulator.config_sources import load_config
from simulator.errors import ParameterError
from simulator.log import EventLog, set_up_logging
from simulator.radios.coverage import CoverageConfig, spread_places
from simulator.radios.radio import RadioConfig
from simulator.recorded_world import RecordedWorld
from simulator.recording import load_recording
from simulator.replay_config import ReplayConfig
from simulator.serve import add_backpack_arguments, add_line_arguments, merge_descriptions, observers, open_output, parse_lines
from simulator.service import Cast, Service
from simulator.truth import TruthRecorder
from simulator.truth_stream import TruthStream

log = EventLog(__name__)

_SHORT_GAP_S = 0.1
"""Encounters of one pair that come closer than this may become one at the gateway, whose clocks are not better."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``replay``."""
    parser.add_argument("source", nargs="?", metavar="DIR|FILE.csv", help="results of run or serve, or a CSV file of encounters")
    add_line_arguments(parser)
    parser.add_argument(
        "--speed", "--speed-factor", dest="speed_factor", type=float, metavar="X", help="so many recorded seconds go by in one (default: 1)"
    )
    parser.add_argument("--renumber", action="store_true", default=None, help="number the biobots 1, 2, ... in the order of their ids")
    parser.add_argument("--seed", type=int, metavar="N", help="for radios and backpacks (default: 0)")
    add_backpack_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Replay to the end; return the exit status.

    Raises
    ------
    ConfigurationError, SimulationError
        The configuration or the recording is faulty, or lines or output cannot be had.
    """
    config = load_config(ReplayConfig, args)
    if args.check_config:
        sys.stdout.write(f"{args.config or 'defaults and environment'}: the configuration is valid\n")
        return 0
    if config.source is None:
        raise ConfigurationError(["give the recording: a directory of results, or a CSV file of encounters"])
    lines = parse_lines(config.links)
    world = make_world(config, Path(config.source))
    set_up_logging()
    log.info("replay.fixed_past", hint="commands are answered and change nothing: the insects do what they did")
    if n_gaps := world.count_short_gaps(_SHORT_GAP_S):
        log.warning("replay.short_gaps", count=n_gaps, below_s=_SHORT_GAP_S, hint="such encounters of a pair may merge; lower --speed")
    with contextlib.ExitStack() as stack:
        output = open_output(stack, out=config.out, force=config.force)
        recorder = TruthRecorder(world)
        stream = TruthStream(output.unfinished) if output is not None else None
        cast = Cast(
            world=world,
            seed=config.seed,
            coverage=_coverage(config, world),
            end_s=world.end_s,
            observe=observers(recorder, stream),
            flush=stream.flush if stream is not None else lambda: None,
            insects_obey=False,
            radio=RadioConfig(loss=config.loss),
        )
        service = Service(config, cast, lines=lines, clock=WallClock())
        asyncio.run(service.run())
        if output is not None:
            run = merge_descriptions(_describe(config, world), service.describe())
            truth = recorder.files(zero_s=0.0, run=run, position_samples=config.position_samples)
            output.commit({"reported.csv": service.reported(), **truth})
            log.info("serve.written", out=config.out)
    return 0


def make_world(config: ReplayConfig, source: Path) -> RecordedWorld:
    """Read a recording and make a world of it.

    Raises
    ------
    RecordingError, ArenaError
        The recording is faulty.
    ParameterError
        An id is no node number.
    """
    recording = load_recording(source)
    if recording.ids[-1] > MAX_NODE and not config.renumber:
        raise ParameterError(
            name="largest id in the recording", got=recording.ids[-1], wanted=f"at most {MAX_NODE}, a node number; give --renumber"
        )  # fmt: skip
    return RecordedWorld(recording, compression=config.speed_factor, renumber=config.renumber)


def _coverage(config: ReplayConfig, world: RecordedWorld) -> CoverageConfig:
    n_lines = len(config.links)
    if world.arena is None and (n_lines > 1 or config.coverage_radius is not None):
        raise ParameterError(
            name="link" if n_lines > 1 else "coverage_radius",
            got=config.links if n_lines > 1 else config.coverage_radius,
            wanted="one coordinator that is heard everywhere: without truth.npz and arena.geojson it is not known where biobots are",
        )
    bounds = (0.0, 0.0, 0.0, 0.0) if world.arena is None else world.arena.polygon.bounds
    places = config.coordinator_places or spread_places(bounds, n_lines)
    return CoverageConfig(places=places, radius=config.coverage_radius, handover_db=config.handover_db)


def _describe(config: ReplayConfig, world: RecordedWorld) -> dict[str, object]:
    recorded = {str(one): was for one, was in world.recorded_ids.items()} if config.renumber else None
    return {
        "program": "biobot-sim replay",
        "version": version("biobot-gateway"),
        "source": config.source,
        "seed": config.seed,
        "recorded_zero_s": world.zero_s,
        "recorded_ids": recorded,
        "parameters": {"detection_radius": world.ranges.detection, "communication_radius": world.ranges.communication},
    }
