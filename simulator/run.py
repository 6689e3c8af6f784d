"""A whole run as fast as it goes: its files, its progress, its snapshots."""

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from simulator.config import RunConfig
from simulator.errors import InterruptedRunError, OutputError, SnapshotError
from simulator.expedition import Expedition
from simulator.log import EventLog
from simulator.output import OutputDirectory, write_whole
from simulator.pictures.watch import Watch
from simulator.progress import shown_progress
from simulator.sensed_run import check_work, sensing_config

log = EventLog(__name__)

# So many pauses a run, at least, in which it can be stopped with its snapshot.
_PAUSES = 200


def run(config: RunConfig) -> None:
    """Simulate what the configuration says and write its files.

    Raises
    ------
    ConfigurationError
        Something needed is not given.
    SimulationError
        The setting makes no sense, or the results cannot be written; nothing is left behind but the snapshot asked for.
    """
    if config.out is None:
        raise ConfigurationError(["give --out DIR, where the results go"])
    with OutputDirectory(Path(config.out), force=config.force) as output:
        _finish(Expedition(config), output, config)


def resume(snapshot: Path, *, out: str | None, force: bool) -> None:
    """Take a run up where its snapshot was made, and finish it as ``run`` does.

    Parameters
    ----------
    snapshot
        File written by a run with ``snapshot`` set; it is kept up to date from here on.
    out
        Directory for the results, where not the one that the run was begun with.

    Raises
    ------
    SnapshotError
        The file cannot be read or is no whole snapshot of this version.
    ConfigurationError, SimulationError
        As for ``run``.
    """
    try:
        content = snapshot.read_bytes()
    except OSError as error:
        raise SnapshotError(source=str(snapshot), problem=f"it cannot be read: {error.strerror or error}") from error
    expedition = Expedition.resume(content, source=str(snapshot))
    log.info("run.resumed", snapshot=str(snapshot), t_s=round(expedition.world.now_s, 3), of_s=expedition.total_s)
    config = expedition.config
    place = out or config.out
    if place is None:
        raise ConfigurationError(["give --out DIR, where the results go"])
    with OutputDirectory(Path(place), force=force or config.force) as output:
        _finish(expedition, output, config, snapshot=snapshot)


def _finish(expedition: Expedition, output: OutputDirectory, config: RunConfig, *, snapshot: Path | None = None) -> None:
    sensing = sensing_config(config, expedition.setting) if config.sensing == "beacon" else None
    if sensing is not None:
        check_work(sensing, expedition.setting)
    began_s = time.perf_counter()
    place = snapshot or (None if config.snapshot is None else Path(config.snapshot))
    with _shown(expedition, config) as walk:
        _advance_to_the_end(expedition, walk, snapshot=place, every_s=config.snapshot_every_s)
    sensed = None
    if sensing is not None:
        with shown_progress("sensing.progress", total=expedition.total_s, unit="s sensed") as show:
            sensed = expedition.sense(sensing, progress=show)
    wall_time_s = round(time.perf_counter() - began_s, 3)
    about = {"program": "biobot-sim run", "version": version("biobot-gateway"), "wall_time_s": wall_time_s}
    output.commit(expedition.files(about, sensed=sensed))
    n_encounters = expedition.n_encounters if sensed is None else len(sensed.encounters)
    log.info("run.done", out=str(output.path), encounters=n_encounters, wall_time_s=wall_time_s)


def _advance_to_the_end(expedition: Expedition, walk: Callable[[float], None], *, snapshot: Path | None, every_s: float | None) -> None:
    if snapshot is None:
        expedition.advance(expedition.total_s, walk=walk)
        return
    with _noted_signals() as noted:
        write_whole(snapshot, expedition.save())  # proves, before anybody has walked, that it can be written
        saved_s, has_failed = expedition.world.now_s, False
        while not expedition.is_over:
            step_s = expedition.total_s / _PAUSES if every_s is None else min(every_s, expedition.total_s / _PAUSES)
            expedition.advance(expedition.world.now_s + step_s, walk=walk)
            is_due = every_s is not None and expedition.world.now_s - saved_s >= every_s and not expedition.is_over
            if is_due and not noted:
                saved_s = expedition.world.now_s
                has_failed = _write_snapshot(expedition, snapshot, has_failed=has_failed)
            if noted:
                write_whole(snapshot, expedition.save())
                raise InterruptedRunError(snapshot=snapshot, t_s=expedition.world.now_s)


def _write_snapshot(expedition: Expedition, snapshot: Path, *, has_failed: bool) -> bool:
    """Write a snapshot, and return whether that failed: the run is worth more than it. A fault is told when it begins and ends."""
    try:
        write_whole(snapshot, expedition.save())
    except OutputError as error:
        if not has_failed:
            log.warning("snapshot.failed", problem=str(error))
        return True
    if has_failed:
        log.info("snapshot.written_again", snapshot=str(snapshot))
    return False


@contextlib.contextmanager
def _noted_signals() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM instead of obeying them at once."""
    noted: list[int] = []
    before = {number: signal.signal(number, lambda number, _: noted.append(number)) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _shown(expedition: Expedition, config: RunConfig) -> Iterator[Callable[[float], None]]:
    """Give what lets time run and shows how far it is: a picture, a bar, or a line of the log now and then."""
    setting, world, recorder = expedition.setting, expedition.world, expedition.recorder
    if config.watch or config.watch_speed is not None:
        title = f"{setting.arena_name}, {setting.preset}, seed {setting.seed}: {setting.biobots} biobots"
        with Watch(world, title=title, zero_s=setting.dispersion_s, end_s=expedition.total_s, n_met=expedition.n_encounters) as watch:
            yield lambda until_s: recorder.record(watch.advance(until_s, speed=config.watch_speed))
    else:
        with shown_progress("run.progress", total=expedition.total_s, unit="s") as show:
            yield lambda until_s: recorder.record_run(world.run(until_s, progress=show))
