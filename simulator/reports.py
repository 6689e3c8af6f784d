"""What the backpacks said they had met: kept apart from the truth, so that a base station's records can be checked against it."""

import csv
import io
from dataclasses import dataclass, field

from firmware_protocol.messages import EncounterBatch, EncounterBatchWithPaths
from firmware_protocol.units import BootId, NodeId
from simulator.clock import BackpackClock

HEADER = ("node", "boot", "sequence", "peer", "t_start_s", "t_end_s", "is_ongoing", "is_acknowledged", "start_ms", "end_ms")


@dataclass(slots=True, kw_only=True)
class ReportLog:
    """Every encounter report that a backpack handed to its radio, and whether the base station has confirmed it.

    Without ``keeps_rows`` they are only counted, so that a run without end does not fill the memory.
    """

    keeps_rows: bool = True
    n_reports: int = 0
    """Reports so far."""
    _n_acknowledged: int = 0
    _rows: list[tuple[int, int, int, int, int, int, bool, int, int]] = field(default_factory=list)
    _pending: dict[tuple[int, int], range] = field(default_factory=dict)
    _acknowledged: set[int] = field(default_factory=set)

    @property
    def n_unacknowledged(self) -> int:
        """Reports that the base station has not confirmed."""
        return self.n_reports - self._n_acknowledged

    def add(
        self, batch: EncounterBatch | EncounterBatchWithPaths, *, node: NodeId, boot: BootId, sequence: int, clock: BackpackClock
    ) -> None:
        """Note a batch that goes on the air for the first time."""
        first = self.n_reports
        self.n_reports += len(batch.entries)
        self._pending[node, sequence] = range(first, self.n_reports)
        if not self.keeps_rows:
            return
        for entry in batch.entries:
            end_ms = entry.start_ms + entry.duration_ms
            start_ns, end_ns = clock.elapsed_ns(entry.start_ms), clock.elapsed_ns(end_ms)
            self._rows.append((node, boot, sequence, entry.peer, start_ns, end_ns, entry.is_ongoing, entry.start_ms, end_ms))

    def acknowledge(self, *, node: NodeId, sequence: int) -> None:
        """Note that the base station has the batch that ``node`` sent under this number."""
        done = self._pending.pop((node, sequence))
        self._n_acknowledged += len(done)
        if self.keeps_rows:
            self._acknowledged.update(done)

    def to_csv(self) -> bytes:
        """Return ``reported.csv``: times in seconds of the run, and as told on the backpack's clock; flags as 0 and 1."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(HEADER)
        for index, (node, boot, sequence, peer, start_ns, end_ns, is_ongoing, *ticks) in enumerate(self._rows):
            times = (f"{start_ns / 1e9:.6f}", f"{end_ns / 1e9:.6f}")
            writer.writerow((node, boot, sequence, peer, *times, int(is_ongoing), int(index in self._acknowledged), *ticks))
        return text.getvalue().encode()
