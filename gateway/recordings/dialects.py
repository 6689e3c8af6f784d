"""Every dialect whose lines can be looked at, by the name that port specifications use."""

from firmware_protocol.dialects.choice import CAN_DIALECTS
from gateway.errors import RecordingError
from gateway.recordings.can_line import can_dialect
from gateway.recordings.dissection import Dialect, LineDissector
from gateway.recordings.native_line import NATIVE
from gateway.recordings.xbee_line import XBEE
from gateway.recordings.znp_line import ZNP

_DIALECTS: dict[str, Dialect] = {"native": NATIVE, "xbee": XBEE, "znp": ZNP}


def make_line_dissector(dialect: str, *, path: str) -> LineDissector:
    """Return a dissector of a line of this dialect; ``can:7`` is unit 7 of a bus, ``can`` all units.

    Raises
    ------
    RecordingError
        There is no such dialect; ``path`` is named in the message.
    """
    name, _, unit = dialect.partition(":")
    if name in CAN_DIALECTS and (not unit or unit.isdecimal()):
        return LineDissector(can_dialect(int(unit) if unit else None))
    found = _DIALECTS.get(dialect)
    if found is None:
        known = ", ".join((*_DIALECTS, *CAN_DIALECTS))
        raise RecordingError(path=path, reason=f"has the dialect {dialect!r}, which is none of {known}; name it by --dialect")
    return LineDissector(found)
