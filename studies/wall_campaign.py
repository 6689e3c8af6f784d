"""Show that no insect ever leaves its arena, in random arenas that are hard to stay inside of: ``python -m studies.wall_campaign``.

A step is an event of the engine (``World.n_steps``): a leg that begins, a cell that is crossed, an encounter, a stop.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import shapely

from simulator.arenas.arena import Arena
from simulator.config import Ranges
from simulator.errors import ArenaError
from simulator.legs import Legs
from simulator.motion import MotionParameters, WallLaw
from simulator.world import World
from studies.errors import CampaignFileError, EscapeError, StudyError
from studies.nasty_arenas import Nastiness, draw_nasty_arena

_INSECTS = 64
_STEPS_A_WORLD = 300_000
# Of all legs, these are looked at from end to end; of all others, both ends.
_LINES_ONE_IN = 16
# An insect reflected to and fro in a crack makes millions of legs a second: never far ahead at once.
_LONGEST_RUN_S = 30.0
_LONGEST_WORLD_S = 200_000.0
_LAWS = tuple(WallLaw)
_KINDS = tuple(Nastiness)


@dataclass(slots=True, kw_only=True)
class Progress:
    """How far a campaign has come. ``worlds``: the number of the next one; ``by_kind``: steps in each kind of arena and under each law."""

    seed: int
    worlds: int = 0
    unplaceable: int = 0
    steps: int = 0
    legs: int = 0
    lines: int = 0
    seconds: float = 0.0
    by_kind: dict[str, int] = field(default_factory=dict)

    def line(self) -> str:
        """Tell it in one line."""
        return (
            f"{self.worlds} worlds, {self.steps:.4g} steps, {self.legs:.4g} legs with both ends inside, "
            f"{self.lines:.4g} of them looked at from end to end; {self.seconds:.0f} s"
        )


def draw_motion(rng: np.random.Generator, *, law: WallLaw, extent: float) -> MotionParameters:
    """Draw how insects walk: free paths from a thousandth of the extent to thirty times it, exponential or Levy, persistent or not."""
    mean_leg = extent * 10 ** rng.uniform(-3, 1.5)
    speed = extent / 10.0
    is_busy = rng.random() < 0.3
    return MotionParameters(
        speed=speed,
        mean_leg=mean_leg,
        persistence=float(rng.choice([0.0, 0.5, 0.95])),
        levy_exponent=float(rng.uniform(1.2, 3.5)) if rng.random() < 0.3 else None,
        wall_law=law,
        wall_speed=speed * float(rng.uniform(0.3, 2.0)),
        exit_hazard=float(10 ** rng.uniform(-1, 1)),
        departure_log_sd=float(rng.uniform(0, 1)),
        stop_hazard=0.1 if is_busy else 0.0,
        wall_stop_hazard=0.2 if is_busy else 0.0,
        short_rest_s=0.5,
        contact_radius=extent / 300.0 if is_busy else 0.0,
        contact_turns=is_busy,
        company_rest_gain=0.5 if is_busy else 0.0,
    )


def make_world(seed: int, number: int) -> tuple[World, str, str]:
    """Make world ``number`` of a campaign; return it with the kind of its arena and the law of its walls."""
    rng = np.random.default_rng([seed, number])
    kind, law = _KINDS[number % len(_KINDS)], _LAWS[number // len(_KINDS) % len(_LAWS)]
    arena = draw_nasty_arena(kind, rng)
    low_x, low_y, high_x, high_y = arena.bounds
    extent = max(high_x - low_x, high_y - low_y)
    world = World(
        arena,
        motion=draw_motion(rng, law=law, extent=extent),
        ranges=Ranges(detection=extent / 200.0, communication=extent),
        ids=range(1, _INSECTS + 1),
        seed=number,
    )
    return world, kind.value, law.value


def walk(world: World, *, steps: int) -> None:
    """Let a world run until the engine has made at least some steps, or for 20,000 times the way across."""
    dt_s = 0.01
    while world.now_s < _LONGEST_WORLD_S:
        before = world.n_steps
        world.run(world.now_s + dt_s)
        made = world.n_steps - before
        left = steps - world.n_steps
        if left <= 0:
            return
        dt_s = min(_LONGEST_RUN_S, dt_s * min(2.0, max(0.1, left / max(made, 1))))


def find_escapes(arena: Arena, legs: Legs, *, lines_one_in: int) -> tuple[list[str], int]:
    """Look for legs that begin or end outside, and for some that lead outside in between.

    Parameters
    ----------
    lines_one_in
        Every how many-th leg is looked at from end to end.

    Returns
    -------
    list of str, int
        What is wrong, one text a leg; and how many legs were looked at from end to end.
    """
    shapely.prepare(arena.polygon)
    end_x, end_y = legs.at(legs.t_end_s)
    inside = shapely.contains_xy(arena.polygon, legs.x, legs.y) & shapely.contains_xy(arena.polygon, end_x, end_y)
    some = np.arange(0, len(legs), lines_one_in)
    ends = np.stack([np.column_stack([legs.x[some], legs.y[some]]), np.column_stack([end_x[some], end_y[some]])], axis=1)
    covered = shapely.covers(arena.polygon, shapely.linestrings(ends))
    wrong = np.union1d(np.flatnonzero(~inside), some[~covered])
    texts = [
        f"biobot {legs.biobot[k] + 1} goes from ({legs.x[k]!r}, {legs.y[k]!r}) to ({end_x[k]!r}, {end_y[k]!r}) "
        f"at {legs.t_start_s[k]!r} to {legs.t_end_s[k]!r} s"
        for k in wrong.tolist()
    ]
    return texts, some.size


def run_world(progress: Progress, *, steps: int = _STEPS_A_WORLD, lines_one_in: int = _LINES_ONE_IN) -> None:
    """Run the next world of a campaign and check it.

    Raises
    ------
    EscapeError
        An insect left its arena.
    """
    number = progress.worlds
    try:
        world, kind, law = make_world(progress.seed, number)
    except ArenaError:  # no room to place an insect: too thin
        progress.worlds += 1
        progress.unplaceable += 1
        return
    walk(world, steps=steps)
    legs = world.legs()
    problems, lines = find_escapes(world.arena, legs, lines_one_in=lines_one_in)
    if problems:
        place = f"seed {progress.seed}, world {number} ({kind}, {law})"
        raise EscapeError(place=place, problem=problems[0], n_found=len(problems))
    progress.worlds += 1
    progress.steps += world.n_steps
    progress.legs += len(legs)
    progress.lines += lines
    for name in (kind, law):
        progress.by_kind[name] = progress.by_kind.get(name, 0) + world.n_steps


def load_progress(path: Path, *, seed: int) -> Progress:
    """Take up a campaign where it was left, or begin one. Raises CampaignFileError."""
    if not path.exists():
        return Progress(seed=seed)
    try:
        progress = Progress(**json.loads(path.read_text()))
    except (ValueError, TypeError) as error:
        raise CampaignFileError(path=path, problem=f"is no state of a campaign ({error})") from error
    if progress.seed != seed:
        raise CampaignFileError(path=path, problem=f"belongs to seed {progress.seed}, wanted {seed}")
    return progress


def store_progress(progress: Progress, path: Path) -> None:
    """Keep what was done, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(asdict(progress), indent=1) + "\n")
    unfinished.replace(path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run worlds until the steps are made; 1 where an insect got out."""
    parser = argparse.ArgumentParser(prog="python -m studies.wall_campaign", description=__doc__)
    parser.add_argument("--steps", type=float, default=1e9, help="in all, with those of earlier calls (default: %(default)g)")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long; another call goes on (default: no limit)")
    parser.add_argument("--seed", type=int, default=1, help="(default: %(default)s)")
    parser.add_argument("--first", type=int, help="begin with this world and keep no state: to look at a failure")
    parser.add_argument(
        "--state", type=Path, default=Path("artifacts/wall_campaign.json"), help="where progress is kept (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    began_s = time.monotonic()
    try:
        is_kept = options.first is None
        progress = load_progress(options.state, seed=options.seed) if is_kept else Progress(seed=options.seed, worlds=options.first)
        earlier_s = progress.seconds
        while progress.steps < options.steps and time.monotonic() - began_s < options.seconds:
            run_world(progress)
            progress.seconds = earlier_s + time.monotonic() - began_s
            if is_kept:
                store_progress(progress, options.state)
            if sys.stderr.isatty():
                sys.stderr.write(f"\r{progress.line()}")
    except StudyError as error:
        print(error, file=sys.stderr)
        return 1
    print(progress.line())
    for name, steps in sorted(progress.by_kind.items()):
        print(f"  {name:16} {steps:.3g} steps")
    print(f"  {progress.unplaceable} arenas had no room to place an insect")
    return 0


if __name__ == "__main__":
    sys.exit(main())
