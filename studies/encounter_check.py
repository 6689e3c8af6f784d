"""Check encounters against brute force, millisecond by millisecond: ``python -m studies.encounter_check``.

Every millisecond, the places of all insects are computed from the recorded legs; two are in an encounter then if they are within the
detection radius and the line between them is covered by the arena's polygon. Nothing of the engine's own search or sight is used. An
interval that the engine tells and a run of instants in which the two were in an encounter must agree to within a millisecond at both ends.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.legs import Floats, Indices, locate
from simulator.motion import MotionParameters, WallLaw
from simulator.world import World
from studies.hard_arenas import FIVE

_STEP_S = 0.001
_DETECTION = 0.8
_WINDOW_S = 1.0
_STOPPED = 5

WALKING = MotionParameters(speed=1.0, mean_leg=2.0)
# Walls followed, stops, turns at a touch, persistent turns, insects that get stuck, are freed and die: all but silent backpacks.
BUSY = MotionParameters(
    speed=1.0,
    mean_leg=2.0,
    persistence=0.4,
    wall_law=WallLaw.FOLLOW,
    wall_speed=0.9,
    exit_hazard=0.3,
    departure_log_sd=0.76,
    stop_hazard=0.1,
    wall_stop_hazard=0.2,
    short_rest_s=1.0,
    long_rest_s=8.0,
    long_rest_share=0.1,
    contact_radius=0.2,
    contact_turns=True,
    company_stop_gain=1.0,
    company_rest_gain=0.5,
    mishap_hazard=0.02,
    mishap_rest_s=4.0,
    rescue_probability=0.5,
    death_hazard=0.002,
)
MOTIONS = {"walking": WALKING, "busy": BUSY}


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What a comparison gave.

    Parameters
    ----------
    encounters
        How many the engine told of.
    between_steps
        Of these, how many begin and end between two instants, where stepping cannot see them.
    missed, extra
        How many only the engine, or only stepping, has seen.
    largest_s
        Largest difference of a beginning or an end [s].
    """

    encounters: int = 0
    between_steps: int = 0
    missed: int = 0
    extra: int = 0
    largest_s: float = 0.0

    def plus(self, other: "Verdict") -> "Verdict":
        """Put two together."""
        counts = {name: getattr(self, name) + getattr(other, name) for name in ("encounters", "between_steps", "missed", "extra")}
        return replace(self, **counts, largest_s=max(self.largest_s, other.largest_s))

    @property
    def agrees(self) -> bool:
        """Whether every encounter was found by both, within a step."""
        return self.missed == self.extra == 0 and self.largest_s <= _STEP_S

    def line(self) -> str:
        """Tell it in one line."""
        return (
            f"{self.encounters:6d} encounters, {self.between_steps:3d} between two steps, {self.missed} missed by stepping, "
            f"{self.extra} only by stepping, largest difference {self.largest_s * 1e3:.6f} ms"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """Encounters by pair: number of the pair, start and end [s], shape (k,) each; sorted by pair, then start."""

    pair: Indices
    t_start_s: Floats
    t_end_s: Floats


def check(arena: Arena, motion: MotionParameters, *, insects: int, time_s: float, seed: int) -> Verdict:
    """Let insects walk in an arena, some held from the middle on, and compare their encounters with brute force."""
    world = World(
        arena,
        motion=motion,
        ranges=Ranges(detection=_DETECTION, communication=4 * _DETECTION),
        ids=range(1, insects + 1),
        seed=seed,
    )
    parts = [world.run(time_s / 2).ended]
    for one in world.ids[:_STOPPED]:
        world.stop(one)
    parts.append(world.run(time_s).ended)
    still = world.open_encounters()
    first = np.concatenate([*(part.id1 for part in parts), np.array([one.id1 for one in still], dtype=np.int64)])
    second = np.concatenate([*(part.id2 for part in parts), np.array([one.id2 for one in still], dtype=np.int64)])
    begin = np.concatenate([*(part.t_start_s for part in parts), np.array([one.t_s for one in still])])
    end = np.concatenate([*(part.t_end_s for part in parts), np.full(len(still), time_s)])
    pair = (first - 1) * insects + second - 1
    order = np.lexsort((begin, pair))
    return compare(Told(pair=pair[order], t_start_s=begin[order], t_end_s=end[order]), _step(world))


def _step(world: World) -> Told:
    """Find encounters by brute force: runs of instants, from the first to the last of each."""
    n_steps = int(world.now_s / _STEP_S)
    # At the middle between whole milliseconds, so that no instant is that of a command or of the start, when much happens at once.
    instants = (np.arange(n_steps, dtype=np.float64) + 0.5) * _STEP_S
    at_once = int(_WINDOW_S / _STEP_S)
    seen: list[tuple[Indices, Indices]] = []  # pairs and numbers of instants
    for begin in range(0, n_steps, at_once):
        pair, step = _meetings(world, instants[begin : begin + at_once])
        seen.append((pair, step + begin))
    pair, step = (np.concatenate([one[k] for one in seen]) for k in (0, 1))
    order = np.lexsort((step, pair))
    pair, step = pair[order], step[order]
    is_first = np.append(True, (np.diff(pair) != 0) | (np.diff(step) != 1))
    is_last = np.append(is_first[1:], True)
    return Told(pair=pair[is_first], t_start_s=instants[step[is_first]], t_end_s=instants[step[is_last]])


def _meetings(world: World, instants: Floats) -> tuple[Indices, Indices]:
    """Return which pairs are in an encounter at which of some instants: numbers of pairs and of instants."""
    legs, n = world.legs(), len(world.ids)
    rows = np.repeat(np.arange(n), instants.size)
    times = np.tile(instants, n)
    x, y = (place.reshape(n, instants.size) for place in legs.take(locate(legs, biobot=rows, t_s=times)).at(times))
    shapely.prepare(world.arena.polygon)
    pairs, steps = [], []
    for one in range(n - 1):
        near = (x[one + 1 :] - x[one]) ** 2 + (y[one + 1 :] - y[one]) ** 2 <= _DETECTION**2
        other, step = np.nonzero(near)
        other += one + 1
        ends = np.stack([np.column_stack([x[one, step], y[one, step]]), np.column_stack([x[other, step], y[other, step]])], axis=1)
        in_sight = shapely.covers(world.arena.polygon, shapely.linestrings(ends)) if step.size else np.empty(0, dtype=bool)
        pairs.append(one * n + other[in_sight])
        steps.append(step[in_sight])
    return np.concatenate(pairs), np.concatenate(steps)


def compare(told: Told, stepped: Told) -> Verdict:
    """Compare what was told with what stepping found; what lies between two steps is joined or left out as stepping would."""
    seen, runs = _as_stepped(told), _by_pair(stepped)
    verdict = Verdict(
        encounters=told.pair.size, between_steps=told.pair.size - sum(len(spans) for spans in _by_pair(told, seen=True).values())
    )
    for pair in seen.keys() | runs.keys():
        verdict = verdict.plus(_compare_spans(seen.get(pair, []), runs.get(pair, [])))
    return verdict


Span = tuple[float, float]


def _by_pair(told: Told, *, seen: bool = False) -> dict[int, list[Span]]:
    spans: dict[int, list[Span]] = {}
    for pair, begin, end in _rows(told):
        if not seen or _first_step(begin) <= end:
            spans.setdefault(pair, []).append((begin, end))
    return spans


def _rows(told: Told) -> Iterator[tuple[int, float, float]]:
    return zip(told.pair.tolist(), told.t_start_s.tolist(), told.t_end_s.tolist(), strict=True)


def _first_step(t_s: float) -> float:
    """Return the first instant looked at that is not before a time."""
    return (math.ceil(t_s / _STEP_S - 0.5) + 0.5) * _STEP_S


def _as_stepped(told: Told) -> dict[int, list[Span]]:
    """Leave out encounters between two instants, and join those without an instant between them."""
    joined: dict[int, list[Span]] = {}
    for pair, spans in _by_pair(told, seen=True).items():
        mine = joined.setdefault(pair, [])
        for begin, end in spans:
            if mine and _first_step(mine[-1][1]) >= begin:
                mine[-1] = (mine[-1][0], end)
            else:
                mine.append((begin, end))
    return joined


def _compare_spans(exact: list[Span], stepped: list[Span]) -> Verdict:
    """Compare the spans of one pair, both in order: those that overlap are the same encounter."""
    verdict, k = Verdict(), 0
    for begin, end in exact:
        while k < len(stepped) and stepped[k][1] < begin - _STEP_S:
            verdict = verdict.plus(Verdict(extra=1))
            k += 1
        if k == len(stepped) or stepped[k][0] > end + _STEP_S:
            verdict = verdict.plus(Verdict(missed=1))
            continue
        verdict = verdict.plus(Verdict(largest_s=max(abs(stepped[k][0] - begin), abs(stepped[k][1] - end))))
        k += 1
    return verdict.plus(Verdict(extra=len(stepped) - k))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each arena and way to move; 1 where one disagrees."""
    parser = argparse.ArgumentParser(prog="python -m studies.encounter_check", description=__doc__)
    parser.add_argument("--insects", type=int, default=60, help="(default: %(default)s)")
    parser.add_argument("--time", type=float, default=60.0, metavar="S", help="in each arena [s] (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    all_agree, sums = True, dict.fromkeys(MOTIONS, Verdict())
    for name, motion in MOTIONS.items():
        for arena, make in FIVE.items():
            verdict = check(make(), motion, insects=options.insects, time_s=options.time, seed=options.seed)
            sums[name] = sums[name].plus(verdict)
            all_agree &= verdict.agrees
            print(f"{name:8} {arena:13} {verdict.line()}{'' if verdict.agrees else '  DISAGREES'}", flush=True)
    for name, verdict in sums.items():
        print(f"{name:8} {'in all':13} {verdict.line()}")
    return 0 if all_agree else 1


if __name__ == "__main__":
    sys.exit(main())
