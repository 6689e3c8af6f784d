"""Recordings heard once more: as the records they were, at full speed or at life's."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gateway.errors import RecordingError
from gateway.recordings.line_offer import Offer, OfferSpec, offered
from gateway.recordings.recording_file import Damage, RecordingHeader, read_header, read_records
from gateway.transports.recording import LineRecord, RecordKind

_NS_PER_S = 1_000_000_000


@dataclass(slots=True, kw_only=True)
class Recording:
    """An open recording; ``records`` is one pass over it, and tells damage in ``damages``."""

    header: RecordingHeader
    records: Iterator[LineRecord]
    damages: list[Damage] = field(default_factory=list)
    """At most ``MAX_DAMAGES`` of them are kept; ``n_damages`` counts all."""
    n_damages: int = 0


MAX_DAMAGES = 20


@contextlib.contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a recording for one pass.

    Raises
    ------
    RecordingError
        It cannot be read, or is no recording.
    """
    try:
        stream = path.open("rb")
    except OSError as error:
        raise RecordingError(path=str(path), reason=f"cannot be read: {error.strerror}") from error
    with stream:
        header = read_header(stream, name=str(path))
        recording = Recording(header=header, records=iter(()))

        def sound() -> Iterator[LineRecord]:
            for one in read_records(stream):
                if isinstance(one, Damage):
                    recording.n_damages += 1
                    if len(recording.damages) < MAX_DAMAGES:
                        recording.damages.append(one)
                else:
                    yield one

        recording.records = sound()
        yield recording


def paced(records: Iterator[LineRecord], *, speed: float) -> Iterator[LineRecord]:
    """Yield records at ``speed`` times the pace at which they were made; sleeps in between."""
    first_ns: int | None = None
    begun_ns = time.monotonic_ns()
    for record in records:
        first_ns = record.monotonic_ns if first_ns is None else first_ns
        wait_s = (record.monotonic_ns - first_ns) / speed / _NS_PER_S - (time.monotonic_ns() - begun_ns) / _NS_PER_S
        if wait_s > 0:
            time.sleep(wait_s)
        yield record


async def offer_recording(recording: Recording, spec: OfferSpec, *, speed: float, on_ready: Callable[[str], None]) -> int:
    """Offer what the dongle said on a line, once somebody opens it; returns how many bytes were heard when the reader has gone.

    Parameters
    ----------
    on_ready
        Is told what to open.

    Raises
    ------
    TransportOpenError
        The line cannot be made.
    """
    async with offered(spec) as (line, address):
        on_ready(address)
        await line.wait_for_reader()
        n_bytes = await _speak(recording.records, line, speed=speed)
        await line.wait_for_end()
        return n_bytes


async def _speak(records: Iterator[LineRecord], line: Offer, *, speed: float) -> int:
    n_bytes = 0
    first_ns: int | None = None
    begun_ns = time.monotonic_ns()
    for record in records:
        first_ns = record.monotonic_ns if first_ns is None else first_ns
        if record.kind is RecordKind.BYTES_IN:
            wait_s = (record.monotonic_ns - first_ns) / speed / _NS_PER_S - (time.monotonic_ns() - begun_ns) / _NS_PER_S
            await asyncio.sleep(max(0.0, wait_s))
            if not await line.write(record.data):
                break
            n_bytes += len(record.data)
    return n_bytes
