"""Errors of the ground: what our own caller got wrong.

What arrives from the air, a cable or the bus never raises past a decoder; it becomes a fault value instead.

    ProtocolError
    ├── EncodeError           a value does not fit its field on the wire
    ├── LinkFullError         a link's queue is full: wait for confirmations, then send again
    ├── RecordError           bytes on the bus are not the record they should be
    ├── KeyExpressionError    a name cannot be a part of a key expression
    ├── LandmarkCountError    more landmarks are wanted than there are candidates
    └── ConfigurationError    a configuration has one or more faults
"""

from collections.abc import Sequence


class ProtocolError(Exception):
    """Root of every error the ground raises."""


class EncodeError(ProtocolError):
    """A value does not fit the field that WIRE_FORMAT.md gives it."""

    def __init__(self, *, field: str, value: object, limit: str) -> None:
        super().__init__(f"{field} is {value!r}, but the wire format allows {limit}")
        self.field = field
        self.value = value
        self.limit = limit


class LinkFullError(ProtocolError):
    """A link holds as many unconfirmed payloads as it may."""

    def __init__(self, *, limit: int) -> None:
        super().__init__(f"the link's queue holds {limit} payloads, its limit; send again when one is confirmed")
        self.limit = limit


class RecordError(ProtocolError):
    """Bytes from the bus are not a record of the expected type."""

    def __init__(self, *, record: str, reason: str) -> None:
        super().__init__(f"not a valid {record}: {reason}")
        self.record = record
        self.reason = reason


class KeyExpressionError(ProtocolError):
    """A name cannot stand in a key expression, or a key is not one of ours."""

    def __init__(self, *, key: str, reason: str) -> None:
        super().__init__(f"{key!r}: {reason}")
        self.key = key
        self.reason = reason


class LandmarkCountError(ProtocolError):
    """So many landmarks cannot be picked from these candidates."""

    def __init__(self, *, count: int, candidates: int) -> None:
        super().__init__(f"{count} landmarks wanted from {candidates} candidates; ask for 0 to {candidates}")
        self.count = count
        self.candidates = candidates


class ConfigurationError(ProtocolError):
    """A configuration has faults; all of them are in ``problems``, one line each."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("; ".join(problems))
        self.problems = tuple(problems)
