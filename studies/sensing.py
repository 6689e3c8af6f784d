"""How far encounters formed from beacons are from exact ones, by detection radius, beacon period and radio.

``python -m studies.sensing --write docs/simulation.md`` put the table into that document; ``--quick`` tries the shortest run of each.
The insects are 40 hissing cockroaches in a room of 5 m x 5 m with an obstacle of 2 m in it: 4 cm/s, legs of 0.5 m on average.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from shapely.geometry import Polygon, box

from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters
from simulator.radios.fidelity import compare
from simulator.radios.paths import Paths
from simulator.radios.radio import RADIO_PRESETS
from simulator.radios.sensing import SensingConfig, sense
from simulator.truth import TruthRecorder
from simulator.world import World
from studies.tables import put_between_markers

RADII_M = (0.25, 0.5, 1.0)
PERIODS_S = (0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """A radio preset, and what opens and keeps an encounter."""

    name: str
    radio: str
    min_beacons: int = 1
    gap_periods: float = 1.15


SENSINGS = (
    Sensing(name="ideal", radio="ideal"),
    Sensing(name="indoor", radio="indoor"),
    Sensing(name="indoor, steady", radio="indoor", min_beacons=2, gap_periods=2.3),
)

BEGIN, END = "<!-- studies.sensing begins -->", "<!-- studies.sensing ends -->"

_SPEED, _MEAN_LEG = 0.04, 0.5  # [m/s], [m]; the speed of Erickson et al., PLoS ONE 2015; the leg is an assumption
_BIOBOTS, _SIDE_M, _OBSTACLE = 40, 5.0, (1.5, 1.5, 3.5, 3.5)
_DURATION_S, _QUICK_S = 1800.0, 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One line of the table; shares from 0 to 1, None where nothing happened."""

    radius_m: float
    period_s: float
    sensing: str
    true_encounters: int
    observed_encounters: int
    detected: float | None
    false: float | None
    sensitivity: float | None
    precision: float | None
    duration_error_s: float | None
    heard: float


def study(*, duration_s: float = _DURATION_S, radii_m: Sequence[float] = RADII_M, seed: int = 1) -> Iterator[Row]:
    """Walk once for each radius, and sense each walk with every period and radio."""
    arena = build_arena(Polygon(box(0, 0, _SIDE_M, _SIDE_M).exterior, [box(*_OBSTACLE).exterior]))
    for radius_m in radii_m:
        ranges = Ranges(detection=radius_m, communication=_SIDE_M)
        motion = MotionParameters(speed=_SPEED, mean_leg=_MEAN_LEG)
        world = World(arena, motion=motion, ranges=ranges, ids=range(1, _BIOBOTS + 1), seed=seed)
        recorder = TruthRecorder(world)
        recorder.record(world.advance(duration_s))
        yield from _sense(world, recorder, arena=arena, radius_m=radius_m, seed=seed)


def _sense(world: World, recorder: TruthRecorder, *, arena: Arena, radius_m: float, seed: int) -> Iterator[Row]:
    paths, true = Paths(world.legs(), n=len(world.ids)), recorder.encounters(zero_s=0.0)
    for sensing in SENSINGS:
        for period_s in PERIODS_S:
            config = SensingConfig(
                seed=seed,
                detection=radius_m,
                communication=_SIDE_M,
                period_s=period_s,
                gap_periods=sensing.gap_periods,
                min_beacons=sensing.min_beacons,
                radio=RADIO_PRESETS[sensing.radio].config,
            )
            sensed = sense(paths, ids=world.ids, arena=arena, until_s=world.now_s, config=config)
            found = compare(sensed.encounters, true)
            yield Row(
                radius_m=radius_m,
                period_s=period_s,
                sensing=sensing.name,
                true_encounters=len(true),
                observed_encounters=len(sensed.encounters),
                detected=found["detected_share"],
                false=found["false_share"],
                sensitivity=found["sensitivity_in_time"],
                precision=found["precision_in_time"],
                duration_error_s=found["mean_duration_error_s"],
                heard=sensed.air.fates["heard"] / max(1, sum(sensed.air.fates.values())),
            )


def to_markdown(rows: Sequence[Row]) -> str:
    """Write the table."""
    lines = [
        "| sensing | r_d [m] | period [s] | true | observed | detected | false | time covered | time true | duration error [s] | heard |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    order = [one.name for one in SENSINGS]
    for row in sorted(rows, key=lambda one: (order.index(one.sensing), one.radius_m, one.period_s)):
        shares = (_percent(one) for one in (row.detected, row.false, row.sensitivity, row.precision))
        error = "-" if row.duration_error_s is None else f"{row.duration_error_s:+.2f}"
        cells = (row.sensing, f"{row.radius_m:g}", f"{row.period_s:g}", row.true_encounters, row.observed_encounters, *shares, error)
        lines.append("| " + " | ".join(map(str, cells)) + f" | {_percent(row.heard)} |")
    return "\n".join(lines)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; print the table, or put it into a document."""
    parser = argparse.ArgumentParser(prog="studies.sensing", description="Beacon encounters beside exact ones.")
    parser.add_argument("--quick", action="store_true", help="a minute of walk instead of half an hour")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="same seed, same table (default: 1)")
    parser.add_argument("--write", type=Path, metavar="FILE.md", help="put the table between this document's markers")
    args = parser.parse_args(arguments)
    document = None if args.write is None else args.write.read_text()
    if document is not None:
        put_between_markers(document, "", path=args.write, markers=(BEGIN, END))  # tell of a missing marker before the work, not after
    table = to_markdown(list(study(duration_s=_QUICK_S if args.quick else _DURATION_S, seed=args.seed)))
    if document is None:
        print(table)
    else:
        args.write.write_text(put_between_markers(document, table, path=args.write, markers=(BEGIN, END)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
