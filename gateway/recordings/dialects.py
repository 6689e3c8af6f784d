"""Every dialect whose lines can be looked at, by the name that port specifications use."""

from gateway.errors import RecordingError
from gateway.recordings.dissection import Dialect, LineDissector
from gateway.recordings.native_line import NATIVE

_DIALECTS: dict[str, Dialect] = {"native": NATIVE}


def make_line_dissector(dialect: str, *, path: str) -> LineDissector:
    """Return a dissector of a line of this dialect.

    Raises
    ------
    RecordingError
        There is no such dialect; ``path`` is named in the message.
    """
    found = _DIALECTS.get(dialect)
    if found is None:
        raise RecordingError(
            path=path, reason=f"has the dialect {dialect!r}, which is none of {', '.join(_DIALECTS)}; name it by --dialect"
        )
    return LineDissector(found)
