"""A whole run as fast as it goes: dispersion, landmark selection, exploration, files."""

import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.landmarks import select_landmarks
from simulator.config import RunConfig
from simulator.events import EncounterEnded
from simulator.log import EventLog
from simulator.output import OutputDirectory
from simulator.sensed_run import sense_run, sensing_config
from simulator.setting import choose_setting
from simulator.truth import TruthRecorder
from simulator.world import World

log = EventLog(__name__)

_BAR_WIDTH = 40


def run(config: RunConfig) -> None:
    """Simulate what the configuration says and write its files.

    Raises
    ------
    ConfigurationError
        Something needed is not given.
    SimulationError
        The setting makes no sense, or the results cannot be written; nothing is left behind.
    """
    if config.out is None:
        raise ConfigurationError(["give --out DIR, where the results go"])
    setting = choose_setting(config)
    sensing = sensing_config(config, setting) if config.sensing == "beacon" else None
    with OutputDirectory(Path(config.out), force=config.force) as output:
        began_s = time.perf_counter()
        world = World(setting.arena, motion=setting.motion, ranges=setting.ranges, ids=setting.ids, seed=setting.seed)
        recorder = TruthRecorder(world)
        total_s = setting.dispersion_s + setting.duration_s
        show = _show_bar(total_s) if sys.stderr.isatty() else None
        recorder.record(world.advance(setting.dispersion_s, progress=show))
        landmarks = select_landmarks(world.adjacency(), count=setting.landmarks)
        for landmark in landmarks:
            world.stop(landmark)
        events = world.advance(total_s, progress=show)
        recorder.record(events)
        if show is not None:
            sys.stderr.write("\n")
        zero_s = setting.dispersion_s
        sensed = None
        if sensing is not None:
            sensed = sense_run(world, config=sensing, zero_s=zero_s, true=recorder.encounters(zero_s=zero_s), radio=config.radio)
        wall_time_s = round(time.perf_counter() - began_s, 3)
        description = {
            "program": "biobot-sim run",
            "version": version("biobot-gateway"),
            **setting.describe(),
            "landmark_ids": sorted(landmarks),
            "wall_time_s": wall_time_s,
            "sensing": {"kind": config.sensing, **({} if sensed is None else sensed.description)},
        }
        observed = None if sensed is None else sensed.encounters
        files = recorder.files(zero_s=zero_s, run=description, position_samples=config.position_samples, observed=observed)
        output.commit(({} if sensed is None else sensed.files) | files)
    n_ended = sum(isinstance(event, EncounterEnded) for event in events)
    encounters = n_ended + len(world.open_encounters()) if observed is None else len(observed)
    log.info("run.done", out=config.out, encounters=encounters, wall_time_s=wall_time_s)


def _show_bar(total_s: float) -> Callable[[float], None]:
    def show(now_s: float) -> None:
        share = now_s / total_s
        filled = round(share * _BAR_WIDTH)
        sys.stderr.write(f"\r[{'#' * filled}{' ' * (_BAR_WIDTH - filled)}] {share:4.0%}  {now_s:.0f} of {total_s:.0f} s")
        sys.stderr.flush()

    return show
