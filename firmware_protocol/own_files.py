"""Files that biobot's own programs write, known by their first bytes, so that whoever is given the wrong one says which it is.

Pure: the caller reads the bytes. Of what somebody has edited or compressed nothing is known.
"""

from dataclasses import dataclass
from typing import Final

HEAD_BYTES: Final = 512
"""So many bytes from the front of a file are enough."""

JOURNAL_ID: Final = 0x42494F47
STORE_ID: Final = 0x42494F42
"""The ids that the programs give to their databases (``PRAGMA application_id``)."""

_SQLITE: Final = b"SQLite format 3\0"
_ID_AT: Final = 68  # https://www.sqlite.org/fileformat.html, 1.3.14


@dataclass(frozen=True, slots=True)
class OwnFile:
    """What a file is, and what it is for: both to be put into a sentence. ``is_table``: rows of columns that many programs read."""

    what: str
    use: str
    is_table: bool = False


JOURNAL: Final = OwnFile("a gateway's journal", "`biobot-gateway journal` and `biobot-gateway audit` read it, `run --journal` writes it")
STORE: Final = OwnFile("a mapper's store", "`biobot-mapper serve --store` opens it")
RECORDING: Final = OwnFile("a recording of a line", "`biobot-gateway replay` and `biobot-gateway pcap` read it")
CAPTURE: Final = OwnFile("a capture for Wireshark", "`wireshark` opens it")
MAP: Final = OwnFile("a map", "`biobot-mapper merge` and `biobot-mapper route` read it")
GEOJSON: Final = OwnFile("a drawing in GeoJSON", "`biobot-sim --arena` takes an arena's, and programs for maps open a map's")
TOKENS: Final = OwnFile("a file of tokens", "`biobot-mapper tokens list --tokens` reads it")
RUN: Final = OwnFile("the description of a simulated run", "`biobot-sim render` takes the folder that it is in")
PEM: Final = OwnFile("a certificate or a key", "it stands under [tls] of a configuration (`biobot-gateway certs issue`)")
ROSTER: Final = OwnFile("a roster", "`biobot-gateway router --roster` heeds it")
CONFIGURATION: Final = OwnFile("a configuration", "it is given with --config")
ENCOUNTERS: Final = OwnFile("a table of encounters", "`biobot-mapper run` makes a map of it", is_table=True)
MODES: Final = OwnFile("a table of modes", "it is for `biobot-mapper run ENCOUNTERS --modes`", is_table=True)
JOURNAL_TABLE: Final = OwnFile("a table that was exported from a journal", "`biobot-gateway journal export` wrote it", is_table=True)
AUDIT_TABLE: Final = OwnFile("an audit log that was exported", "`biobot-gateway audit verify` wants the journal itself", is_table=True)

_BEGINNINGS: Final = (
    (b"BIOBREC", RECORDING),
    (b"\x0a\x0d\x0d\x0a", CAPTURE),  # the section header of a pcapng
    (b"-----BEGIN ", PEM),
    (b"# Whom a router heeds", ROSTER),
    (b"# Configuration of biobot-", CONFIGURATION),
    (b'{"betti_numbers"', MAP),
    (b'{"type":"FeatureCollection"', GEOJSON),
    (b'{"format":1,"tokens":', TOKENS),
    (b'{"format":1,"program":"biobot-sim', RUN),
    (b"t_start_s,t_end_s,id1,id2", ENCOUNTERS),
    (b"t_start_s,t_end_s,id,mode", MODES),
    (b"gateway,journal,offset,boot,", JOURNAL_TABLE),
    (b"node,boot,number,received_wall_ns,", JOURNAL_TABLE),
    (b"id,time,kind,operator,", AUDIT_TABLE),
    (b'{"id":1,"time":', AUDIT_TABLE),
)


def tell_own_file(head: bytes) -> OwnFile | None:
    """Return what a file is by its first ``HEAD_BYTES`` bytes, or None: none of ours, as far as they tell.

    A database that is so young that its id is not in its first page yet is not known.
    """
    if head.startswith(_SQLITE):
        return {JOURNAL_ID: JOURNAL, STORE_ID: STORE}.get(int.from_bytes(head[_ID_AT : _ID_AT + 4], "big"))
    # JSON has blanks as its writer likes them.
    packed = b"".join(head.split()) if head.startswith(b"{") else head
    return next((own for beginning, own in _BEGINNINGS if packed.startswith(beginning)), None)
