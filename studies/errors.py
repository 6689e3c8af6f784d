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


class CutFileError(StudyError):
    """The file holds no table of a simulated run: remove it, and it is made anew."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path = path
        super().__init__(f"{path}: no table of encounters of studies.long_run ({problem}); remove the file, and it is made anew")


class BenchmarkError(StudyError):
    """A measured process failed: see what it wrote."""

    def __init__(self, *, command: str, status: int, told: str) -> None:
        self.status = status
        super().__init__(f"{command} ended with status {status}; it wrote:\n{told.strip() or '(nothing)'}")


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


class JournalError(StudyError):
    """The journal of a study cannot be used: give another one, or move this one away."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path = path
        super().__init__(f"{path}: {problem}; give another journal, or move this one away")


class JournalBusyError(StudyError):
    """Another process writes this journal: wait for it, or give another journal."""

    def __init__(self, *, path: Path) -> None:
        self.path = path
        super().__init__(f"{path}: another process has this journal open; wait for it, or give another journal")


class ChangedProgramError(StudyError):
    """The journal holds results of another program: say whether they still hold."""

    def __init__(self, *, path: Path | None, n_old: int, n_cases: int, was: str, now: str) -> None:
        self.n_old = n_old
        super().__init__(
            f"{path}: {n_old} of the {n_cases} cases were computed by another program ({was}, now {now}): the code has changed since; "
            "give --changed recompute to compute them anew, or --changed keep if the change cannot have mattered"
        )


class ForeignProgramError(StudyError):
    """A worker of the cluster runs another program: install this one there."""

    def __init__(self, *, own: str, wanted: str) -> None:
        super().__init__(f"a worker runs another program ({own}, wanted {wanted}); install this version of biobot on the whole cluster")


class ResultError(StudyError):
    """A result cannot be written to a journal, or was not written by this study."""

    def __init__(self, *, study: str, problem: str) -> None:
        super().__init__(f"result of the study {study!r}: {problem}")


class CaseFailedError(StudyError):
    """Cases failed of which all are needed: look at the first, mend it, and retry."""

    def __init__(self, *, n_failed: int, n_cases: int, case: str, kind: str, message: str) -> None:
        self.n_failed = n_failed
        super().__init__(
            f"{n_failed} of {n_cases} cases failed; the first was {case}: {kind}: {message}; give --retry-failed when it is mended"
        )


class DaskError(StudyError):
    """The cluster asked for is not there."""

    def __init__(self, *, address: str, problem: str) -> None:
        self.address = address
        super().__init__(f"--dask {address}: {problem}")


class WorkerLostError(StudyError):
    """A process that computed was killed: give it more memory, or run fewer at once, and go on."""

    def __init__(self, *, problem: str) -> None:
        super().__init__(
            f"a computing process was lost ({problem}); what is done is kept: run fewer at once with --jobs, and run this again"
        )


class OtherDiagramError(StudyError):
    """A program gives another diagram than ours: report it."""

    def __init__(self, *, peer: str, matrix: str, dimension: int) -> None:
        super().__init__(f"{peer} gives other intervals of dimension {dimension} than ours for {matrix}; report it with both versions")
        self.peer = peer


class SummaryError(StudyError):
    """What an experiment left cannot be reported: run the experiment again, in full."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path = path
        super().__init__(f"{path}: {problem}; run python -m studies.paper.{path.stem}, without --quick")


class CampaignError(StudyError):
    """A campaign of faults cannot be run, or not to its end; the message says why and where the logs are."""


class SitesError(StudyError):
    """The topology of `studies.sites` cannot be set up, or a part of it did not do what it was started for; the message says which."""
