"""What a machine without a C compiler gets, and what happens with one that does not work, or with libraries left from before."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import hatch_build
from tests.mapper.worlds import NS, walk_track

pytestmark = pytest.mark.xdist_group("build")
"""What they share is made once, by one worker."""

ROOT = Path(__file__).parents[1]
BUILD = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"

Ran = subprocess.CompletedProcess[str]


def _build(folder: Path, **variables: str) -> Ran:
    """Build a wheel where no program can be found but Python itself."""
    nothing = folder / "no-programs"
    nothing.mkdir()
    environment = {name: value for name, value in os.environ.items() if name != "CC"} | {"PATH": str(nothing)} | variables
    return subprocess.run(
        [sys.executable, "-c", BUILD, str(folder)], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )


def _run(installed: Path, *arguments: object, **variables: str) -> Ran:
    """Run a module of an installed tree, in an empty folder."""
    environment = {name: value for name, value in os.environ.items() if name != "BIOBOT_KERNELS"} | {"PYTHONPATH": str(installed)}
    command = [sys.executable, "-P", "-m", *map(str, arguments)]
    return subprocess.run(command, cwd=installed.parent, env=environment | variables, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a wheel without a compiler."""
    folder = tmp_path_factory.mktemp("wheel")
    built = _build(folder)
    assert built.returncode == 0, built.stderr
    assert "no C compiler" in built.stderr
    return folder / built.stdout.splitlines()[-1]


@pytest.fixture
def installed(wheel: Path, tmp_path: Path) -> Path:
    """A folder with what is in that wheel."""
    with zipfile.ZipFile(wheel) as content:
        content.extractall(tmp_path / "site")
    return tmp_path / "site"


@pytest.fixture(scope="module")
def encounters(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with the encounters of a ring."""
    rows, _ = walk_track(n_landmarks=20, n_walkers=10, duration_s=60, seed=1, is_ring=True)
    path = tmp_path_factory.mktemp("ring") / "encounters.csv"
    lines = [f"{max(start, 0) / NS:.3f},{max(end, 0) / NS:.3f},{first},{second}\n" for start, end, first, second in rows]
    path.write_text("t_start_s,t_end_s,id1,id2\n" + "".join(lines))
    return path


def test_without_a_compiler_the_wheel_is_for_every_machine_and_holds_no_library(wheel: Path) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert not [name for name in names if name.endswith(".so")]
    assert "mapper/kernels/plain.py" in names


def test_the_wheel_holds_what_a_firmware_engineer_needs(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = (path.relative_to(ROOT) for path in (ROOT / "firmware_protocol").rglob("*.[ch]"))
    assert {str(path) for path in sources} | {"firmware_protocol/WIRE_FORMAT.md", "firmware_protocol/vectors/uplink.json"} <= names


def test_without_a_compiler_the_mapper_makes_the_same_map_and_says_that_it_is_slow(installed: Path, encounters: Path) -> None:
    flags = ("run", encounters, "--stationary", ",".join(str(1001 + k) for k in range(20)), "--json", "-")
    plain, compiled = _run(installed, "mapper", *flags), _run(ROOT, "mapper", *flags, BIOBOT_KERNELS="compiled")
    assert (plain.returncode, compiled.returncode, compiled.stderr) == (0, 0, ""), plain.stderr + compiled.stderr
    assert json.loads(plain.stdout)["betti_numbers"] == [1, 1]
    assert plain.stdout == compiled.stdout
    (warning,) = plain.stderr.splitlines()
    assert warning.startswith("biobot-mapper: warning: plain kernels")
    assert "install gcc and libc6-dev" in warning


def test_without_a_compiler_the_simulator_says_what_it_lacks(installed: Path, tmp_path: Path) -> None:
    done = _run(installed, "simulator", "run", "--scenario", "two-obstacles", "--seed", 1, "--out", tmp_path / "out")
    assert (done.returncode, done.stdout) == (1, "")
    assert "the simulator's engine cannot be loaded" in done.stderr
    assert "install the package again where there is a C compiler" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_compiler_that_does_not_work_ends_the_build_and_says_what_to_do(tmp_path: Path) -> None:
    built = _build(tmp_path, CC=shutil.which("false") or "/bin/false")
    assert built.returncode == 1
    assert "_engine.so does not compile" in built.stderr
    assert "install gcc and libc6-dev, or set CC" in built.stderr
    assert not list(tmp_path.glob("*.whl"))


def test_a_compiler_that_is_not_there_ends_the_build_too(tmp_path: Path) -> None:
    built = _build(tmp_path, CC="no-such-compiler")
    assert built.returncode == 1
    assert "no-such-compiler" in built.stderr
    assert "Traceback" not in built.stderr


@pytest.mark.skipif(hatch_build.find_compiler() is None, reason="no C compiler here: install gcc and libc6-dev")
def test_libraries_of_other_sources_are_not_used(installed: Path, encounters: Path, tmp_path: Path) -> None:
    compiler = hatch_build.find_compiler()
    assert compiler is not None
    for library in (hatch_build.KERNELS, hatch_build.ENGINE):
        hatch_build.compile_library(installed, library, compiler=compiler)
    assert (_run(installed, "mapper", "run", encounters).returncode, _run(installed, "simulator", "scenarios").returncode) == (0, 0)
    for library in (hatch_build.KERNELS, hatch_build.ENGINE):
        header = next((installed / library).parent.glob("*.h"))
        header.write_text(header.read_text() + "/* a newer one */\n")

    automatic, demanded = (
        _run(installed, "mapper", "run", encounters),
        _run(installed, "mapper", "run", encounters, BIOBOT_KERNELS="compiled"),
    )
    simulated = _run(installed, "simulator", "run", "--scenario", "two-obstacles", "--seed", 1, "--out", tmp_path / "out")

    assert automatic.returncode == 0
    assert "built from other sources than are installed" in automatic.stderr
    assert (demanded.returncode, demanded.stdout) == (1, "")
    assert demanded.stderr.startswith("biobot-mapper: error: no compiled kernels: ")
    assert simulated.returncode == 1
    assert "built from other sources than are installed" in simulated.stderr


def test_half_a_library_is_not_used(installed: Path, encounters: Path) -> None:
    (installed / hatch_build.KERNELS).write_bytes(b"\x7fELF of a copy that was cut short")
    done = _run(installed, "mapper", "run", encounters)
    assert done.returncode == 0
    assert "plain kernels" in done.stderr
