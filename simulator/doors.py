"""Walls that change while a world is served: doors that close, and whatever else a scenario or the arena files say."""

from collections.abc import Sequence

from simulator.arenas.arena import ArenaChange
from simulator.log import EventLog
from simulator.setting import Setting
from simulator.world import World

log = EventLog(__name__)


class Doors:
    """Puts up the walls that are due. Whose landmarks are set when is the gateway's business, so times count from the start.

    Parameters
    ----------
    changes
        In order of time.
    """

    __slots__ = ("_changed_at_s", "_changes", "_world")

    def __init__(self, world: World, changes: Sequence[ArenaChange]) -> None:
        self._world = world
        self._changes = tuple(changes)
        self._changed_at_s: list[float] = []

    @property
    def done(self) -> tuple[ArenaChange, ...]:
        """The changes made so far."""
        return self._changes[: len(self._changed_at_s)]

    def tend(self) -> None:
        """Make the changes that are due by the world's time."""
        for change in self._changes[len(self._changed_at_s) :]:
            if self._world.now_s < change.at_s:
                return
            self._world.replace_arena(change.arena)
            self._changed_at_s.append(self._world.now_s)
            log.info("arena.changed", t_s=round(self._world.now_s, 3), holes=change.arena.betti.holes)

    def describe(self, setting: Setting) -> list[dict[str, object]]:
        """List the changes made, when they were, for ``run.json``."""
        return [one | {"at_s": at_s} for one, at_s in zip(setting.describe_changes(), self._changed_at_s, strict=False)]
