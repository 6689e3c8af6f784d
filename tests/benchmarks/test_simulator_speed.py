"""How much faster the engine is than the plain numpy implementation of the same walk, which gives the same run bit for bit.

Budget: twice as fast, in seconds of one core, 150 insects in ``paper-units`` for 200 s. Run with ``pytest tests/benchmarks -s``.
"""

import statistics
import sys
import time
from collections.abc import Callable
from functools import partial

from simulator.arenas.scenarios import find_scenario
from simulator.events import Event
from simulator.presets import PRESETS
from simulator.world import World
from tests.simulator.plain.world import PlainWorld

_ROUNDS = 5


def timed(make: Callable[[int], list[Event]], seed: int) -> tuple[float, list[Event]]:
    began_s = time.process_time()
    events = make(seed)
    return time.process_time() - began_s, events


def test_the_engine_is_twice_as_fast_as_plain_numpy() -> None:
    preset = PRESETS["paper-units"]
    arena = find_scenario("two-obstacles").build(preset.side)

    def run(kind: type[World] | type[PlainWorld], seed: int) -> list[Event]:
        return kind(arena, motion=preset.motion, ranges=preset.ranges, ids=range(1, 151), seed=seed).advance(200.0)

    taken_s: tuple[list[float], list[float]] = ([], [])
    for seed in range(_ROUNDS):
        fast, slow = (timed(partial(run, kind), seed) for kind in (World, PlainWorld))
        assert fast[1] == slow[1]
        for times, (one_s, _) in zip(taken_s, (fast, slow), strict=True):
            times.append(one_s)
    pace = [150 * 200.0 / statistics.median(times) for times in taken_s]
    sys.stdout.write(f"\nengine {pace[0]:,.0f} agent-s per core-s, plain numpy {pace[1]:,.0f}: {pace[0] / pace[1]:.1f} times\n")
    assert pace[0] > 2 * pace[1]
