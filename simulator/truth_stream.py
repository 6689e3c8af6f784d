"""The truth of a run as it happens, in files that a killed process leaves behind.

``encounters.csv.partial`` has the columns of ``encounters.csv``, in the order in which encounters end, and can be replayed;
``modes.csv.partial`` says who went into which mode when; ``run.json.partial`` says what was run. They are written about every
second, whole lines at a time, and make way for the finished files at the end.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from simulator.events import BackpackSilenced, EncounterBegan, EncounterEnded, Event, ModeChanged
from simulator.log import EventLog

log = EventLog(__name__)


class TruthStream:
    """See the module.

    Parameters
    ----------
    directory
        Where the files go. A disk that takes them no more is told of in the log once; the run goes on.
    """

    __slots__ = ("_encounters", "_has_failed", "_modes", "_waiting")

    def __init__(self, directory: Path) -> None:
        self._encounters = directory / "encounters.csv.partial"
        self._modes = directory / "modes.csv.partial"
        self._has_failed = False
        self._waiting: dict[Path, list[str]] = {
            self._encounters: ["t_start_s,t_end_s,id1,id2\n"],
            self._modes: ["t_s,id,mode,cause\n"],
        }
        self.flush()

    def record(self, events: Sequence[Event]) -> None:
        """Take in what happened; it is on disk after the next ``flush``."""
        for event in events:
            match event:
                case EncounterEnded():
                    self._put(self._encounters, f"{event.t_start_s:.9f},{event.t_end_s:.9f},{event.id1},{event.id2}\n")
                case ModeChanged():
                    self._put(self._modes, f"{event.t_s:.9f},{event.id},{event.mode.value},{event.cause.value}\n")
                case EncounterBegan() | BackpackSilenced():
                    pass

    def describe(self, run: Mapping[str, object]) -> None:
        """Write what is run."""
        self._put(self._encounters.with_name("run.json.partial"), json.dumps(run, indent=2) + "\n")
        self.flush()

    def flush(self) -> None:
        """Hand what waits to the operating system."""
        waiting, self._waiting = self._waiting, {}
        try:
            for path, lines in waiting.items():
                with path.open("ab", buffering=0) as file:
                    file.write("".join(lines).encode())
        except OSError as error:
            self._has_failed = True
            log.warning("truth.not_kept", path=str(self._encounters.parent), problem=error.strerror or str(error))

    def _put(self, path: Path, line: str) -> None:
        if not self._has_failed:
            self._waiting.setdefault(path, []).append(line)
