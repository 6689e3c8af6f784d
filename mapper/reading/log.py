"""A proximity log from a file, text or Parquet, packed or not, of any order: encounters, names of ids, and what was met on the way."""

import gzip
import io
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from firmware_protocol.units import NS_PER_S
from mapper.encounter_csv import MAX_FILE_BYTES, check_text, read_bytes
from mapper.errors import InputFileError
from mapper.reading.contacts import TICKS_OF_A_GAP, Contacts, Tick, find_tick, join_contacts
from mapper.reading.node_names import NodeNames, number_nodes
from mapper.reading.options import ReadingOptions, Role
from mapper.reading.parquet_table import MAGIC, read_parquet_table
from mapper.reading.raw_log import RawLog
from mapper.reading.text_table import describe_layout, read_text_table
from mapper.types import EncounterTable, IntArray, KernelsKind
from mapper.window import drop_repeated, make_encounter_table

_GZIP = b"\x1f\x8b"
_MAX_SPAN_NS = 2**62 - 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProximityLog:
    """Encounters of a log.

    ``form`` says how it was read. ``places`` are the ids of what stands still by the name of its column. ``tick_ns`` is how far apart
    sightings of one contact are, 0 where the log has begins and ends. ``has_begins`` is False where it has instants. ``warnings`` are
    of rows left out or joined and of what had to be assumed.
    """

    table: EncounterTable
    names: NodeNames
    form: str
    places: tuple[int, ...] = ()
    place_column: str | None = None
    tick_ns: int = 0
    has_begins: bool = True
    has_dates: bool = False
    is_own: bool = False
    ignored_columns: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def read_log(path: Path, options: ReadingOptions | None = None, *, kernels: KernelsKind | None = None) -> ProximityLog:
    """Read a file of encounters or sightings; the name ``-`` is standard input.

    Parameters
    ----------
    kernels
        Whether the compiled library reads plain files; None takes it where it is. The log is the same.

    Raises
    ------
    InputFileError
        The file cannot be read or understood, or has bad rows; up to ten are listed with line and reason, and the rest counted.
    EngineMissingError
        It is Parquet, and pyarrow is not installed.
    ConfigurationError, KernelsError
        As for `mapper.kernels.choose_kernels`.
    """
    options = options or ReadingOptions()
    data = read_bytes(path)
    if data.startswith(_GZIP):
        data = _unpack(path, data)
    if data.startswith(MAGIC):
        raw = read_parquet_table(str(path), data, options)
    else:
        check_text(path, data)
        raw = read_text_table(str(path), data, options, kernels=kernels)
    del data
    return _make_log(path, raw, options)


