"""A long life of 150 biobots, as records of a gateway: what `studies.bench_live` puts into a store, and what it publishes on top."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.contract.records import Cause, EncounterRecord, EncounterSide, Mode, ModeRecord, RecordBatch
from firmware_protocol.units import BootId, Nanoseconds, NodeId, RssiDbm
from mapper.store import Store
from simulator.arenas.scenarios import find_scenario
from simulator.presets import find_preset
from simulator.world import World

N_BIOBOTS: Final = 150
N_LANDMARKS: Final = 20
_LANDMARKS: Final = range(1, N_LANDMARKS + 1)
_STRIDE_S: Final = 5_000.0
_NS_PER_S: Final = 1_000_000_000
_BATCH: Final = 5_000
_BOOT: Final = BootId(1)
_RSSI: Final = RssiDbm(-60)
_CLOCK_ERROR: Final = Nanoseconds(2_000_000)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Life:
    """Encounters in the order in which they ended; arrays of shape (k,), times in nanoseconds since the landmarks stood still."""

    id1: NDArray[np.int64]
    id2: NDArray[np.int64]
    t_start_ns: NDArray[np.int64]
    t_end_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.id1)

    @classmethod
    def simulate(cls, n_encounters: int, *, seed: int) -> Self:
        """Let biobots walk between two obstacles, 20 of them standing still, until so many encounters have ended."""
        preset = find_preset("paper-units")
        arena = find_scenario("two-obstacles").build(preset.side)
        ids = range(1, N_BIOBOTS + 1)
        world = World(arena, motion=preset.motion, ranges=preset.ranges, ids=ids, seed=seed, keeps_legs=False)
        for landmark in _LANDMARKS:
            world.stop(landmark)
        parts, n_ended, until_s = [], 0, 0.0
        while n_ended < n_encounters:
            until_s += _STRIDE_S
            parts.append(world.run(until_s).ended)
            n_ended += len(parts[-1])
        start, end = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_start_s", "t_end_s"))
        order = np.argsort(end, kind="stable")[:n_encounters]
        return cls(
            id1=np.concatenate([part.id1 for part in parts])[order],
            id2=np.concatenate([part.id2 for part in parts])[order],
            t_start_ns=(start[order] * _NS_PER_S).astype(np.int64),
            t_end_ns=(end[order] * _NS_PER_S).astype(np.int64),
        )

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote."""
        with np.load(path) as file:
            return cls(**{name: file[name] for name in cls.__dataclass_fields__})

    def save(self, path: Path) -> None:
        """Write it as a numpy archive."""
        np.savez(path, **{name: getattr(self, name) for name in self.__dataclass_fields__})


def make_record(
    life: Life, row: int, *, gateway: str, journal: str, boot: BootId, offset: int, sequence: int, revision: int, anchor_ns: int
) -> EncounterRecord:
    """Make the record of one encounter, as a gateway that heard both sides does; revision 0 is of one side, and began a little later."""
    begin = Nanoseconds(int(life.t_start_ns[row]) + (0 if revision else min(1_000, int(life.t_end_ns[row] - life.t_start_ns[row]))))
    end = Nanoseconds(int(life.t_end_ns[row]))
    nodes = (NodeId(int(life.id1[row])), NodeId(int(life.id2[row])))
    heard = nodes if revision else nodes[:1]
    return EncounterRecord(
        gateway=gateway,
        journal=journal,
        offset=offset,
        boot=boot,
        sequence=sequence,
        revision=revision,
        wall_anchor_ns=Nanoseconds(anchor_ns),
        node_a=nodes[0],
        node_b=nodes[1],
        t_start_ns=begin,
        t_end_ns=end,
        error_ns=_CLOCK_ERROR,
        is_reciprocal=revision > 0,
        sides=tuple(EncounterSide(node=node, t_start_ns=begin, t_end_ns=end, rssi_dbm=_RSSI) for node in heard),
    )


def fill_store(path: Path, life: Life, *, n_encounters: int, anchor_ns: int, landmarks: Sequence[int] = _LANDMARKS) -> None:
    """Put the landmarks' modes and the first encounters of a life into a store."""
    store = Store(path)
    try:
        for records in _batches(life, n_encounters=n_encounters, anchor_ns=anchor_ns, landmarks=landmarks):
            store.apply([records])
    finally:
        store.close()


def _batches(life: Life, *, n_encounters: int, anchor_ns: int, landmarks: Sequence[int]) -> Iterator[RecordBatch]:
    gateway, journal = "past", "past"
    modes = tuple(
        ModeRecord(
            gateway=gateway,
            journal=journal,
            offset=number,
            boot=_BOOT,
            sequence=number,
            revision=0,
            wall_anchor_ns=Nanoseconds(anchor_ns),
            node=NodeId(landmark),
            mode=Mode.S,
            cause=Cause.COMMAND,
            t_start_ns=Nanoseconds(0),
            t_end_ns=None,
            error_ns=_CLOCK_ERROR,
        )
        for number, landmark in enumerate(landmarks, 1)
    )
    yield RecordBatch(gateway=gateway, journal=journal, head_offset=len(modes), records=modes)
    for first in range(0, n_encounters, _BATCH):
        rows = range(first, min(n_encounters, first + _BATCH))
        numbers = [len(modes) + 1 + row for row in rows]
        records = tuple(
            make_record(
                life, row, gateway=gateway, journal=journal, boot=_BOOT, offset=number, sequence=number, revision=1, anchor_ns=anchor_ns
            )
            for row, number in zip(rows, numbers, strict=True)
        )
        yield RecordBatch(gateway=gateway, journal=journal, head_offset=numbers[-1], records=records)
