"""Tell waiters that something has changed. Only the newest state counts: whoever is slow skips what lay between."""

import asyncio
from collections.abc import Mapping
from enum import StrEnum


class Topic(StrEnum):
    """What can change."""

    RECORDS = "records"
    MAP = "map"
    BIOBOTS = "biobots"
    COMMANDS = "commands"
    MISSION = "mission"
    PINS = "pins"
    JOBS = "jobs"
    MAPS = "maps"
    """Which maps of the past are kept."""
    ALERTS = "alerts"


class Changes:
    """A version number for each topic; they only grow."""

    def __init__(self) -> None:
        self._versions = dict.fromkeys(Topic, 0)
        self._next = asyncio.Event()

    @property
    def versions(self) -> Mapping[Topic, int]:
        """The versions now; the mapping does not change later."""
        return dict(self._versions)

    def bump(self, topic: Topic) -> None:
        """Count a change of a topic and wake all who wait."""
        self._versions[topic] += 1
        self._next.set()
        self._next = asyncio.Event()

    async def wait(self, *, seen: Mapping[Topic, int]) -> Mapping[Topic, int]:
        """Return the versions as soon as one of the topics in ``seen`` has another version than there."""
        while all(self._versions[topic] == version for topic, version in seen.items()):
            await self._next.wait()
        return self.versions
