"""Errors of what is asked of the web service: what is not there, not yet, or not possible as things stand.

Leaves of `mapper.errors.MapError`, named for what the caller can do about them.
"""

from mapper.errors import MapError


class HoleNotFoundError(MapError):
    """The map has no hole of this number."""

    def __init__(self, *, number: int, n_holes: int) -> None:
        super().__init__(f"the map has no hole {number}; it has {n_holes}, numbered from 1; GET /api/v1/holes lists them")
        self.number = number
        self.n_holes = n_holes


class PinNotFoundError(MapError):
    """There is no pin of this name."""

    def __init__(self, *, name: str) -> None:
        super().__init__(f"there is no pin {name!r}; GET /api/v1/pins lists those there are")
        self.name = name


class PinRefusedError(MapError):
    """A pin cannot be kept as things stand; all is as before."""

    def __init__(self, *, name: str, reason: str, next_step: str) -> None:
        super().__init__(f"pin {name!r} is not kept: {reason}; {next_step}")
        self.name = name
        self.reason = reason


class TaskNotFoundError(MapError):
    """There is no job of this id."""

    def __init__(self, *, task: str, kept: int) -> None:
        super().__init__(f"there is no job {task!r}; of those that have ended, the newest {kept} are kept; GET /api/v1/jobs lists them")
        self.task = task


class NoResultError(MapError):
    """A job has no result: it has not ended yet, or it failed or was cancelled."""

    def __init__(self, *, task: str, state: str, problem: str | None) -> None:
        why = "" if problem is None else f": {problem}"
        next_step = "wait for it" if state in {"waiting", "running"} else "order it again"
        super().__init__(f"job {task!r} has no result, it is {state}{why}; {next_step}")
        self.task = task
        self.state = state


class UnknownParameterError(MapError):
    """A query parameter was given that the endpoint does not have: it would have been without effect."""

    def __init__(self, *, name: str, place: str, known: tuple[str, ...]) -> None:
        there = f"give one of those that it has: {', '.join(known)}" if known else "leave it out, for it has none"
        super().__init__(f"{place} has no query parameter {name!r}; {there} (/openapi.json describes them)")
        self.name = name
        self.place = place
        self.known = known


class PeriodError(MapError):
    """A time was asked for that ends before it begins."""

    def __init__(self, *, begin: float, until: float) -> None:
        super().__init__(f"the time asked for ends at {until:.15g} s, not after its begin at {begin:.15g} s; give a later end")
        self.begin = begin
        self.until = until


class OtherVersionError(MapError):
    """Something of a map was asked for that is no longer, or not yet, the newest."""

    def __init__(self, *, asked: int, newest: int) -> None:
        super().__init__(f"map {asked} is not the newest, that is {newest}; ask for that")
        self.asked = asked
        self.newest = newest


class LengthsNotKeptError(MapError):
    """The mapper was started anew, and the lengths between the points of the map from before were not kept."""

    def __init__(self, *, version: int) -> None:
        super().__init__(f"the lengths of map {version} were not kept when the mapper was started anew; the next map will have them")
        self.version = version


class MapNotFoundError(MapError):
    """A map of the past is not there: it never was, or is too old."""

    def __init__(self, *, version: int, oldest: int | None, newest: int | None) -> None:
        there = "none is kept yet" if oldest is None else f"of versions {oldest} to {newest} some are kept"
        super().__init__(f"no map of version {version} is kept; {there}, which /api/v1/maps lists")
        self.version = version


class AlertNotFoundError(MapError):
    """There is no alert of an id."""

    def __init__(self, *, alert_id: int) -> None:
        super().__init__(f"no alert has the id {alert_id}; /api/v1/alerts lists those that are remembered")
        self.alert_id = alert_id