def _unpack(path: Path, data: bytes) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            unpacked = file.read(MAX_FILE_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputFileError(path=str(path), faults=[f"cannot be unpacked: {str(error).lower()}; pack it again with gzip"]) from error
    if len(unpacked) > MAX_FILE_BYTES:
        raise InputFileError(path=str(path), faults=[f"is longer than {MAX_FILE_BYTES} bytes when unpacked; split it by time"])
    return unpacked


def _make_log(path: Path, raw: RawLog, options: ReadingOptions) -> ProximityLog:
    raw, names, n_nobody = _number(path, raw)
    has_begins = Role.START in raw.layout.place or Role.DURATION in raw.layout.place
    tick = Tick(tick_ns=0, is_clear=True) if has_begins else find_tick(raw.start_ns, raw.code1, raw.code2)
    gap_ns = options.gap_ns if options.gap_ns is not None else round(TICKS_OF_A_GAP * tick.tick_ns)
    if len(raw.start_ns) and int(raw.end_ns.max()) - int(raw.start_ns.min()) > _MAX_SPAN_NS:
        raise InputFileError(path=str(path), faults=["its times span more than 146 years; are two clocks mixed?"])
    if raw.layout.is_own and options.gap_ns is None:  # taken as it stands
        contacts = Contacts(start_ns=raw.start_ns, end_ns=raw.end_ns, id1=raw.code1, id2=raw.code2, n_repeated=0, n_joined=0)
    else:
        contacts = join_contacts(raw.start_ns, raw.end_ns, raw.code1, raw.code2, gap_ns=gap_ns)
    made = make_encounter_table(t_start_ns=contacts.start_ns, t_end_ns=contacts.end_ns, id1=contacts.id1, id2=contacts.id2)
    table, n_repeated = drop_repeated(made)  # joined contacts have none
    places: IntArray = np.unique(raw.code2) if raw.layout.is_place else np.zeros(0, dtype=np.int64)
    form = f"{raw.kind}: {describe_layout(raw.layout)}" + "".join(f"; {note}" for note in raw.notes)
    if not has_begins:
        form += f"; sightings of a pair no more than {_seconds(gap_ns)} apart are one contact"
    warnings = [
        *_warn_of_rows(raw, contacts, n_nobody=n_nobody, n_repeated=n_repeated + contacts.n_repeated, has_begins=has_begins),
        *([] if tick.is_clear or options.gap_ns is not None else [_warn_of_tick(tick, gap_ns)]),
        *_warn_of_names(names),
    ]
    return ProximityLog(
        table=table,
        names=names,
        form=form,
        places=tuple(places.tolist()),
        place_column=raw.layout.name[Role.ID2] if raw.layout.is_place else None,
        tick_ns=tick.tick_ns,
        has_begins=has_begins,
        has_dates=any(note.startswith("dates") for note in raw.notes),
        is_own=raw.layout.is_own,
        ignored_columns=raw.layout.ignored,
        warnings=tuple(warnings),
    )


def _number(path: Path, raw: RawLog) -> tuple[RawLog, NodeNames, int]:
    """Put numbers in place of the codes of ids; rows of nobody go, and are counted."""
    if raw.texts1 is None or raw.texts2 is None:
        return raw, NodeNames(), 0
    if raw.layout.is_place:
        n_codes = max(raw.texts1, default=-1) + 1
        column = raw.layout.name[Role.ID2]
        is_shared = not set(raw.texts1.values()).isdisjoint(raw.texts2.values())
        # One number for a tag and a reader means two things.
        texts = {**raw.texts1, **{n_codes + code: f"{column}:{text}" if is_shared else text for code, text in raw.texts2.items()}}
        code2 = raw.code2 + n_codes
    else:
        texts, code2 = dict(raw.texts1), raw.code2
    numbers, names = number_nodes(texts)
    id1, id2 = numbers[raw.code1], numbers[code2]
    is_somebody = (id1 >= 0) & (id2 >= 0)
    n_nobody = int(np.count_nonzero(~is_somebody))
    if n_nobody and raw.layout.is_own:
        reason = f"{n_nobody} rows have an id below 0; wanted whole numbers from 0 to 2^63-1, or names"
        raise InputFileError(path=str(path), faults=[reason])
    selves = is_somebody & (id1 == id2)
    if selves.any():  # such as 7 and 07
        raw = replace(raw, n_selves=raw.n_selves + int(np.count_nonzero(selves)))
        is_somebody &= ~selves
    kept = slice(None) if is_somebody.all() else is_somebody
    return replace(raw, start_ns=raw.start_ns[kept], end_ns=raw.end_ns[kept], code1=id1[kept], code2=id2[kept]), names, n_nobody


def _warn_of_rows(raw: RawLog, contacts: Contacts, *, n_nobody: int, n_repeated: int, has_begins: bool) -> list[str]:
    warnings = []
    if n_nobody:
        warnings.append(f"{n_nobody} rows with an id below 0 are left out: such ids stand for nobody, or for a device that takes no part")
    if raw.n_selves:
        at = "" if raw.self_line is None else f", the first in line {raw.self_line}"
        are = "1 row is of an id with itself" if raw.n_selves == 1 else f"{raw.n_selves} rows are of an id with itself"
        warnings.append(f"{are}{at}; left out")
    if raw.lacks_zone:
        warnings.append(
            "dates have no time zone and are taken as UTC; where a clock was put forward or back, an hour is missing or twice there"
        )
    n_joined = contacts.n_joined - contacts.n_repeated
    if n_repeated and has_begins:
        repeat = "1 row repeats" if n_repeated == 1 else f"{n_repeated} rows repeat"
        warnings.append(f"{repeat} another one of the same pair and times; each counts once")
    if n_joined and has_begins:
        warnings.append(f"{n_joined} rows overlap or touch another one of the same pair; each such group is one contact")
    return warnings


def _warn_of_tick(tick: Tick, gap_ns: int) -> str:
    if not tick.tick_ns:
        return (
            "no pair was seen twice, so it cannot be told how far apart sightings of one contact are; every row is a contact of no length"
        )
    return (
        f"sightings of a pair have no clear beat, so it is a guess that those within {_seconds(gap_ns)} are one contact; "
        "say it with --gap-s"
    )


def _warn_of_names(names: NodeNames) -> list[str]:
    if not names.alike:
        return []
    groups = "; ".join(" and ".join(map(repr, group)) for group in names.alike[:3])
    return [f"ids differ only in case, blanks or zeros and count as different: {groups}" + ("; …" if len(names.alike) > 3 else "")]


def _seconds(time_ns: int) -> str:
    return f"{time_ns / NS_PER_S:g} s"
