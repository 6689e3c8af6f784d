"""How true the times of encounters are, and how honest their bounds: ``python -m studies.clocks``.

Hissing cockroaches walk in an empty room (the simulator's engine), their backpacks' beacons are heard or lost (the simulator's radios), and
the reports go with drifting clocks through busy queues, over restarts, to the gateway's own clocks and merger (``clock_traffic``).
A record's times are compared with the exact encounter that it overlaps, or, where it overlaps several, with the begin of the first and
the end of the last. The radio's radius is made the detection radius: no rounding of strengths, one threshold to enter and to leave.
``--write docs/clocks.md`` puts the table between that document's markers.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from shapely.geometry import box

from firmware_protocol.contract.records import EncounterRecord
from firmware_protocol.units import NS_PER_S
from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.radios.fidelity import Encounter
from simulator.radios.paths import Paths
from simulator.radios.radio import RadioConfig
from simulator.radios.sensing import SensingConfig, sense
from simulator.truth import TruthRecorder
from simulator.world import World
from studies.clock_traffic import Made, TrafficConfig, make_records
from studies.tables import put_between_markers

BEGIN, END = "<!-- studies.clocks begins -->", "<!-- studies.clocks ends -->"
LOSSES = (0.0, 0.1, 0.2, 0.3)

_COLUMNS = (
    "beacons lost", "estimated", "backpacks unheard", "records", "one-sided", "one to one", "error p50, p95, p99 [ms]", "covered",
    "bound p50, p95 [ms]", "bound / error, p95", "clock error p50, p99 [ms]", "clock bound p99 [ms]", "rate known to [ppm]",
)  # fmt: skip
_BIOBOTS, _SIDE_M, _DETECTION_M = 40, 5.0, 0.5
_SPEED, _MEAN_LEG = 0.04, 0.5  # [m/s], [m]; the speed of Erickson et al., PLoS ONE 2015; the leg is an assumption
_PERIOD_S = 1.0
_DURATION_S, _QUICK_S = 1800.0, 240.0
_TOUCH_S = 0.01
"""A record and an encounter that are this near overlap: more than a clock is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One line of the table: errors and bounds [s], shares from 0 to 1.

    Parameters
    ----------
    errors
        Of begins and ends alike: median, 95th and 99th percentile.
    covered
        Share of records whose begin and end are both within their bound.
    bounds
        Median, 95th percentile.
    one_to_one
        Share of records that overlap one encounter, which overlaps no other record.
    """

    loss: float
    silent: int
    records: int
    one_sided: float
    one_to_one: float
    errors: tuple[float, float, float]
    covered: float
    bounds: tuple[float, float]
    made: Made

    @property
    def width_ratio(self) -> float:
        """Return the bounds' 95th percentile over that of the errors."""
        return self.bounds[1] / self.errors[1]


