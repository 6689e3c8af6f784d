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
        "70a192e962b85044d1ec709eb7f0971513abd4aca28d47b1f68624e9ca7fdc40",
        "1b3f79135a26521c26da5b7c0a54d857a920a55032fc8ccd2aca77f33e09f977",
    ),
    "hisser-field": (
        "73ac4a45e6ccfe4df9393017fcfb50a2160ee4ef26e680f8ac2ce3e5db80e09b",
        "840a76fa1c7114553c869e1be270be8b59bdd53dcbe9c4d0e2455b9a72e44d93",
    ),
}


@pytest.mark.parametrize("preset", DIGESTS)
def test_a_run_has_the_same_bytes_everywhere(preset: str, tmp_path: Path) -> None:
    run(RunConfig(scenario="two-obstacles", preset=preset, seed=1, out=str(tmp_path / "out")))
    found = tuple(hashlib.sha256((tmp_path / "out" / name).read_bytes()).hexdigest() for name in ("encounters.csv", "modes.csv"))
    assert found == DIGESTS[preset]
