"""A whole run as fast as it goes: dispersion, landmark selection, exploration, files."""

import contextlib
import functools
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.landmarks import select_landmarks
from simulator.config import RunConfig
from simulator.events import EncounterEnded, Event
from simulator.log import EventLog
from simulator.output import OutputDirectory
from simulator.setting import Setting, choose_setting
from simulator.truth import TruthRecorder
from simulator.watch import Watch
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
    with OutputDirectory(Path(config.out), force=config.force) as output:
        began_s = time.perf_counter()
        world = World(setting.arena, motion=setting.motion, ranges=setting.ranges, ids=setting.ids, seed=setting.seed)
        recorder = TruthRecorder(world)
        total_s = setting.dispersion_s + setting.duration_s
        with _shown(world, config, setting) as advance:
            recorder.record(advance(setting.dispersion_s))
            landmarks = select_landmarks(world.adjacency(), count=setting.landmarks)
            for landmark in landmarks:
                world.stop(landmark)
            events = advance(total_s)
        recorder.record(events)
        wall_time_s = round(time.perf_counter() - began_s, 3)
        description = {
            "program": "biobot-sim run",
            "version": version("biobot-gateway"),
            **setting.describe(),
            "landmark_ids": sorted(landmarks),
            "wall_time_s": wall_time_s,
        }
        output.commit(recorder.files(zero_s=setting.dispersion_s, run=description, position_samples=config.position_samples))
    n_ended = sum(isinstance(event, EncounterEnded) for event in events)
    log.info("run.done", out=config.out, encounters=n_ended + len(world.open_encounters()), wall_time_s=wall_time_s)


@contextlib.contextmanager
def _shown(world: World, config: RunConfig, setting: Setting) -> Iterator[Callable[[float], list[Event]]]:
    """Give what advances the world and shows how far it is: a picture, a bar, or nothing where nobody looks."""
    total_s = setting.dispersion_s + setting.duration_s
    if config.watch or config.watch_speed is not None:
        title = f"{setting.arena_name}, {setting.preset}, seed {setting.seed}: {setting.biobots} biobots"
        with Watch(world, title=title, zero_s=setting.dispersion_s, end_s=total_s) as watch:
            yield functools.partial(watch.advance, speed=config.watch_speed)
    elif sys.stderr.isatty():
        yield functools.partial(world.advance, progress=_show_bar(total_s))
        sys.stderr.write("\n")
    else:
        yield world.advance


def _show_bar(total_s: float) -> Callable[[float], None]:
    def show(now_s: float) -> None:
        share = now_s / total_s
        filled = round(share * _BAR_WIDTH)
        sys.stderr.write(f"\r[{'#' * filled}{' ' * (_BAR_WIDTH - filled)}] {share:4.0%}  {now_s:.0f} of {total_s:.0f} s")
        sys.stderr.flush()

    return show