def study(*, duration_s: float = _DURATION_S, losses: Sequence[float] = LOSSES, seed: int = 1) -> Iterator[Row]:
    """Walk once, and sense and report that walk with every loss, by both sides and with half of the backpacks unheard."""
    arena = build_arena(box(0, 0, _SIDE_M, _SIDE_M))
    ranges = Ranges(detection=_DETECTION_M, communication=_SIDE_M)
    motion = MotionParameters(speed=_SPEED, mean_leg=_MEAN_LEG)
    world = World(arena, motion=motion, ranges=ranges, ids=range(1, _BIOBOTS + 1), seed=seed)
    recorder = TruthRecorder(world)
    recorder.record(world.advance(duration_s))
    true, paths = recorder.encounters(zero_s=0.0), Paths(world.legs(), n=_BIOBOTS)
    for loss in losses:
        radio = RadioConfig(loss=loss, rssi_step_db=0.0)
        edge_dbm = radio.median_dbm(_DETECTION_M)
        config = SensingConfig(
            seed=seed, detection=_DETECTION_M, communication=_SIDE_M, period_s=_PERIOD_S, enter_dbm=edge_dbm, exit_dbm=edge_dbm,
            drift_ppm=40.0, radio=radio,
        )  # fmt: skip
        sensed = sense(paths, ids=world.ids, arena=arena, until_s=duration_s, config=config)
        for silent in (frozenset[int](), frozenset(range(1, _BIOBOTS // 2 + 1))):
            traffic = TrafficConfig(seed=seed, period_s=_PERIOD_S, until_s=duration_s, silent=silent)
            made = make_records(sensed.observations, nodes=list(world.ids), config=traffic)
            yield compare(made, true, duration_s=duration_s, loss=loss, silent=len(silent))


def compare(made: Made, true: Sequence[Encounter], *, duration_s: float, loss: float, silent: int) -> Row:
    """Compare records with the truth; what began before the run or was cut off by its end is left out."""
    met: dict[tuple[int, int], list[tuple[float, float]]] = defaultdict(list)
    for start_s, end_s, one, other in sorted(true):
        met[one, other].append((start_s, end_s))
    seen: dict[tuple[int, int], list[EncounterRecord]] = defaultdict(list)
    for record in made.records:
        seen[record.node_a, record.node_b].append(record)
    errors: list[float] = []
    bounds: list[float] = []
    covered, alone, one_sided = [], [], []
    for pair, records in seen.items():
        for record in records:
            spells = [spell for spell in met[pair] if _touches(record, spell)]
            if not spells or spells[0][0] <= 2 * _PERIOD_S or spells[-1][1] >= duration_s - 2 * _PERIOD_S:
                continue
            wrong_s = (abs(record.t_start_ns / NS_PER_S - spells[0][0]), abs(record.t_end_ns / NS_PER_S - spells[-1][1]))
            errors += wrong_s
            bounds.append(record.error_ns / NS_PER_S)
            covered.append(max(wrong_s) <= bounds[-1])
            alone.append(len(spells) == 1 and sum(_touches(other, spells[0]) for other in records) == 1)
            one_sided.append(not record.is_reciprocal)
    median, p95, p99 = np.quantile(errors, (0.5, 0.95, 0.99)).tolist()
    wide, wider = np.quantile(bounds, (0.5, 0.95)).tolist()
    return Row(
        loss=loss,
        silent=silent,
        records=len(bounds),
        one_sided=float(np.mean(one_sided)),
        one_to_one=float(np.mean(alone)),
        errors=(median, p95, p99),
        covered=float(np.mean(covered)),
        bounds=(wide, wider),
        made=made,
    )


def _touches(record: EncounterRecord, spell: tuple[float, float]) -> bool:
    """Tell whether a beacon that was heard in the encounter is behind a record."""
    start_s = min(side.t_start_ns for side in record.sides) / NS_PER_S
    end_s = max(side.t_end_ns for side in record.sides) / NS_PER_S
    return spell[0] <= end_s + _TOUCH_S and spell[1] >= start_s - _TOUCH_S


def to_markdown(rows: Sequence[Row]) -> str:
    """Write the table."""
    lines = [
        "| " + " | ".join(_COLUMNS) + " |",
        "|" + "---|" * len(_COLUMNS),
    ]
    for row in rows:
        clock = np.quantile(row.made.clock_errors_ns, (0.5, 0.99)) / 1e6
        cells = (
            f"{row.loss:.0%}", f"{row.made.loss:.1%}", row.silent, row.records, f"{row.one_sided:.0%}", f"{row.one_to_one:.1%}",
            ", ".join(f"{1e3 * one:.0f}" for one in row.errors), f"{row.covered:.1%}", ", ".join(f"{1e3 * one:.0f}" for one in row.bounds),
            f"{row.width_ratio:.2f}", f"{clock[0]:.1f}, {clock[1]:.1f}", f"{np.quantile(row.made.clock_bounds_ns, 0.99) / 1e6:.1f}",
            f"{1e6 * np.median(row.made.rate_errors):.0f}",
        )  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def failures(rows: Sequence[Row]) -> list[str]:
    """Say what is not as it should be where both sides report: the errors without loss, the bounds with it, and the clocks always."""
    found = []
    for row in rows:
        name = f"{row.loss:.0%} lost, {row.silent} unheard"
        if not row.loss and not row.silent and row.errors[2] > _PERIOD_S / 2 + 0.005:
            found.append(f"{name}: p99 of the error is {row.errors[2]:.3f} s; wanted half a beacon period and 5 ms")
        if not row.silent and row.covered < 0.95:
            found.append(f"{name}: {row.covered:.1%} of records within their bound; wanted 95 %")
        if row.width_ratio > 3.0:
            found.append(f"{name}: bounds are {row.width_ratio:.2f} times the errors; wanted at most 3")
        if any(wrong > bound for wrong, bound in zip(row.made.clock_errors_ns, row.made.clock_bounds_ns, strict=True)):
            found.append(f"{name}: a clock was wrong by more than its bound")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and print its table, or put it into a document; 1 where a figure is out of its limit."""
    parser = argparse.ArgumentParser(prog="studies.clocks", description="Times of encounters and their bounds against the truth.")
    parser.add_argument("--quick", action="store_true", help="four minutes of walk instead of half an hour")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="same seed, same table (default: 1)")
    parser.add_argument("--write", type=Path, metavar="FILE.md", help="put the table between this document's markers")
    options = parser.parse_args(arguments)
    rows = list(study(duration_s=_QUICK_S if options.quick else _DURATION_S, seed=options.seed))
    table = to_markdown(rows)
    if options.write is None:
        print(table)
    else:
        document = options.write.read_text()
        options.write.write_text(put_between_markers(document, table, path=options.write, markers=(BEGIN, END)))
    wrong = failures(rows)
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
