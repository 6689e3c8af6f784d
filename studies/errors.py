"""What can go wrong in a study, by what the caller can do about it."""

from pathlib import Path


class StudyError(Exception):
    """Root of the errors that a study raises on purpose."""


class RunDirectoryError(StudyError):
    """The directory does not hold a whole simulated run: give another one, or run it again."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


class MapFileError(StudyError):
    """The file is no map of the mapper: give what ``biobot-mapper run --json`` or ``/api/v1/map`` wrote."""

    def __init__(self, *, source: str, problem: str) -> None:
        self.source = source
        self.problem = problem
        super().__init__(f"{source}: {problem}; give the JSON of biobot-mapper run --json FILE")


class OtherRunError(StudyError):
    """The map was not made of this run: give the directory of the run it was made of."""

    def __init__(self, *, path: Path, n_points: int, n_absent: int, example: str, within_s: float) -> None:
        self.path = path
        self.n_absent = n_absent
        super().__init__(
            f"{path}: {n_absent} of {n_points} points of the map are no encounters of this run, as {example}; "
            f"wanted each within {within_s:g} s; give the directory of the run that the map was made of"
        )


class NoRoomError(StudyError):
    """The obstacles asked for do not fit into the outline; ask for fewer or smaller ones."""

    def __init__(self, *, n_holes: int, sides: tuple[float, float], area: float) -> None:
        super().__init__(
            f"{n_holes} square obstacles of side {sides[0]:g} to {sides[1]:g} found no place in an outline of area {area:g}; "
            "ask for fewer or smaller ones"
        )


class MarkerError(StudyError):
    """The document has no place for the table: put the two markers where it belongs."""

    def __init__(self, *, path: Path, markers: tuple[str, str]) -> None:
        self.path = path
        self.markers = markers
        super().__init__(
            f"{path}: wanted each of the markers {markers[0]!r} and {markers[1]!r} once, in this order; put them where the table goes"
        )


class NoArenaError(StudyError):
    """No valid arena of this kind could be drawn; take another seed."""

    def __init__(self, *, kind: str, tries: int) -> None:
        super().__init__(f"no valid arena of kind '{kind}' in {tries} tries; take another seed")


class EscapeError(StudyError):
    """An insect left its arena: a fault of the engine, to be reduced to a test."""

    def __init__(self, *, place: str, problem: str, n_found: int) -> None:
        super().__init__(f"{place}: {problem} ({n_found} such in this world); run this world alone with --first, and mend the engine")


class CampaignFileError(StudyError):
    """The file of an unfinished campaign cannot be taken up: give another one, or remove it."""

    def __init__(self, *, path: Path, problem: str) -> None:
        super().__init__(f"{path}: {problem}; give another --state FILE, or remove this one")
