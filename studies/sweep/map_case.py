"""One case of a sweep: simulate a run, map it, and count what the map says beside the truth."""

import tempfile
import time
from pathlib import Path

import msgspec

from mapper.config import make_recipe
from mapper.encounter_csv import read_encounters, read_modes
from mapper.pipeline import MIN_ENCOUNTERS, compute_map
from mapper.types import EncounterTable, ModeSpell
from simulator.expedition import Expedition
from simulator.sensed_run import sensing_config
from studies.sweep.case import Cell, SweepCase, recipe_config, run_config
from studies.trials import SETTINGS, simulate

Betti = tuple[int, int]
"""Number of components, and number of holes."""


class CaseResult(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a case.

    Parameters
    ----------
    true_betti
        Of the arena as it is at first.
    map_betti
        Of the map; None where too few met for a map.
    n_encounters
        All that count.
    simulate_s, map_s
        What the computing took [s].
    """

    true_betti: Betti
    map_betti: Betti | None
    n_encounters: int
    simulate_s: float
    map_s: float


def compute_case(case: SweepCase) -> CaseResult:
    """Simulate and map one run, as ``biobot-sim run`` and ``biobot-mapper run`` would."""
    began_s = time.perf_counter()
    name = case.cell.get("run.setting")
    if name is None:
        table, spells, true_betti = _explore(case.cell, seed=case.seed)
    else:
        table, spells, holes = simulate(SETTINGS[name], case.seed)
        true_betti = (1, holes)  # every arena of a setting is in one piece
    simulated_s = time.perf_counter()
    map_betti = None
    if len(table) >= MIN_ENCOUNTERS:
        map_betti = compute_map(table, spells, make_recipe(recipe_config(case.cell))).betti_numbers
    return CaseResult(
        true_betti=true_betti,
        map_betti=map_betti,
        n_encounters=len(table),
        simulate_s=round(simulated_s - began_s, 6),
        map_s=round(time.perf_counter() - simulated_s, 6),
    )


def _explore(cell: Cell, *, seed: int) -> tuple[EncounterTable, tuple[ModeSpell, ...], Betti]:
    """Let a run happen, and read what it leaves behind as the mapper does."""
    config = msgspec.structs.replace(run_config(cell, seed=seed), position_samples=2)
    expedition = Expedition(config)
    expedition.advance(expedition.total_s)
    setting = expedition.setting
    sensed = expedition.sense(sensing_config(config, setting)) if config.sensing == "beacon" else None
    files = expedition.files(sensed=sensed)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("encounters.csv", "modes.csv"):
            (Path(folder) / name).write_bytes(files[name])
        table, spells = read_encounters(Path(folder) / "encounters.csv"), read_modes(Path(folder) / "modes.csv")
    return table, spells, (setting.arena.betti.components, setting.arena.betti.holes)
