"""One version everywhere; what a release is made of is what it says (docs/releasing.md)."""

import json
import os
import platform
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

import pytest

import gateway.__main__
import mapper.__main__
import simulator.__main__
from scripts.release.bundle import pack
from scripts.release.elf import libraries_of, wheel_faults
from scripts.release.lock_file import MACHINES, PYTHONS, Pin, Target, pins_for, read_lock
from scripts.release.machines import Machine, MachineError
from scripts.release.sbom import NOT_SHIPPED, REQUIRED, make_sbom
from scripts.release.version import ROOT, read_version
from tests.mapper.worlds import NS, walk_track

pytestmark = pytest.mark.xdist_group("release")
"""What they share is made once, by one worker."""

INSTALLER = ROOT / "scripts" / "release" / "install.sh"
HERE = f"{sys.version_info[0]}.{sys.version_info[1]}-{platform.machine()}"

Main = Callable[[Sequence[str]], int]


@pytest.mark.parametrize("main", [gateway.__main__.main, mapper.__main__.main, simulator.__main__.main])
def test_every_program_tells_the_version_of_the_source(main: Main, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out.split()[-1] == read_version()


def test_the_version_is_written_once_and_the_changelog_has_a_section_for_it() -> None:
    assert version("biobot-gateway") == read_version(), "the environment was made of another version: make venv"
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert released[0] == read_version()


@pytest.fixture(scope="module")
def bill() -> str:
    """The bill of materials, as JSON."""
    return json.dumps(make_sbom(others=NOT_SHIPPED))


def test_the_bill_of_materials_names_the_version_and_every_pin(bill: str) -> None:
    document = json.loads(bill)
    assert document["metadata"]["component"]["version"] == read_version()
    required = {(one["name"], one["version"]) for one in document["components"] if one["scope"] == "required"}
    assert required == {(pin.name, pin.version) for pin in read_lock(REQUIRED)}
    assert "axe-core" in {one["name"] for one in document["components"] if one["scope"] == "excluded"}
    sources = {one["name"] for one in document["metadata"]["component"]["components"]}
    assert {"simulator/engine/engine.c", "firmware_protocol/c/biobot_link.c", "mapper/data/classifier.json"} <= sources


def test_the_bill_of_materials_is_of_its_schema(bill: str) -> None:
    validation = pytest.importorskip("cyclonedx.validation.json", reason="cyclonedx-python-lib is not installed: make venv")
    schema = pytest.importorskip("cyclonedx.schema")
    check = validation.JsonStrictValidator(schema.SchemaVersion.V1_6)
    document = json.loads(bill)
    # Components that only development uses are all made alike: a few will do, for each takes the validator 50 ms.
    shipped = [one for one in document["components"] if one["scope"] == "required"]
    others = [one for one in document["components"] if one["scope"] == "excluded"]
    document["components"] = [*shipped, *(one for one in others if one["name"] in {"axe-core", "pytest", "ruff"})]
    assert len(document["components"]) == len(shipped) + 3
    assert check.validate_str(json.dumps(document)) is None
    document["components"] = [{**shipped[0], "scope": "perhaps"}]
    assert check.validate_str(json.dumps(document)) is not None, "a wrong one is told from a right one"


def test_the_bill_of_materials_is_the_same_each_time_and_its_dependencies_are_in_it(bill: str) -> None:
    document = json.loads(bill)
    assert make_sbom(others=NOT_SHIPPED) == document
    known = {one["bom-ref"] for one in (document["metadata"]["component"], *document["components"])}
    needs = {one["ref"]: set(one["dependsOn"]) for one in document["dependencies"]}
    assert set(needs) <= known
    assert set().union(*needs.values()) <= known
    fastapi = next(purl for purl in needs if purl.startswith("pkg:pypi/fastapi@"))
    assert fastapi in needs[document["metadata"]["component"]["bom-ref"]]
    assert any(purl.startswith("pkg:pypi/starlette@") for purl in needs[fastapi])


def test_nothing_that_is_shipped_is_under_the_gpl(bill: str) -> None:
    """LGPL is another matter: python-can, which is imported as it comes."""
    for one in json.loads(bill)["components"]:
        if one["scope"] != "required":
            continue
        told = json.dumps(one.get("licenses", ""))
        assert not re.search(r"(?<!L)GPL|General Public License v", told.replace("Lesser General Public License v", "")), one["name"]


def test_all_lock_files_that_are_installed_together_name_one_version_of_each_package() -> None:
    bundle = {(pin.name, pin.version) for pin in read_lock(REQUIRED) if pin.name != "pip"}
    assert bundle <= {(pin.name, pin.version) for pin in read_lock(ROOT / "requirements" / "dev.txt")}


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("python", PYTHONS)
def test_each_kind_of_machine_gets_one_version_of_each_package_and_one_engine_for_persistence(python: str, machine: str) -> None:
    names = [pin.name for pin in pins_for(read_lock(REQUIRED), Target(python=python, machine=machine))]
    assert len(names) == len(set(names))
    assert [name for name in names if name.endswith("-tda")] == (["redzed-tda"] if machine == "x86_64" else ["holos-tda"])
    assert "gudhi" not in names


def test_a_lock_file_with_something_that_is_not_pinned_is_refused(tmp_path: Path) -> None:
    lock = tmp_path / "lock.txt"
    lock.write_text(f"one==1.0 ; python_full_version < '3.12' \\\n    --hash=sha256:{'0' * 64}\n    # via two\n")
    assert read_lock(lock) == [Pin(name="one", version="1.0", marker='python_full_version < "3.12"', sha256s=("0" * 64,))]
    for wrong in ("one>=1.0 \\\n    --hash=sha256:" + "0" * 64, "one==1.0"):
        lock.write_text(f"{wrong}\n")
        with pytest.raises(ValueError, match="is not pinned with a hash"):
            read_lock(lock)


def test_the_mapper_makes_a_map_where_neither_gudhi_nor_redzed_can_be_imported(tmp_path: Path) -> None:
    """What Linux on ARM has: holos-tda alone."""
    rows, _ = walk_track(n_landmarks=20, n_walkers=10, duration_s=60, seed=1, is_ring=True)
    lines = [f"{max(start, 0) / NS:.3f},{max(end, 0) / NS:.3f},{first},{second}\n" for start, end, first, second in rows]
    (tmp_path / "ring.csv").write_text("t_start_s,t_end_s,id1,id2\n" + "".join(lines))
    flags = ["run", str(tmp_path / "ring.csv"), "--stationary", ",".join(str(1001 + k) for k in range(20)), "--json", "-"]
    blocked = f"""import sys; sys.modules.update(gudhi=None, redzed_tda=None)
from mapper.__main__ import main
from mapper.rips_engines import name_engine
print(name_engine(), file=sys.stderr)
sys.exit(main({flags!r}))"""
    done = subprocess.run([sys.executable, "-c", blocked], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.split()[0]) == (0, "holos-tda"), done.stderr
    assert json.loads(done.stdout)["betti_numbers"] == [1, 1]


def _wheel(path: Path, *, number: int, glibc: str) -> Path:
    header = b"\x7fELF" + bytes(14) + number.to_bytes(2, "little") + bytes(44)
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("package/_native.so", header + f"\0GLIBC_2.2.5\0GLIBC_{glibc}\0".encode())
    return path


def test_a_wheel_whose_library_is_for_another_processor_or_a_newer_system_is_found(tmp_path: Path) -> None:
    fits = _wheel(tmp_path / "a-1-py3-none-manylinux_2_28_aarch64.whl", number=183, glibc="2.28")
    other = _wheel(tmp_path / "b-1-py3-none-manylinux_2_28_aarch64.whl", number=62, glibc="2.17")
    newer = _wheel(tmp_path / "c-1-py3-none-manylinux2014_x86_64.manylinux_2_17_x86_64.whl", number=62, glibc="2.34")
    assert wheel_faults(fits) == []
    assert wheel_faults(other) == [f"{other.name}: package/_native.so is for x86_64"]
    assert wheel_faults(newer) == [f"{newer.name}: package/_native.so wants glibc 2.34"]
    assert [library.glibc for library in libraries_of(newer)] == [(2, 34)], "2.34 is newer than 2.2.5"


def test_packing_the_same_folder_twice_makes_the_same_octets(tmp_path: Path) -> None:
    tree = tmp_path / "biobot-1"
    (tree / "wheels").mkdir(parents=True)
    for name in ("wheels/b.whl", "a.txt", "install.sh"):
        (tree / name).write_text(name)
    pack(tree, tmp_path / "one.tar")
    os.utime(tree / "a.txt", (1, 1))
    pack(tree, tmp_path / "two.tar")
    assert (tmp_path / "one.tar").read_bytes() == (tmp_path / "two.tar").read_bytes()


def test_where_a_release_is_tried_there_is_no_network_but_loopback() -> None:
    machine = Machine(program=sys.executable, python=HERE.split("-", maxsplit=1)[0], processor=platform.machine())
    try:
        usable = subprocess.run(machine.command("true"), capture_output=True, text=True, check=False)
    except (MachineError, FileNotFoundError) as error:
        pytest.skip(f"network namespaces cannot be made here: {error}")
    if usable.returncode != 0:
        pytest.skip(f"network namespaces cannot be made here: {usable.stderr}")
    look = "from scripts.release.inside import expect_no_network; expect_no_network()"
    done = subprocess.run(machine.command(sys.executable, "-c", look), cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """A bundle with everything but wheels: as far as ``install.sh --check`` looks."""
    folder = tmp_path / "biobot-9.9.9"
    (folder / "requirements").mkdir(parents=True)
    (folder / "VERSION").write_text("9.9.9\n")
    (folder / "GLIBC").write_text("2.17\n")
    (folder / "requirements" / f"{HERE}.txt").write_text("")
    (folder / "install.sh").write_bytes(INSTALLER.read_bytes())
    _seal(folder)
    return folder


def _seal(folder: Path) -> None:
    done = subprocess.run("sha256sum GLIBC VERSION install.sh requirements/* > SHA256SUMS", shell=True, cwd=folder, check=True)
    assert done.returncode == 0


def _install(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = ["sh", str(folder / "install.sh"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_bundle_that_is_whole_and_fits_says_so(bundle: Path) -> None:
    done = _install(bundle, "--check", "--python", sys.executable)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"biobot 9.9.9: this folder is whole; {sys.executable} fits ({HERE})" in done.stdout


def test_a_bundle_in_which_one_octet_changed_is_not_installed(bundle: Path, tmp_path: Path) -> None:
    (bundle / "requirements" / f"{HERE}.txt").write_text("x")
    done = _install(bundle, "--python", sys.executable, "--prefix", str(tmp_path / "prefix"))
    assert done.returncode == 1
    assert f"requirements/{HERE}.txt: FAILED" in done.stderr
    assert "error: this folder is not what was packed" in done.stderr
    assert not (tmp_path / "prefix").exists()


def test_the_installer_says_why_no_python_here_will_do(bundle: Path) -> None:
    def told(*arguments: str) -> str:
        done = _install(bundle, "--check", *arguments)
        assert done.returncode == 1, done.stdout
        return done.stderr

    assert "there is no no-such-python" in told("--python", "no-such-python")
    (bundle / "GLIBC").write_text("99.1\n")
    _seal(bundle)
    assert "99.1 or newer is wanted" in told("--python", sys.executable)
    (bundle / "GLIBC").write_text("2.17\n")
    (bundle / "requirements" / f"{HERE}.txt").rename(bundle / "requirements" / "3.11-riscv64.txt")
    _seal(bundle)
    assert f"this bundle has nothing for Python {HERE.split('-', maxsplit=1)[0]}" in told("--python", sys.executable)
    assert "This bundle is for: 3.11-riscv64" in told("--python", sys.executable)


def test_an_installation_that_fails_leaves_nothing_behind(bundle: Path, tmp_path: Path) -> None:
    """There are no wheels in it, not even pip's."""
    done = _install(bundle, "--python", sys.executable, "--prefix", str(tmp_path / "prefix"))
    assert done.returncode != 0
    assert list((tmp_path / "prefix").iterdir()) == []


@pytest.mark.parametrize("wrong", [["--prefix"], ["--frefix", "/x"], ["here"]])
def test_options_that_the_installer_does_not_know_are_refused(bundle: Path, wrong: list[str]) -> None:
    assert _install(bundle, *wrong).returncode == 2
