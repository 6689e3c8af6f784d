"""Small runs on disk, for whoever reads them."""

import json
from pathlib import Path

import numpy as np

from simulator.config import RunConfig
from simulator.pictures.recorded_run import RecordedRun, read_run
from simulator.run import run


def make_run(out: Path, *, scenario: str = "two-obstacles", preset: str = "paper-units", samples: int = 21) -> Path:
    """Let 40 insects walk for 20 s."""
    run(
        RunConfig(
            scenario=scenario, preset=preset, seed=3, biobots=40, landmarks=6, duration_s=20.0, out=str(out), position_samples=samples
        )
    )
    return out


def change_description(directory: Path, **changed: object) -> None:
    """Write other values into a run's ``run.json``."""
    path = directory / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))


def change_truth(directory: Path, **changed: np.ndarray) -> None:
    """Write other arrays into a run's ``truth.npz``."""
    with np.load(directory / "truth.npz") as archive:
        arrays = dict(archive)
    np.savez(directory / "truth.npz", **(arrays | changed))


def square_ring(x: float, y: float, side: float) -> list[list[float]]:
    """Return a closed ring."""
    return [[x, y], [x + side, y], [x + side, y + side], [x, y + side], [x, y]]


def run_with_a_door_that_closes(directory: Path) -> RecordedRun:
    """Let one of two obstacles go away at 12 s, in a run made before."""
    geometry = {"type": "Polygon", "coordinates": [square_ring(0, 0, 50), square_ring(8, 8, 13)[::-1]]}
    change_description(directory, arena_changes=[{"at_s": 12.0, "arena": geometry}])
    return read_run(directory)
