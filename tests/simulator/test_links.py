"""Links between places are as the slow obvious version finds them, few places or many; and few do without SciPy."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.links import links_within

SIDE = 7.0


def _obvious(places: list[tuple[float, float]], *, radius: float, side: float | None) -> dict[int, set[int]]:
    def apart(one: float, other: float) -> float:
        return abs(one - other) if side is None else min(abs(one - other + turns * side) for turns in (-2, -1, 0, 1, 2))

    return {
        i: {j for j, (u, v) in enumerate(places) if i != j and math.hypot(apart(x, u), apart(y, v)) <= radius}
        for i, (x, y) in enumerate(places)
    }


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 30, 60, 61, 80]), st.sampled_from([None, SIDE]), st.floats(0.1, 3.0))
def test_links_are_those_of_the_obvious_version_on_a_plane_and_on_a_torus(seed: int, n: int, side: float | None, radius: float) -> None:
    places = np.random.default_rng(seed).uniform(-SIDE / 2, SIDE, size=(n, 2))
    found = links_within(places, radius=radius, ids=range(n), side=side)
    assert found == _obvious([(x, y) for x, y in places.tolist()], radius=radius, side=side)


@pytest.mark.parametrize("module", ["simulator.serve", "simulator.run"])
def test_no_simulator_imports_scipy_before_something_wants_it(module: str) -> None:
    """It takes as long as all else of a simulator."""
    script = f"import sys, {module}; print(sorted(name for name in sys.modules if name.partition('.')[0] in ('scipy', 'matplotlib')))"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "[]\n"
