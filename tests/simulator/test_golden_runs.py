"""Laws of sameness: a run's bytes are pinned, whatever the machine, the Python, the compiler and its optimisation.

Where a change of the model is meant to change runs, the digests change with it: a failing test prints the new ones. Nothing else may.
"""

import hashlib
from pathlib import Path

import pytest

from simulator.config import RunConfig
from simulator.run import run

# SHA-256 of encounters.csv and modes.csv of two-obstacles, seed 1, everything else as in the preset.
DIGESTS = {
    "paper-units": (
        "81ba93bd035f8947a4dea98b1c1d865e56382329b26b1d642e4746de92755dd0",
        "a04c141841bb98480dabadf5559147862b265428577d8e795c45bb8819346ef8",
    ),
    "jeanson-larva": (
        "0f6a61929766fd4313e50682a0521f3aa1a906559ffa251b6e6a994b761549ed",
        "4032237bcbf7923f26d826052c02e0ebb42cd7d1308d5e305cb4af28b1add078",
    ),
    "hisser-field": (
        "f470c07899b2032db1d47000acade964f8130df3bb39ef1b5337c22057b64fda",
        "8571673ffb4408f1c544a3d679c91f6fb958aa35ec932b5b739ae1660b5321d6",
    ),
}


@pytest.mark.parametrize("preset", DIGESTS)
def test_a_run_has_the_same_bytes_everywhere(preset: str, tmp_path: Path) -> None:
    run(RunConfig(scenario="two-obstacles", preset=preset, seed=1, out=str(tmp_path / "out")))
    found = tuple(hashlib.sha256((tmp_path / "out" / name).read_bytes()).hexdigest() for name in ("encounters.csv", "modes.csv"))
    assert found == DIGESTS[preset]
