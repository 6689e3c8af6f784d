"""What the backpacks said they had met: kept apart from the truth, so that a base station's records can be checked against it."""

import csv
import io
from dataclasses import dataclass, field

from firmware_protocol.messages import EncounterBatch
from firmware_protocol.units import BootId, NodeId
from simulator.clock import BackpackClock

HEADER = ("node", "boot", "sequence", "peer", "t_start_s", "t_end_s", "is_ongoing", "is_acknowledged")


@dataclass(slots=True, kw_only=True)
class ReportLog:
    """Every encounter report that a backpack handed to its radio, and whether the base station has confirmed it."""

    _rows: list[tuple[int, int, int, int, int, int, bool]] = field(default_factory=list)
    _pending: dict[tuple[int, int], range] = field(default_factory=dict)
    _acknowledged: set[int] = field(default_factory=set)

    @property
    def n_reports(self) -> int:
        """Reports so far."""
        return len(self._rows)

    @property
    def n_unacknowledged(self) -> int:
        """Reports that the base station has not confirmed."""
        return len(self._rows) - len(self._acknowledged)

    def add(self, batch: EncounterBatch, *, node: NodeId, boot: BootId, sequence: int, clock: BackpackClock) -> None:
        """Note a batch that goes on the air for the first time."""
        first = len(self._rows)
        for entry in batch.entries:
            start_ns = clock.elapsed_ns(entry.start_ms)
            end_ns = clock.elapsed_ns(entry.start_ms + entry.duration_ms)
            self._rows.append((node, boot, sequence, entry.peer, start_ns, end_ns, entry.is_ongoing))
        self._pending[node, sequence] = range(first, len(self._rows))

    def acknowledge(self, *, node: NodeId, sequence: int) -> None:
        """Note that the base station has the batch that ``node`` sent under this number."""
        self._acknowledged.update(self._pending.pop((node, sequence)))

    def to_csv(self) -> bytes:
        """Return ``reported.csv``: times in seconds of the run, to the microsecond; flags as 0 and 1."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(HEADER)
        for index, (node, boot, sequence, peer, start_ns, end_ns, is_ongoing) in enumerate(self._rows):
            times = (f"{start_ns / 1e9:.6f}", f"{end_ns / 1e9:.6f}")
            writer.writerow((node, boot, sequence, peer, *times, int(is_ongoing), int(index in self._acknowledged)))
        return text.getvalue().encode()
