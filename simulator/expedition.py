"""An expedition: dispersion, landmark selection, exploration; something that can be put on disk in the middle and taken up again."""

from collections.abc import Callable, Mapping
from functools import partial

import msgspec
import shapely

from firmware_protocol.first_use import prepare
from firmware_protocol.landmarks import select_landmarks
from simulator.config import RunConfig
from simulator.errors import SnapshotError
from simulator.radios.sensing import SensingConfig
from simulator.sensed_run import SensedRun, sense_run
from simulator.setting import Setting, choose_setting
from simulator.snapshot import seal, unseal
from simulator.truth import RecorderState, TruthRecorder
from simulator.world import World

_MARK = b"biobot run 1\n"


class _Saved(msgspec.Struct, frozen=True):
    """What a snapshot of an expedition holds; the world's own snapshot is one of its fields."""

    config: RunConfig
    world: bytes
    recorder: RecorderState
    landmarks: list[int]
    n_done: int
    arenas: list[bytes]


prepare(_Saved)


class Expedition:
    """A whole run, advanced bit by bit.

    Parameters
    ----------
    config
        A complete configuration.

    Raises
    ------
    ConfigurationError, SimulationError
        Something is not given, or makes no sense.
    """

    def __init__(self, config: RunConfig) -> None:
        self.config = config
        self.setting: Setting = choose_setting(config)
        setting = self.setting
        self.world = World(setting.arena, motion=setting.motion, ranges=setting.ranges, ids=setting.ids, seed=setting.seed)
        self.recorder = TruthRecorder(self.world)
        self.landmarks: list[int] = []
        self._n_done = 0

    @property
    def total_s(self) -> float:
        """When it ends, dispersion included [s]."""
        return self.setting.dispersion_s + self.setting.duration_s

    @property
    def is_over(self) -> bool:
        """All time has passed."""
        return self.world.now_s >= self.total_s and self._n_done == len(self._turns())

    def advance(self, until_s: float, *, walk: Callable[[float], None] | None = None) -> None:
        """Let time run to ``until_s`` [s], at most to the end, and do on the way what is due: set the landmarks, close doors.

        Parameters
        ----------
        walk
            Lets the world run to an instant and gives what happens to the recorder; without it, that is all that happens.
        """
        until_s = min(until_s, self.total_s)
        for at_s, act in self._turns()[self._n_done :]:
            if at_s > until_s:
                break
            self._run(at_s, walk)
            act()
            self._n_done += 1
        self._run(until_s, walk)

    def save(self) -> bytes:
        """Return a snapshot."""
        saved = _Saved(
            config=self.config,
            world=self.world.snapshot(),
            recorder=self.recorder.state(),
            landmarks=self.landmarks,
            n_done=self._n_done,
            arenas=_outlines(self.setting),
        )
        return seal(msgspec.msgpack.encode(saved), mark=_MARK)

    @classmethod
    def resume(cls, content: bytes, *, source: str) -> "Expedition":
        """Take up an expedition from its snapshot; ``source`` names it in messages.

        Raises
        ------
        SnapshotError
            The bytes are no whole snapshot of this version.
        ConfigurationError, SimulationError
            The arena file it began with is gone or has changed for the worse.
        """
        body = unseal(content, mark=_MARK, source=source)
        try:
            saved = msgspec.msgpack.decode(body, type=_Saved)
        except msgspec.DecodeError as error:
            raise SnapshotError(source=source, problem=f"it was written by another version ({error})") from error
        expedition = cls.__new__(cls)
        expedition.config = saved.config
        expedition.setting = choose_setting(saved.config)
        if _outlines(expedition.setting) != saved.arenas:
            problem = f"{expedition.setting.arena_name} is not the arena any more that the run was begun in; put the old file back"
            raise SnapshotError(source=source, problem=problem)
        expedition.world = World.restore(saved.world, source=source)
        expedition.recorder = TruthRecorder(expedition.world, state=saved.recorder)
        expedition.landmarks = saved.landmarks
        cls._set_done(expedition, saved.n_done)
        return expedition

    @property
    def n_encounters(self) -> int:
        """Encounters since the landmarks were set, those going on included."""
        return self.recorder.count_encounters(zero_s=self.setting.dispersion_s)

    def sense(self, config: SensingConfig, *, progress: Callable[[float], None] | None = None) -> SensedRun:
        """Sense the run that is over by beacons, up to when each backpack fell silent; walls attenuate as they stood at first.

        ``progress`` is called now and then with the instant up to which beacons were looked at [s].
        """
        zero_s = self.setting.dispersion_s
        return sense_run(
            self.world,
            arena=self.setting.arena,
            config=config,
            zero_s=zero_s,
            true=self.recorder.encounters(zero_s=zero_s),
            radio=self.config.radio,
            off_s=self.recorder.silent_from_s,
            progress=progress,
        )

    def files(self, about: Mapping[str, object] | None = None, *, sensed: SensedRun | None = None) -> dict[str, bytes]:
        """Return the content of every file of results, by name.

        Parameters
        ----------
        about
            Comes first in ``run.json``.
        sensed
            What beacons made of the run: ``encounters.csv`` then holds that.
        """
        setting = self.setting
        how = {"kind": self.config.sensing, **({} if sensed is None else sensed.description)}
        files = self.recorder.files(
            zero_s=setting.dispersion_s,
            run={**(about or {}), **setting.describe(), "landmark_ids": sorted(self.landmarks), "sensing": how},
            position_samples=self.config.position_samples,
            arena=setting.arena,
            changes=setting.arena_changes,
            observed=None if sensed is None else sensed.encounters,
        )
        return ({} if sensed is None else sensed.files) | files

    def _turns(self) -> list[tuple[float, Callable[[], None]]]:
        """List what is to be done when [s], in order; at one instant in this order."""
        zero_s = self.setting.dispersion_s
        doors = [(zero_s + change.at_s, partial(self.world.replace_arena, change.arena)) for change in self.setting.arena_changes]
        return [(zero_s, self._set_landmarks), *doors]

    def _set_landmarks(self) -> None:
        self.landmarks = list(select_landmarks(self.world.adjacency(), count=self.setting.landmarks))
        for landmark in self.landmarks:
            self.world.stop(landmark)

    def _run(self, until_s: float, walk: Callable[[float], None] | None) -> None:
        if until_s <= self.world.now_s:
            return
        if walk is None:
            self.recorder.record_run(self.world.run(until_s))
        else:
            walk(until_s)

    def _set_done(self, count: int) -> None:
        self._n_done = count


def _outlines(setting: Setting) -> list[bytes]:
    """Return the arena and what it becomes, as bytes that differ where they do."""
    return [shapely.to_wkb(arena.polygon) for arena in (setting.arena, *(change.arena for change in setting.arena_changes))]
