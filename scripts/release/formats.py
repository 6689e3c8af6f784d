"""Read files that a base station leaves behind, each as plain facts: of what ``make formats`` froze, later versions must tell the same."""

import hashlib
import json
import lzma
import shutil
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import EncounterRecord
from gateway.journal_file import JournalReader, open_journal_file
from gateway.recordings.recording_file import Damage, read_header, read_records
from gateway.transports.recording import LineRecord
from mapper.access import read_tokens
from mapper.map_file import read_map_file
from mapper.store import Store
from scripts.release.version import ROOT
from simulator.recording import load_recording

FROZEN = ROOT / "tests" / "data" / "formats"
"""A folder for each released version; ``before-...`` holds the files of schemas that were never released."""
_PAGE = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """How many things a file holds, and the SHA-256 of all of them in order, as JSON."""

    count: int
    sha256: str

    @classmethod
    def of(cls, rows: Iterable[object]) -> "Told":
        """Sum up rows of plain values."""
        listed = list(rows)
        return cls(count=len(listed), sha256=hashlib.sha256(json.dumps(listed).encode()).hexdigest())


def unpack_frozen(path: Path, folder: Path) -> Path:
    """Unpack a frozen file (``.xz``) into a folder, so that a program may write to it, and return its path."""
    target = folder / path.name.removesuffix(".xz")
    with lzma.open(path, "rb") as packed, target.open("wb") as plain:
        shutil.copyfileobj(packed, plain)
    return target


def tell_journal(path: Path) -> Told:
    """Open a journal as a gateway does, which brings an older one up to date, and tell the encounters that count."""
    open_journal_file(path, now_wall_ns=10**18, now_ns=0, machine_boot="").close()
    with closing(JournalReader(path)) as reader:
        return Told.of(_plain(reader.read_encounters(from_wall_ns=0, to_wall_ns=2**62)))


def tell_store(path: Path) -> Told:
    """Open a store as a mapper does, which brings an older one up to date, and tell the encounters that count."""
    with closing(Store(path)) as store:
        records, after, has_more = list[EncounterRecord](), 0, True
        while has_more:
            page = store.encounters(after=after, limit=_PAGE)
            records += page.records
            after, has_more = page.cursor, page.has_more
    return Told.of(_plain(records))


def tell_recording(path: Path) -> Told:
    """Tell the records of a recording of a line to a dongle, damage too."""
    with path.open("rb") as stream:
        read_header(stream, name=path.name)
        return Told.of(_plain_line(record) for record in read_records(stream))


def tell_run(path: Path) -> Told:
    """Tell the encounters and ways of a simulated run's folder, as ``biobot-sim replay`` reads them."""
    recording = load_recording(path)
    encounters = [[one.t_start_s, one.t_end_s, one.id1, one.id2] for one in recording.encounters]
    spells = [[one.t_start_s, one.t_end_s, one.id, one.mode.value, one.cause.value] for one in recording.spells]
    return Told.of([list(recording.ids), *encounters, *spells])


def tell_tokens(path: Path) -> Told:
    """Tell who may command, by the file of tokens."""
    path.chmod(0o600)
    return Told.of([record.name, record.role.value] for record in read_tokens(path) or ())


def tell_map(path: Path) -> Told:
    """Tell the components of a saved map, as ``biobot-mapper merge`` reads them."""
    found = read_map_file(path)
    return Told.of([component.points.tolist(), component.distances.tolist()] for component in found.components)


def _plain_line(record: LineRecord | Damage) -> list[int | str]:
    if isinstance(record, Damage):
        return [record.offset, record.n_bytes]
    return [record.kind.value, record.monotonic_ns, record.wall_ns, record.data.hex()]


def _plain(records: Iterable[EncounterRecord]) -> list[list[int]]:
    """Return the newest revision of each encounter, without those that turned out to be parts of others, in order."""
    newest: dict[tuple[int, int], EncounterRecord] = {}
    for record in sorted(records, key=lambda one: one.revision):
        newest[record.boot, record.sequence] = record
    return sorted(
        [one.boot, one.sequence, one.revision, one.node_a, one.node_b, one.t_start_ns, one.t_end_ns, one.error_ns]
        for one in newest.values()
        if not one.is_void
    )
