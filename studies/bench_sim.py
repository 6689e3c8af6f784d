"""How fast the simulator is, on one core: ``python -m studies.bench_sim``.

A case is a whole run: the world is made, insects walk, every encounter is found and every leg is kept. Agent-seconds are simulated
seconds times insects. Runs of all cases and of Mesa take turns, so that all have the same noise; medians are told. What counts is the
time of the core, so that other programs on the machine cost little; the wall's clock is told beside it.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from simulator.arenas.arena import Arena
from simulator.arenas.scenarios import find_scenario
from simulator.presets import Preset, find_preset
from simulator.world import World
from studies.wall_density import make_disc

_PAPER_INSECTS = 150
_BIG_INSECTS = 100_000
_MESA_STEP = 0.1  # in times that a walker takes for a detection radius
_DISC_SIDES = 96


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is run: a preset in an arena, with so many insects at the preset's density."""

    preset: str
    arena: str
    insects: int
    duration_s: float

    def make_arena(self) -> Arena:
        """Make the arena, larger by the root of the number of insects over the preset's."""
        preset = find_preset(self.preset)
        side = preset.side * (self.insects / preset.biobots) ** 0.5
        return make_disc(radius=side / 2.0, sides=_DISC_SIDES) if self.arena == "disc" else find_scenario(self.arena).build(side)

    def run(self, seed: int) -> int:
        """Run it whole; return how many encounters ended."""
        preset: Preset = find_preset(self.preset)
        world = World(self.make_arena(), motion=preset.motion, ranges=preset.ranges, ids=range(1, self.insects + 1), seed=seed)
        return len(world.run(self.duration_s).ended)


