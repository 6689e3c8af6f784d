"""Which column of a table is what, by the table of names in docs/your-own-data.md, or as a person says."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from mapper.reading.options import ReadingOptions, Role, TimeUnit

# Names are compared in lower case, without what stands between words, and without a unit at the end.
NAMES_OF_TIMES: dict[Role, frozenset[str]] = {
    Role.START: frozenset(
        [
            "start",
            "tstart",
            "startt",
            "starttime",
            "timestart",
            "startdatetime",
            "datetimestart",
            "starttimestamp",
            "timestampstart",
            "startwall",
            "begin",
            "tbegin",
            "begintime",
            "timebegin",
            "beginning",
            "t1",
            "contactstart",
            "contactstarttime",
        ]
    ),
    Role.END: frozenset(
        [
            "end",
            "tend",
            "endt",
            "endtime",
            "timeend",
            "enddatetime",
            "datetimeend",
            "endtimestamp",
            "timestampend",
            "endwall",
            "stop",
            "tstop",
            "stoptime",
            "timestop",
            "finish",
            "finishtime",
            "t2",
            "contactend",
            "contactendtime",
        ]
    ),
    Role.INSTANT: frozenset(
        [
            "t",
            "time",
            "timestamp",
            "datetime",
            "date",
            "ts",
            "utc",
            "timeutc",
            "timestamputc",
            "datetimeutc",
            "unix",
            "unixtime",
            "epoch",
            "posix",
            "posixtime",
            "instant",
            "when",
        ]
    ),
    Role.DURATION: frozenset(["duration", "dur", "contactduration", "durationofcontact"]),
}
_WORDS_OF_NODES = [
    "id",
    "node",
    "user",
    "person",
    "people",
    "animal",
    "tag",
    "device",
    "badge",
    "biobot",
    "insect",
    "individual",
    "ind",
    "subject",
    "member",
    "dyadmember",
    "agent",
    "mac",
    "participant",
    "actor",
    "vertex",
    "peer",
    "name",
    "student",
    "child",
    "robot",
    "sensor",
    "bird",
    "cow",
    "calf",
    "mouse",
]
_ENDINGS = (("1", "2"), ("a", "b"), ("i", "j"), ("from", "to"), ("source", "target"))
_BARE_PAIRS = (("a", "b"), ("i", "j"), ("u", "v"), ("source", "target"), ("src", "dst"), ("sender", "receiver"), ("ego", "alter"))
# Whoever stands in a column of this name is a place.
_WORDS_OF_PLACES = [
    "reader",
    "anchor",
    "station",
    "basestation",
    "antenna",
    "beacon",
    "feeder",
    "nestbox",
    "room",
    "place",
    "location",
    "site",
    "accesspoint",
    "ap",
    "gate",
    "portal",
    "landmark",
]
_PAIRS_OF_NODES = (
    *((f"{word}{one}", f"{word}{other}") for word, (one, other) in product(_WORDS_OF_NODES, _ENDINGS)),
    *((f"{one}{word}", f"{other}{word}") for word, (one, other) in product(_WORDS_OF_NODES, _ENDINGS[3:])),
    *_BARE_PAIRS,
)
_PAIRS_WITH_PLACES = tuple(
    (f"{word}{end}", f"{place}{other}") for word, place, end, other in product(_WORDS_OF_NODES, _WORDS_OF_PLACES, ("", "id"), ("", "id"))
)
_KEYS_OF_PLACES = frozenset(f"{place}{other}" for place, other in product(_WORDS_OF_PLACES, ("", "id")))
_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), TimeUnit.SECONDS),
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), TimeUnit.MILLISECONDS),
    **dict.fromkeys(("us", "usec", "micros", "microsecond", "microseconds"), TimeUnit.MICROSECONDS),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanosecond", "nanoseconds"), TimeUnit.NANOSECONDS),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), TimeUnit.MINUTES),
    **dict.fromkeys(("h", "hour", "hours"), TimeUnit.HOURS),
    **dict.fromkeys(("d", "day", "days"), TimeUnit.DAYS),
}
_OWN = {Role.START: "t_start_s", Role.END: "t_end_s", Role.ID1: "id1", Role.ID2: "id2"}
_SHOWN_NAMES = 120


class UnknownColumnsError(ValueError):
    """The columns cannot be told; the words say what is there, what is wanted, and what to say."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What the columns of a table are.

    ``place`` of each role, counted from 0; ``name`` of each, as the table has it (``column 3`` without a header); ``unit`` that a name
    states. ``is_place``: the second id is a place, by its column's name. ``is_own``: the table has the project's own columns.
    """

    place: Mapping[Role, int]
    name: Mapping[Role, str]
    unit: Mapping[Role, TimeUnit]
    n_columns: int
    is_place: bool = False
    is_own: bool = False
    ignored: tuple[str, ...] = ()


def find_layout(names: Sequence[str], options: ReadingOptions) -> Layout:
    """Tell the columns of a header; what was said wins, the project's own names come before others, and a second reading is no reading.

    Raises
    ------
    UnknownColumnsError
        A name that was said is not there; or times or ids are not there, or there twice.
    """
    names = [name.strip() for name in names]
    place = {role: _said_place(role, column, names) for role, column in options.columns.items()}
    is_own = not place and all(names.count(name) == 1 for name in _OWN.values())
    if is_own:
        place = {role: names.index(name) for role, name in _OWN.items()}
    taken = set(place.values())
    keys = ["" if index in taken else _key(name) for index, name in enumerate(names)]
    if Role.ID1 not in place:
        place |= _find_ids(keys, names, has_times=_has_times(place))
    if not _has_times(place):
        place |= _find_times(keys, names)
    place = {role: place[role] for role in Role if role in place}
    return Layout(
        place=place,
        name={role: names[index] for role, index in place.items()},
        unit={role: unit for role, index in place.items() if (unit := stated_unit(names[index])) is not None},
        n_columns=len(names),
        is_place=not is_own and _key(names[place[Role.ID2]]) in _KEYS_OF_PLACES,
        is_own=is_own,
        ignored=tuple(name for index, name in enumerate(names) if index not in place.values()),
    )


def number_layout(first: Sequence[str], columns: Mapping[Role, str]) -> Layout:
    """Tell columns by their numbers, counted from 1; ``first`` is the first row.

    Raises
    ------
    UnknownColumnsError
        There are not so many columns, or no times or no ids are among them.
    """
    for role, column in columns.items():
        if not 1 <= int(column[:9]) <= len(first):
            raise UnknownColumnsError(f"column {column} was named for {role}, but there are {len(first)}; count from 1 to {len(first)}")
    place = {role: int(column) - 1 for role, column in columns.items()}
    if not _has_times(place) or Role.ID1 not in place:
        raise UnknownColumnsError("where columns are given by number, all must be, as --columns t_start=1,t_end=2,id1=3,id2=4")
    return Layout(place=place, name={role: f"column {column}" for role, column in columns.items()}, unit={}, n_columns=len(first))


def stated_unit(name: str) -> TimeUnit | None:
    """Return the unit at the end of a column's name, as in ``t_ms`` or ``duration [min]``."""
    words = _words(name)
    return _UNITS.get(words[-1]) if len(words) > 1 else None


