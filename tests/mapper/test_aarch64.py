"""The kernels on a 64-bit ARM processor, which an emulator plays: the same numbers as here, to the last bit."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import hatch_build
from mapper.kernels import Contraction, Stands, Tension
from mapper.kernels.binding import SPELL
from mapper.types import FloatArray, ProfileNorm
from tests.mapper.graphs import KERNELS

ROOT = Path(__file__).parents[2]
COMPILER, EMULATOR, LIBRARIES = "aarch64-linux-gnu-gcc", "qemu-aarch64", "/usr/aarch64-linux-gnu"
N_ENCOUNTERS, N_LANDMARKS, N_NEIGHBOURS, N_POINTS = 4000, 12, 10, 60

Arrays = dict[str, NDArray[np.generic]]


def _crowd() -> tuple[Arrays, Stands, Stands]:
    """Biobots that meet at random, in some thousands of ticks: landmarks that stand all the time, and walkers that stop for moments."""
    rng = np.random.default_rng(8)
    last = 4_000_000
    # One of the two walks: landmarks that met would share a vertex.
    pairs = np.sort(np.array([rng.choice(np.arange(1, 61), 2, replace=False) for _ in range(N_ENCOUNTERS)]), axis=1)
    pairs[:, 1] = np.where(pairs[:, 1] <= N_LANDMARKS, 60, pairs[:, 1])
    columns: Arrays = {"centres": rng.integers(0, last, N_ENCOUNTERS), "id1": pairs[:, 0].copy(), "id2": pairs[:, 1].copy()}
    stood = np.arange(1, N_LANDMARKS + 1)
    commanded = Stands(nodes=stood, begins=np.zeros(N_LANDMARKS, dtype=np.int64), ends=np.full(N_LANDMARKS, last))
    stops = [(node, begin, begin + 300) for node in range(N_LANDMARKS + 1, 61) for begin in range(node * 1000, last, 300_000)]
    rows = np.array([*zip(stood, commanded.begins, commanded.ends, strict=True), *stops], dtype=np.int64)
    return columns, Stands(nodes=rows[:, 0], begins=rows[:, 1], ends=rows[:, 2]), commanded


def _spells(stands: Stands) -> NDArray[np.generic]:
    return np.array(list(zip(stands.nodes, stands.begins, stands.ends, strict=True)), dtype=SPELL)


def _expect(graph: Contraction) -> dict[str, NDArray[np.generic]]:
    """Compute here what the driver writes there."""
    kernels = KERNELS[0]
    v = len(graph.component)
    landmarks = np.flatnonzero(graph.is_landmark)
    times: FloatArray = kernels.sweep_times(graph.links, n_vertices=v, sources=landmarks)
    picks = kernels.pick_along_graph(graph.rows, graph.links, np.ones(v, dtype=bool), hubs=landmarks, n_points=N_POINTS)
    middle, doubt = kernels.bracket(times.copy(), landmarks)
    expected: Arrays = {
        "sweep": times,
        "sums": kernels.sum_neighbour_times(graph.rows, graph.multiplicity, k=N_NEIGHBOURS),
        "picks": picks.chosen.astype(np.int32),
        "distances": picks.distances,
        "radius": np.array([picks.cover_radius]),
        "middle": middle,
        "doubt": doubt,
    }
    for norm in ProfileNorm:
        of_norm = kernels.pick_profiles(middle, norm=norm, n_points=N_POINTS)
        expected |= {
            f"{norm}.chosen": of_norm.chosen,
            f"{norm}.distances": of_norm.distances,
            f"{norm}.radius": np.array([of_norm.cover_radius]),
        }
    number = np.arange(v)
    start = np.column_stack([number % 61 * 1000.0, number % 53 * 1000.0])
    pull = np.where(graph.is_landmark, 10.0, 0.5)
    tension = Tension(blur=100.0, swerve=0.25, drift=0.125)
    expected["settled"] = kernels.settle_tracks(graph.links, start, pull, tension=tension, rounds=3, steps=20)
    names = ("first_encounter", "multiplicity", "is_landmark", "component")
    expected |= {name: getattr(graph, name) for name in names}
    expected |= {f"links.{name}": getattr(graph.links, name) for name in ("sources", "targets", "times", "before")}
    return expected | {f"rows.{name}": getattr(graph.rows, name) for name in ("starts", "neighbours", "times")}


@pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None, reason=f"no {COMPILER} or {EMULATOR}: run make system-packages"
)
def test_the_kernels_give_the_same_bytes_on_aarch64(tmp_path: Path) -> None:
    sources = ROOT / hatch_build.KERNELS.parent
    program = tmp_path / "driver"
    flags = [flag for flag in hatch_build.FLAGS if flag != "-shared"]
    command = [COMPILER, *flags, hatch_build.LIBRARIES[hatch_build.KERNELS], "-DSOURCES=0", f"-I{sources}"]
    driver = Path(__file__).with_name("aarch64") / "driver.c"
    built = [*command, str(driver), *map(str, sorted(sources.glob("*.c"))), "-o", str(program), "-lm"]
    subprocess.run(built, check=True, capture_output=True)
    columns, still, commanded = _crowd()
    given: Arrays = columns | {"still": _spells(still), "commanded": _spells(commanded)}
    given["sizes"] = np.array([N_ENCOUNTERS, len(still.nodes), len(commanded.nodes), N_NEIGHBOURS, N_POINTS])
    for name, array in given.items():
        (tmp_path / f"{name}.in").write_bytes(array.tobytes())
    ran = subprocess.run([EMULATOR, "-L", LIBRARIES, str(program), str(tmp_path)], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr

    graph = KERNELS[0].contract(
        *(np.asarray(columns[name], dtype=np.int64) for name in ("centres", "id1", "id2")),
        still=still,
        commanded=commanded,
        moving_time=True,
    )

    expected = _expect(graph)
    assert len(graph.component) > 2000
    assert graph.is_landmark.sum() == N_LANDMARKS
    assert {path.stem for path in tmp_path.glob("*.out")} == expected.keys()
    for name, array in expected.items():
        assert (tmp_path / f"{name}.out").read_bytes() == array.tobytes(), name
