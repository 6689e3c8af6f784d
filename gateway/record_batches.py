"""Records of the journal on their way out: publications of what was committed, and answers from the history. Nothing is encoded twice."""

from collections.abc import Callable, Iterator

import msgspec

from firmware_protocol.contract.keys import Stream
from firmware_protocol.contract.records import EncodedBatch, EncounterRecord, HistoryRequest, MissionRecord, ModeRecord
from gateway.journal_file import Committed, Damage, JournalReader

MAX_BATCH = 500
"""Records of one publication, or of one reply of the history: 165 kB."""

_STREAMS: dict[type, Stream] = {EncounterRecord: Stream.ENCOUNTERS, ModeRecord: Stream.MODES, MissionRecord: Stream.MISSION}


def batches_of(committed: Committed, *, gateway: str) -> Iterator[tuple[Stream, EncodedBatch]]:
    """Yield what was committed as batches of one kind each, and the stream of each."""
    kinds = list(map(type, committed.records))
    for kind in dict.fromkeys(kinds):
        members = [body for of, body in zip(kinds, committed.bodies, strict=True) if of is kind]
        for at in range(0, len(members), MAX_BATCH):
            yield (
                _STREAMS[kind],
                EncodedBatch(
                    gateway=gateway,
                    journal=committed.records[0].journal,
                    head_offset=committed.head_offset,
                    oldest_offset=committed.oldest_offset,
                    records=tuple(map(msgspec.Raw, members[at : at + MAX_BATCH])),
                ),
            )


def history_batches(
    request: HistoryRequest,
    *,
    open_reader: Callable[[], JournalReader],
    gateway: str,
    journal: str,
    on_damage: Callable[[Damage], None],
) -> Iterator[EncodedBatch]:
    """Yield at least one batch: an empty one tells how far the journal goes.

    Records that are damaged are told to ``on_damage``, and those behind them follow.

    Raises
    ------
    sqlite3.Error
        The journal cannot be read.
    """
    reader = open_reader()
    try:
        at, rest = request.from_offset, request.limit
        while rest > 0:
            page = reader.read_page(from_offset=at, limit=min(rest, MAX_BATCH))
            for damage in page.damage:
                on_damage(damage)
            yield EncodedBatch(
                gateway=gateway,
                journal=journal,
                head_offset=page.head_offset,
                oldest_offset=page.oldest_offset,
                records=tuple(map(msgspec.Raw, page.bodies)),
            )
            at, rest = page.next_offset, rest - len(page.bodies)
            if at == page.first_offset or at > page.head_offset:
                return
    finally:
        reader.close()
