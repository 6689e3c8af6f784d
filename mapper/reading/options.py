"""What a person may say about a log: which column is what, the unit of its times, and how far apart sightings of one contact are."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Role(StrEnum):
    """What a column tells: when a contact began and ended, or an instant with or without a duration; and between whom."""

    START = "t_start"
    END = "t_end"
    INSTANT = "t"
    DURATION = "duration"
    ID1 = "id1"
    ID2 = "id2"


class TimeUnit(StrEnum):
    """Unit of a time that is written as a number."""

    SECONDS = "s"
    MILLISECONDS = "ms"
    MICROSECONDS = "us"
    NANOSECONDS = "ns"
    MINUTES = "min"
    HOURS = "h"
    DAYS = "d"

    @property
    def nanoseconds(self) -> int:
        """Nanoseconds in one."""
        return _NANOSECONDS[self]


_NANOSECONDS = {
    TimeUnit.NANOSECONDS: 1,
    TimeUnit.MICROSECONDS: 10**3,
    TimeUnit.MILLISECONDS: 10**6,
    TimeUnit.SECONDS: 10**9,
    TimeUnit.MINUTES: 60 * 10**9,
    TimeUnit.HOURS: 3600 * 10**9,
    TimeUnit.DAYS: 86_400 * 10**9,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions:
    """What was said on the command line; None and nothing: found in the file.

    ``columns`` are names, or all of them numbers counted from 1, with which a file needs no header. ``gap_ns``: sightings of one pair no
    further apart than this are one contact.
    """

    columns: Mapping[Role, str] = field(default_factory=dict)
    time_unit: TimeUnit | None = None
    gap_ns: int | None = None


def parse_columns(text: str) -> dict[Role, str]:
    """Read ``t_start=begin,t_end=finish,id1=who,id2=whom``.

    Raises
    ------
    ValueError
        Something else is written there, a role is named twice, or the roles make no encounter.
    """
    known = ", ".join(Role)
    columns: dict[Role, str] = {}
    for part in text.split(","):
        name, equals, column = (piece.strip() for piece in part.partition("="))
        if not equals or not column or name not in set(Role):
            raise ValueError(f"{part.strip()!r} is no column; wanted ROLE=NAME with a role of {known}, as id1=badge")
        role = Role(name)
        if role in columns:
            raise ValueError(f"{name} is given twice; name one column for each of {known}")
        columns[role] = column
    if Role.INSTANT in columns and (Role.START in columns or Role.END in columns):
        raise ValueError("t and t_start or t_end are both given; a log has instants (t, with a duration or without), or begins and ends")
    if Role.END in columns and Role.DURATION in columns:
        raise ValueError("t_end and duration are both given; one of them says when a contact was over")
    if (Role.ID1 in columns) != (Role.ID2 in columns):
        raise ValueError("of id1 and id2 only one is given; name both columns")
    return columns