CASES: Mapping[str, Case] = MappingProxyType(
    {
        "paper-units, empty square": Case(preset="paper-units", arena="no-obstacle", insects=150, duration_s=200.0),
        "paper-units, two obstacles": Case(preset="paper-units", arena="two-obstacles", insects=150, duration_s=200.0),
        "paper-50cm, two obstacles": Case(preset="paper-50cm", arena="two-obstacles", insects=150, duration_s=200.0),
        "jeanson-larva, disc of 96 walls": Case(preset="jeanson-larva", arena="disc", insects=30, duration_s=1800.0),
        "hisser-field, two obstacles": Case(preset="hisser-field", arena="two-obstacles", insects=40, duration_s=3600.0),
        "paper-units density, 10,000 insects": Case(preset="paper-units", arena="no-obstacle", insects=10_000, duration_s=20.0),
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Medians over the rounds.

    Parameters
    ----------
    wall_s, cpu_s
        Of one run [s].
    agent_s
        Insects times simulated seconds.
    """

    name: str
    agent_s: float
    duration_s: float
    wall_s: float
    cpu_s: float
    encounters: int

    @property
    def pace(self) -> float:
        """Agent-seconds per second of one core's time: on a machine with nothing else to do, per second of the wall's clock."""
        return self.agent_s / self.cpu_s

    def line(self) -> str:
        """Tell it in one line."""
        return (
            f"{self.name:36} {self.pace:11,.0f} agent-s per core-s  {self.duration_s / self.cpu_s:7,.0f} x life  "
            f"(by the wall's clock {self.duration_s / self.wall_s:7,.0f} x)  {self.encounters:6,d} encounters"
        )


def time_in_turns(runs: Mapping[str, tuple[Case, Callable[[int], int]]], *, rounds: int) -> list[Timing]:
    """Run everything once a round, with the round's number as seed, and return medians in the order given."""
    taken: dict[str, list[tuple[float, float, int]]] = {name: [] for name in runs}
    for seed in range(1, rounds + 1):
        for name, (_, run) in runs.items():
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            encounters = run(seed)
            taken[name].append((time.perf_counter() - wall_s, time.process_time() - cpu_s, encounters))
    return [
        Timing(
            name=name,
            agent_s=case.insects * case.duration_s,
            duration_s=case.duration_s,
            wall_s=statistics.median(one[0] for one in taken[name]),
            cpu_s=statistics.median(one[1] for one in taken[name]),
            encounters=round(statistics.median(one[2] for one in taken[name])),
        )
        for name, (case, _) in runs.items()
    ]


def mesa_runs(*, duration_s: float) -> dict[str, tuple[Case, Callable[[int], int]]]:
    """Return the same walk in Mesa's spaces; empty where Mesa is not installed."""
    try:
        from studies import mesa_peer  # noqa: PLC0415  # Mesa is needed here alone
    except ModuleNotFoundError:
        print("Mesa is not installed (it is in the extra 'dev'): no comparison", file=sys.stderr)
        return {}
    preset = find_preset("paper-units")
    walk = mesa_peer.Walk(
        insects=_PAPER_INSECTS,
        side=preset.side,
        speed=preset.motion.speed,
        mean_leg=preset.motion.mean_leg,
        detection=preset.ranges.detection,
        step_s=_MESA_STEP * preset.ranges.detection / preset.motion.speed,
        duration_s=duration_s,
    )
    case = Case(preset="paper-units", arena="no-obstacle", insects=_PAPER_INSECTS, duration_s=duration_s)

    def runner(space: mesa_peer.MesaSpace) -> Callable[[int], int]:
        return lambda seed: mesa_peer.count_encounters(walk, space=space, seed=seed)

    return {space.value: (case, runner(space)) for space in mesa_peer.MesaSpace}


def measure_memory(*, insects: int, duration_s: float) -> tuple[float, Timing]:
    """Run many insects in a process of their own; return its peak of memory [bytes] and how fast it was."""
    command = [sys.executable, "-m", "studies.bench_sim", "--alone", str(insects), str(duration_s)]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    peak, wall_s, cpu_s, encounters = float(told[0]), float(told[1]), float(told[2]), int(told[3])
    name = f"paper-units density, {insects:,} insects"
    timing = Timing(name=name, agent_s=insects * duration_s, duration_s=duration_s, wall_s=wall_s, cpu_s=cpu_s, encounters=encounters)
    return peak, timing


def _run_alone(insects: int, duration_s: float) -> None:
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    encounters = Case(preset="paper-units", arena="no-obstacle", insects=insects, duration_s=duration_s).run(1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    print(peak, time.perf_counter() - wall_s, time.process_time() - cpu_s, encounters)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print how fast each case runs, how it compares with Mesa, and the peak of memory."""
    parser = argparse.ArgumentParser(prog="python -m studies.bench_sim", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="runs of each (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="one short round, 2,000 insects for memory: to see that it works")
    parser.add_argument("--mesa-seconds", type=float, default=20.0, metavar="S", help="that Mesa simulates a round (default: %(default)s)")
    parser.add_argument("--big-seconds", type=float, default=50.0, metavar="S", help="that 100,000 insects walk (default: %(default)s)")
    parser.add_argument("--alone", nargs=2, metavar=("N", "S"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.alone is not None:
        _run_alone(int(options.alone[0]), float(options.alone[1]))
        return 0
    rounds, mesa_s, insects, big_s = options.rounds, options.mesa_seconds, _BIG_INSECTS, options.big_seconds
    if options.quick:
        rounds, mesa_s, insects, big_s = 1, 1.0, 2_000, 5.0
    runs: dict[str, tuple[Case, Callable[[int], int]]] = {name: (case, case.run) for name, case in CASES.items()}
    peers = mesa_runs(duration_s=mesa_s)
    timings = time_in_turns({**runs, **peers}, rounds=rounds)
    for timing in timings:
        print(timing.line())
    own = timings[0]
    for timing in timings[len(runs) :]:
        print(f"{own.name}: {own.pace / timing.pace:,.0f} times as fast as {timing.name}, step {_MESA_STEP:g} r_d / v")
    peak, big = measure_memory(insects=insects, duration_s=big_s)
    print(big.line())
    print(f"{big.name}, {big_s:g} s: peak of memory {peak / 2**30:.2f} GiB, legs kept")
    return 0


if __name__ == "__main__":
    sys.exit(main())
