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


class RecordingError(SimulationError):
    """A recording cannot be replayed: mend the file at the line told, or give another one."""

    def __init__(self, *, path: Path, problem: str, line: int | None = None) -> None:
        self.path = path
        self.line = line
        self.problem = problem
        super().__init__(f"{path}{'' if line is None else f', line {line}'}: {problem}")
