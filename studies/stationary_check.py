"""How well the nodes that stand still are found, with the landmarks of simulated runs hidden: ``python -m studies.stationary_check``.

Runs in which nobody stands still are among them: whoever is named there is named wrongly.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapper.stationary_search import find_stationary
from mapper.window import select_rows
from studies.trials import HELD_OUT_SEED, SETTINGS, Setting, simulate


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """Of some runs: in how many anybody was named, in how many anybody wrongly; and counts of nodes named rightly, wrongly, and missed."""

    n_runs: int
    n_found: int
    n_wrong_runs: int
    n_right: int
    n_wrong: int
    n_missed: int

    def line(self, name: str) -> str:
        """Tell it in one row of a table."""
        named, standing = self.n_right + self.n_wrong, self.n_right + self.n_missed
        precision = f"{self.n_right / named:.4f}" if named else "-"
        recall = f"{self.n_right / standing:.3f}" if standing else "-"
        return f"{name:36}{self.n_runs:6}{self.n_found:10}{self.n_wrong_runs:14}{precision:>12}{recall:>10}"


def settings() -> dict[str, tuple[Setting, bool]]:
    """Return the settings that are looked at, and whether the landmarks' own encounters are left out, so that all who are left walk."""
    chosen: dict[str, tuple[Setting, bool]] = {}
    for name, setting in SETTINGS.items():
        chosen[name] = (setting, False)
    units, hisser = SETTINGS["squares/paper-units"], SETTINGS["big-square/hisser-field"]
    chosen["squares/paper-units, 4 times as long"] = (replace(units, duration_s=4 * units.duration_s), False)
    chosen["big-square/hisser-field, 3 times"] = (replace(hisser, duration_s=3 * hisser.duration_s), False)
    for name in ("squares/paper-units", "squares/paper-50cm", "big-square/hisser-field", "shapes/long"):
        chosen[f"{name}, all walk"] = (SETTINGS[name], True)
    return chosen


def score(setting: Setting, seeds: Sequence[int], *, all_walk: bool) -> Score:
    """Search in runs of a setting."""
    n_found = n_wrong_runs = n_right = n_wrong = n_missed = 0
    for seed in seeds:
        table, spells, _ = simulate(setting, seed)
        standing = {int(spell.node) for spell in spells}
        if all_walk:
            walks = [
                one not in standing and other not in standing for one, other in zip(table.id1.tolist(), table.id2.tolist(), strict=True)
            ]
            table, standing = select_rows(table, np.array(walks, dtype=np.bool_)), set()
        named = set(find_stationary(table).nodes)
        n_found += bool(named)
        n_wrong_runs += bool(named - standing)
        n_right += len(named & standing)
        n_wrong += len(named - standing)
        n_missed += len(standing - named)
    return Score(n_runs=len(seeds), n_found=n_found, n_wrong_runs=n_wrong_runs, n_right=n_right, n_wrong=n_wrong, n_missed=n_missed)


def main(given: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m studies.stationary_check", description=__doc__)
    parser.add_argument("--runs", type=int, default=50, help="of each setting")
    parser.add_argument("--first-seed", type=int, default=HELD_OUT_SEED, help="thresholds were chosen on 0-139")
    parser.add_argument("--setting", help="only settings whose name holds this")
    args = parser.parse_args(given)
    print(f"{'setting':36}{'runs':>6}{'named in':>10}{'wrong in runs':>14}{'precision':>12}{'recall':>10}")
    for name, (setting, all_walk) in settings().items():
        if args.setting is None or args.setting in name:
            print(score(setting, range(args.first_seed, args.first_seed + args.runs), all_walk=all_walk).line(name), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