def _said_place(role: Role, column: str, names: Sequence[str]) -> int:
    found = [index for index, name in enumerate(names) if name == column] or [
        index for index, name in enumerate(names) if name.casefold() == column.casefold()
    ]
    if len(found) != 1:
        times = "not there" if not found else "there twice"
        raise UnknownColumnsError(f"column {column!r} was named for {role}, but it is {times}; the columns are {_shown(names)}")
    return found[0]


def _has_times(place: Mapping[Role, int]) -> bool:
    return Role.INSTANT in place or (Role.START in place and (Role.END in place or Role.DURATION in place))


def _find_ids(keys: Sequence[str], names: Sequence[str], *, has_times: bool) -> dict[Role, int]:
    for pairs in (_PAIRS_OF_NODES, _PAIRS_WITH_PLACES):
        there = {pair for pair in pairs if pair[0] in keys and pair[1] in keys}
        if len(there) > 1:
            several = " and ".join(sorted(f"{one}, {other}" for one, other in there))
            raise UnknownColumnsError(f"ids may be {several}; say which: --columns id1=…,id2=…")
        for one, other in there:
            if keys.count(one) == keys.count(other) == 1:
                return {Role.ID1: keys.index(one), Role.ID2: keys.index(other)}
    lacks = "id1, id2" if has_times or _may_be_times(keys) else "t_start_s, t_end_s, id1, id2"
    raise UnknownColumnsError(_lacks(names, lacks))


def _may_be_times(keys: Sequence[str]) -> bool:
    return any(key in known for known in NAMES_OF_TIMES.values() for key in keys)


def _find_times(keys: Sequence[str], names: Sequence[str]) -> dict[Role, int]:
    found = {role: [index for index, key in enumerate(keys) if key in known] for role, known in NAMES_OF_TIMES.items()}
    for wanted in ((Role.START, Role.END), (Role.START, Role.DURATION), (Role.INSTANT, Role.DURATION), (Role.INSTANT,)):
        if all(found[role] for role in wanted):
            for role in wanted:
                if len(found[role]) > 1:
                    several = ", ".join(names[index] for index in found[role])
                    raise UnknownColumnsError(f"{role} may be {several}; say which: --columns {role}=…")
            place = {role: found[role][0] for role in wanted}
            # A begin with a duration is an instant with one.
            return {Role.INSTANT if role is Role.START and Role.DURATION in wanted else role: index for role, index in place.items()}
    raise UnknownColumnsError(_lacks(names, "t_start_s, t_end_s"))


def _lacks(names: Sequence[str], lacking: str) -> str:
    return (
        f"the header {_shown(names)} lacks {lacking}, or other names that are known (docs/your-own-data.md); say which columns they are: "
        "--columns t_start=…,t_end=…,id1=…,id2=…, or t=… for instants; without a header their numbers: --columns t=1,id1=2,id2=3"
    )


def _shown(names: Sequence[str]) -> str:
    text = ",".join(names)
    return repr(text if len(text) <= _SHOWN_NAMES else text[: _SHOWN_NAMES - 3] + "...")


def _key(name: str) -> str:
    words = _words(name)
    return "".join(words[:-1] if len(words) > 1 and words[-1] in _UNITS else words)


def _words(name: str) -> list[str]:
    """Split ``contactStartTime``, ``t_start_s`` and ``duration [min]`` into words of lower case."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return re.findall(r"[^\W_]+", spaced.casefold())
