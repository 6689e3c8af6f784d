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
        "cec2d7181630c68ef8cbe1274c8dcbadde400f8db258daccddebe4db48817c47",
        "ccda332cd28ab4a9c488015f1fd5915c5d1c8f493ecbed9192372ba95e7a84da",
    ),
    "hisser-field": (
        "cf46d2bdf225dd852c800d658f119984164d94e77990c2d843ca3c592464025d",
        "55e3fa7bff450404c5adb684ea0db64a12314330ab61a30399fdda5b02beda6a",
    ),
}


@pytest.mark.parametrize("preset", DIGESTS)
def test_a_run_has_the_same_bytes_everywhere(preset: str, tmp_path: Path) -> None:
    run(RunConfig(scenario="two-obstacles", preset=preset, seed=1, out=str(tmp_path / "out")))
    found = tuple(hashlib.sha256((tmp_path / "out" / name).read_bytes()).hexdigest() for name in ("encounters.csv", "modes.csv"))
    assert found == DIGESTS[preset]
