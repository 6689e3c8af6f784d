"""What a stop of all does to the map, by what its stands are taken for: ``python -m studies.halt_check``.

Biobots explore; all are stopped for a while, and those that walked are started again. The map is made before the stop, at its end and some
time after it, with the stands of those who were no landmarks taken for landmarks, for stops of the insects' own, or not told at all; and
of a swarm that was never stopped and walked as long.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.config import RecipeConfig, make_recipe
from mapper.pipeline import compute_map
from mapper.types import MapResult, ModeSpell, Recipe
from simulator.arenas.geodesics import geodesic_distances
from simulator.events import Cause as SimulatedCause
from simulator.events import EncounterEnded, Event, ModeChanged
from simulator.events import Mode as SimulatedMode
from simulator.world import World
from studies.confidence_runs import free_places, judge_points, true_places
from studies.exploration import DISPERSION_S, tabulate
from studies.trials import HELD_OUT_SEED, SETTINGS, Setting, make_world

TAKEN_FOR: Final = ("landmarks", "own stops", "not told")
_WALK_SHARE = 0.5
"""Of the time explored before the stop: how long they walk after it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What a map says, beside the truth.

    Whether the number of holes is right, the probability given to the true one and to the map's own, the share of points with right
    distances (`studies.confidence_runs`), and landmarks of the largest component.
    """

    is_right: bool
    of_truth: float
    of_own: float
    well_placed: float
    n_landmarks: int


def read_run(setting: Setting, seed: int, *, halt_s: float) -> dict[str, Reading]:
    """Simulate one run twice, stopped and not, and map it; readings by row of the table."""
    recipe = make_recipe(RecipeConfig())
    found: dict[str, Reading] = {}
    for is_halted in (True, False):
        world = make_world(setting, seed)
        zero_s = DISPERSION_S * setting.seconds
        events = world.advance(zero_s)
        landmarks = set(select_landmarks(world.adjacency(), count=setting.landmarks))
        for one in landmarks:
            world.stop(one)
        halt_at_s = zero_s + setting.duration_s * setting.seconds
        events += world.advance(halt_at_s)
        walkers = [one for one in world.ids if one not in landmarks]
        now_s = halt_at_s
        if is_halted:
            found["before"] = _read(world, events, recipe=recipe, zero_s=zero_s, halted=(), cause=Cause.COMMAND)
            for one in walkers:
                world.stop(one)
            now_s += halt_s * setting.seconds
            events += world.advance(now_s)
            for cause, name in zip((Cause.COMMAND, Cause.NATURAL, None), TAKEN_FOR, strict=True):
                found[f"end of the stop: {name}"] = _read(world, events, recipe=recipe, zero_s=zero_s, halted=walkers, cause=cause)
            for one in walkers:
                world.start(one)
        events += world.advance(now_s + _WALK_SHARE * setting.duration_s * setting.seconds)
        if is_halted:
            for cause, name in zip((Cause.COMMAND, Cause.NATURAL, None), TAKEN_FOR, strict=True):
                found[f"walked on: {name}"] = _read(world, events, recipe=recipe, zero_s=zero_s, halted=walkers, cause=cause)
        else:
            found["walked on: never stopped"] = _read(world, events, recipe=recipe, zero_s=zero_s, halted=(), cause=Cause.COMMAND)
    return found


def _read(world: World, events: Sequence[Event], *, recipe: Recipe, zero_s: float, halted: Sequence[int], cause: Cause | None) -> Reading:
    spans = [(event.t_start_s, event.t_end_s, event.id1, event.id2) for event in events if isinstance(event, EncounterEnded)]
    spans += [(began.t_s, world.now_s, began.id1, began.id2) for began in world.open_encounters()]
    table = tabulate(spans, from_s=zero_s)
    result = compute_map(table, _spells(events, halted=frozenset(halted), cause=cause), recipe)
    assert result.hole_count is not None, "the default recipe has replicates"
    truth, count = world.arena.betti.holes, result.hole_count
    return Reading(
        is_right=count.value == truth,
        of_truth=count.probabilities[truth] if truth < len(count.probabilities) else 0.0,
        of_own=count.probability,
        well_placed=_well_placed(result, world),
        n_landmarks=result.components[0].n_landmarks,
    )


def _well_placed(result: MapResult, world: World) -> float:
    places = free_places(world.arena, true_places(result, world))
    return float(np.mean(judge_points(result.components[0].distances, geodesic_distances(world.arena, places))))


def _spells(events: Sequence[Event], *, halted: frozenset[int], cause: Cause | None) -> tuple[ModeSpell, ...]:
    """Make a spell of each time that somebody stood; ``cause``: that of commanded stands of the halted, None leaves them out."""
    open_since: dict[int, ModeSpell] = {}
    spells: list[ModeSpell] = []
    for event in events:
        if not isinstance(event, ModeChanged):
            continue
        t_ns = round(event.t_s * NS_PER_S)
        before = open_since.pop(event.id, None)
        if before is not None:
            spells.append(replace(before, t_end_ns=t_ns))
        if event.mode is not SimulatedMode.S:
            continue
        own: Cause | None = Cause.COMMAND if event.cause is SimulatedCause.COMMAND else Cause.NATURAL
        if own is Cause.COMMAND and event.id in halted:
            own = cause
        if own is not None:
            open_since[event.id] = ModeSpell(node=NodeId(event.id), t_start_ns=t_ns, t_end_ns=None, mode=Mode.S, cause=own)
    return (*spells, *open_since.values())


def main(given: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m studies.halt_check", description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="of each setting (20)")
    parser.add_argument("--first-seed", type=int, default=HELD_OUT_SEED, help=f"nothing was trained from {HELD_OUT_SEED} on")
    parser.add_argument("--halt-share", type=float, default=0.25, help="how long all stand, as a share of the time explored before (0.25)")
    parser.add_argument("--setting", action="append", choices=sorted(SETTINGS), help="repeat for more")
    args = parser.parse_args(given)
    for name in args.setting or ("big-square/hisser-field", "big-square/hisser-stops", "squares/paper-units"):
        setting = SETTINGS[name]
        rows: dict[str, list[Reading]] = {}
        for seed in range(args.first_seed, args.first_seed + args.runs):
            for row, reading in read_run(setting, seed, halt_s=args.halt_share * setting.duration_s).items():
                rows.setdefault(row, []).append(reading)
        print(f"\n| {name}, {args.runs} runs | right | given to the truth | its own | well placed | landmarks |")
        print("|---|---|---|---|---|---|")
        for row, readings in rows.items():
            means = (np.mean([getattr(one, key) for one in readings]) for key in ("is_right", "of_truth", "of_own", "well_placed"))
            shown = " | ".join(f"{100 * mean:.0f} %" for mean in means)
            print(f"| {row} | {shown} | {np.mean([one.n_landmarks for one in readings]):.0f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
