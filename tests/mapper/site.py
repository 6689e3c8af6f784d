"""A site of several gateways: what each records of the same encounters, by clocks that are right or wrong."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from firmware_protocol.contract.records import EncounterRecord, JournalRecord, RecordBatch
from firmware_protocol.units import Nanoseconds, NodeId
from mapper.store import Store
from tests.mapper.fake_gateway import ANCHOR_NS, BOOT, S, batch


@dataclass(frozen=True, kw_only=True)
class Meeting:
    """What happened: begin and end [ns of the right clock, less the anchor], and whom it was between."""

    nodes: tuple[int, int]
    begin_ns: int
    end_ns: int


def meetings(n: int, *, seed: int, n_biobots: int = 12, span_s: float = 7200.0, n_pairs: int | None = None) -> list[Meeting]:
    """Draw encounters of a few seconds; of one pair none within 10 s of another."""
    rng = np.random.default_rng(seed)
    pairs = [(low, high) for low in range(1, n_biobots + 1) for high in range(low + 1, n_biobots + 1)][:n_pairs]
    last = dict.fromkeys(pairs, -10.0)
    drawn = []
    for at in np.sort(rng.uniform(0, span_s, n)).tolist():
        pair = pairs[int(rng.integers(len(pairs)))]
        length = float(rng.uniform(0.5, 8))
        if at - last[pair] >= 10:
            last[pair] = at + length
            drawn.append(Meeting(nodes=pair, begin_ns=round(at * S), end_ns=round((at + length) * S)))
    return drawn


def heard(
    what: Iterable[Meeting],
    *,
    gateway: str,
    ahead_s: float = 0.0,
    drift: float = 0.0,
    jitter_s: float = 0.0,
    seed: int = 0,
    margin_ns: int = 0,
    first: int = 1,
) -> list[EncounterRecord]:
    """Record encounters as a gateway does whose wall clock is ahead by so much, drifts so, and dates ends so badly."""
    rng = np.random.default_rng(seed)
    records = []
    for offset, one in enumerate(what, first):
        late = np.rint(rng.uniform(-jitter_s, jitter_s, 2) * S).astype(int).tolist()
        begin, end = (t + round(drift * t) + more for t, more in zip((one.begin_ns, one.end_ns), late, strict=True))
        records.append(
            EncounterRecord(
                gateway=gateway,
                journal=f"journal of {gateway}",
                offset=offset,
                boot=BOOT,
                sequence=offset,
                revision=0,
                wall_anchor_ns=Nanoseconds(ANCHOR_NS + round(ahead_s * S)),
                node_a=NodeId(one.nodes[0]),
                node_b=NodeId(one.nodes[1]),
                t_start_ns=Nanoseconds(begin),
                t_end_ns=Nanoseconds(max(begin, end)),
                error_ns=Nanoseconds(2_000_000),
                is_reciprocal=False,
                margin_ns=margin_ns,
            )
        )
    return records


def batches(records: Sequence[JournalRecord]) -> list[RecordBatch]:
    """Put records of several gateways into batches, in their order."""
    made: list[RecordBatch] = []
    for record in records:
        if made and made[-1].gateway == record.gateway:
            made[-1] = batch([*made[-1].records, record], gateway=record.gateway, journal=record.journal)
        else:
            made.append(batch([record], gateway=record.gateway, journal=record.journal))
    return made


def encounters_of(store: Store) -> list[tuple[int, int, int, int]]:
    """Return what a map would be made of: begin and end [ns, less the anchor] and ids."""
    rows = store.delta(after=0).encounters
    columns = (rows.t_start_ns - ANCHOR_NS, rows.t_end_ns - ANCHOR_NS, np.minimum(rows.id1, rows.id2), np.maximum(rows.id1, rows.id2))
    return sorted(zip(*(column[rows.counts].tolist() for column in columns), strict=True))


def offsets_s(store: Store) -> Mapping[str, float | None]:
    """Return what each gateway's newest start is to be set by [s]."""
    return {clock.source.gateway: None if clock.offset_ns is None else clock.offset_ns / S for clock in store.clocks}
