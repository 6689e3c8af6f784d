"""Errors of what was, beside those of `mapper.errors`: maps of the past that are not kept, and alerts that there are not."""

from mapper.errors import MapError


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
