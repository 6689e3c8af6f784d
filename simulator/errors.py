"""What can go wrong in the simulator, by what the caller can do about it."""

from pathlib import Path


class SimulationError(Exception):
    """Root of every error the simulator raises on purpose."""


class ParameterError(SimulationError):
    """A number lies outside what the model allows: give another one."""

    def __init__(self, *, name: str, got: object, wanted: str) -> None:
        self.name = name
        self.got = got
        self.wanted = wanted
        super().__init__(f"{name} is {got!r}; wanted {wanted}")


class ArenaError(SimulationError):
    """The arena is no area in which an insect can walk: mend its outline."""

    def __init__(self, *, source: str, problem: str) -> None:
        self.source = source
        self.problem = problem
        super().__init__(f"{source}: {problem}")


class OutsideArenaError(SimulationError):
    """Points lie outside the arena: give points of this arena, in its unit of length."""

    def __init__(self, *, row: int, count: int, place: tuple[float, ...], distance: float) -> None:
        self.row = row
        self.count = count
        super().__init__(
            f"{count} point{'s' if count > 1 else ''} outside the arena; the first is row {row} at {place}, {distance:.3g} from it; "
            "wanted finite points inside or on a wall; are points and arena in the same unit of length?"
        )


class ScenarioError(SimulationError):
    """No scenario or preset has this name: choose one of those known."""

    def __init__(self, *, kind: str, got: str, known: tuple[str, ...]) -> None:
        self.kind = kind
        self.got = got
        self.known = known
        super().__init__(f"no {kind} is called {got!r}; choose one of {', '.join(known)} (biobot-sim scenarios lists them)")


class UnknownBiobotError(SimulationError):
    """The world holds no biobot with this id."""

    def __init__(self, *, biobot_id: int, first: int, last: int, count: int) -> None:
        self.biobot_id = biobot_id
        super().__init__(f"no biobot has id {biobot_id}; this world holds {count}, with ids between {first} and {last}")


class TimeError(SimulationError):
    """An instant lies where the world cannot go or look."""

    def __init__(self, *, got_s: float, wanted: str) -> None:
        self.got_s = got_s
        super().__init__(f"time {got_s!r} s; wanted {wanted}")


class OutputError(SimulationError):
    """The result cannot be written where it was asked for: choose another directory, or free this one."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


class LineError(SimulationError):
    """The serial line to the base station cannot be had: choose another one, or free this one."""

    def __init__(self, *, line: str, problem: str) -> None:
        self.line = line
        self.problem = problem
        super().__init__(f"{line}: {problem}")


class EngineMissingError(SimulationError):
    """The compiled engine is not there or does not fit: install the package anew, with a C compiler at hand."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path = path
        super().__init__(
            f"{path}: the simulator's engine cannot be loaded ({problem}); install the package again where there is a C compiler "
            "(gcc or clang): 'make venv' in a checkout, 'pip install .' elsewhere"
        )


class EngineMemoryError(SimulationError):
    """The engine ran out of memory: take fewer biobots or less time at once."""

    def __init__(self, *, n_biobots: int, at_s: float) -> None:
        super().__init__(f"out of memory at {at_s:g} s with {n_biobots} biobots; take fewer biobots or less time")


class SnapshotError(SimulationError):
    """The bytes are no snapshot that this program can take up: use the program that wrote it, or begin anew."""

    def __init__(self, *, source: str, problem: str) -> None:
        self.source = source
        super().__init__(f"{source}: {problem}; wanted a whole snapshot, written by this version of the simulator on this kind of machine")


class InterruptedRunError(SimulationError):
    """A signal ended a run, and its snapshot was written: resume it."""

    def __init__(self, *, snapshot: Path, t_s: float) -> None:
        self.snapshot = snapshot
        super().__init__(f"interrupted at {t_s:g} s; go on with: biobot-sim resume {snapshot}")


class RunFileError(SimulationError):
    """A run that was to be read is not there, not whole or not understood: name the directory of a finished run."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


class MissingLibraryError(SimulationError):
    """An optional library is not installed: install it, or ask for something that does without."""

    def __init__(self, *, library: str, needed_for: str, remedy: str) -> None:
        self.library = library
        super().__init__(f"the library {library} is not installed; wanted for {needed_for}: {remedy}")


class RecordingError(SimulationError):
    """A recording cannot be replayed: mend the file at the line told, or give another one."""

    def __init__(self, *, path: Path, problem: str, line: int | None = None) -> None:
        self.path = path
        self.line = line
        self.problem = problem
        super().__init__(f"{path}{'' if line is None else f', line {line}'}: {problem}")
