"""Tables of encounters of any size, cut from one simulated run, and kept as files.

150 biobots walk in the arena of two obstacles (preset ``paper-units``), 20 of them landmarks: they stand by command from time 0. About
eleven encounters end in a second, so a million take a day of the insects' life and seconds of the engine's. Times are whole nanoseconds
without a grid, as the simulator's files and the gateways' records have them.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from firmware_protocol.landmarks import select_landmarks
from mapper.types import IntArray
from mapper.window import make_encounter_table
from simulator.arenas.scenarios import find_scenario
from simulator.presets import find_preset
from simulator.world import World
from studies.cut import COLUMNS, Cut, store_cut

_PRESET, _SCENARIO = "paper-units", "two-obstacles"
_NS_PER_S = 1e9
_ENCOUNTERS_PER_S = 11.0  # of this preset, measured; a guess too low costs another round, nothing else


def cut_run(sizes: Iterable[int], *, seed: int, directory: Path, tell: Callable[[str], None]) -> dict[int, Path]:
    """Make sure that the tables of these sizes are in a directory: by size the file of each.

    Parameters
    ----------
    sizes
        Numbers of encounters; of one seed, a smaller table is the beginning of a larger one.
    tell
        Told what goes on.
    """
    paths = {size: directory / f"{_PRESET}-{_SCENARIO}-seed{seed}-{size}.npz" for size in sorted(set(sizes))}
    missing = [size for size in paths if not paths[size].exists()]
    if missing:
        directory.mkdir(parents=True, exist_ok=True)
        columns, landmarks = _simulate(max(missing), seed=seed, tell=tell)
        for size in missing:
            table = make_encounter_table(**{name: column[:size] for name, column in columns.items()})
            store_cut(Cut(table=table, landmarks=landmarks), paths[size])
    return paths


def _simulate(n: int, *, seed: int, tell: Callable[[str], None]) -> tuple[dict[str, IntArray], IntArray]:
    """Walk until n encounters have ended: their columns in order of their ends, and the landmarks."""
    preset = find_preset(_PRESET)
    world = World(
        find_scenario(_SCENARIO).build(preset.side),
        motion=preset.motion,
        ranges=preset.ranges,
        ids=range(1, preset.biobots + 1),
        seed=seed,
        keeps_legs=False,
    )
    landmarks = sorted(select_landmarks(world.adjacency(), count=preset.landmarks))
    for landmark in landmarks:
        world.stop(landmark)
    parts: list[tuple[IntArray, ...]] = []
    ended = 0
    while ended < n:
        tell(f"insects walk: {ended:,} of {n:,} encounters")
        run = world.run(world.now_s + max(60.0, (n - ended) / _ENCOUNTERS_PER_S)).ended
        begin, end = (np.rint(times * _NS_PER_S).astype(np.int64) for times in (run.t_start_s, run.t_end_s))
        parts.append((begin, end, run.id1.astype(np.int64), run.id2.astype(np.int64)))
        ended += len(begin)
    columns = dict(zip(COLUMNS, (np.concatenate(column) for column in zip(*parts, strict=True)), strict=True))
    order = np.lexsort((columns["id2"], columns["id1"], columns["t_start_ns"], columns["t_end_ns"]))
    return {name: column[order] for name, column in columns.items()}, np.array(landmarks, dtype=np.int64)
