"""One version everywhere; what a release is made of is what it says (docs/releasing.md)."""

import json
import os
import platform
import re
import shutil
import signal
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
from scripts.release import reproducible
from scripts.release.bundle import pack, room_needed
from scripts.release.elf import libraries_of, wheel_faults
from scripts.release.lock_file import MACHINES, PYTHONS, Pin, Target, pins_for, read_lock
from scripts.release.machines import Machine, MachineError
from scripts.release.sbom import NOT_SHIPPED, REQUIRED, make_sbom
from scripts.release.version import ROOT, read_version
from scripts.release.wheels import make_sdist
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


def test_what_make_install_takes_is_what_the_bundle_carries_and_nothing_else_stays() -> None:
    """``make install`` takes the locks of the services, and takes away again what only building wants (scripts/services.sh)."""
    locks = {name: {(pin.name, pin.version) for pin in read_lock(ROOT / "requirements" / f"{name}.txt")} for name in ("build", "bundle")}
    installer = (ROOT / "scripts" / "services.sh").read_text()
    script = f"{installer[installer.index('only_in()') : installer.index('install_services()')]}\nonly_in build.txt bundle.txt"
    listed = subprocess.run(["sh", "-c", script], cwd=ROOT / "requirements", capture_output=True, text=True, check=True).stdout.split()
    assert set(listed) == {name for name, _ in locks["build"]} - {name for name, _ in locks["bundle"]}
    assert "hatchling" in listed
    for service in ("gateway", "mapper", "simulator"):
        pins = {(pin.name, pin.version) for pin in read_lock(ROOT / "requirements" / f"{service}.txt")}
        assert {pin for pin in pins if pin[0] not in listed} <= locks["bundle"], service


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


def test_the_room_that_is_asked_for_is_that_of_the_largest_installation(tmp_path: Path) -> None:
    """numpy: 2 MB as they are, and 1 MB of Python that is compiled beside: 4 MB. zenoh: 3 MB, on one of two machines."""
    for folder in ("wheels", "requirements"):
        (tmp_path / folder).mkdir()
    for name, files in (("numpy-2.0-cp311-none-any.whl", {"a.so": 2, "b.py": 1}), ("zenoh-1.0-py3-none-any.whl", {"c.so": 3})):
        with zipfile.ZipFile(tmp_path / "wheels" / name, "w") as wheel:
            for path, n_megabytes in files.items():
                wheel.writestr(path, bytes(n_megabytes * 1_000_000))
    (tmp_path / "requirements" / "3.11-x86_64.txt").write_text("numpy==2.0 --hash=x\nzenoh==1.0 --hash=y\n")
    (tmp_path / "requirements" / "3.11-aarch64.txt").write_text("numpy==2.0 --hash=x\n")
    assert room_needed(tmp_path / "wheels", tmp_path / "requirements") == 7 + 20


def test_packing_the_same_folder_twice_makes_the_same_octets(tmp_path: Path) -> None:
    tree = tmp_path / "biobot-1"
    (tree / "wheels").mkdir(parents=True)
    for name in ("wheels/b.whl", "a.txt", "install.sh"):
        (tree / name).write_text(name)
    pack(tree, tmp_path / "one.tar")
    os.utime(tree / "a.txt", (1, 1))
    pack(tree, tmp_path / "two.tar")
    assert (tmp_path / "one.tar").read_bytes() == (tmp_path / "two.tar").read_bytes()


def test_sources_are_packed_into_a_folder_that_is_named_from_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are packed, and wheels built, by processes in other folders; before Python 3.12 temporary folders may have relative names."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    sdist = make_sdist(Path("out"))
    assert sdist == Path("out") / f"biobot_gateway-{read_version()}.tar.gz"
    assert sdist.is_file()


@pytest.mark.campaign
def test_what_is_released_is_the_same_whoever_makes_it_wherever_and_whenever(capsys: pytest.CaptureFixture[str]) -> None:
    """sdist, wheel and bill of materials; `make reproducible` has the others, which want a network."""
    status, told = reproducible.main(["--ours"]), capsys.readouterr().out
    assert status == 0, told
    assert [line.split()[0] for line in told.splitlines() if "biobot_gateway-" in line or "sbom" in line] == ["same"] * 4


def test_what_differs_between_two_makings_is_found(tmp_path: Path) -> None:
    told: list[str] = []
    for name, text in (("a", "one"), ("b", "two")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "same.json").write_text("{}")
        with zipfile.ZipFile(tmp_path / name / "x.whl", "w") as wheel:
            wheel.writestr(zipfile.ZipInfo("package/same.py"), "")
            wheel.writestr(zipfile.ZipInfo("package/differs.py"), text)
    (tmp_path / "a" / "only-one").write_text("")
    assert reproducible.compare(tmp_path / "a", tmp_path / "b", say=told.append) == 2
    assert [line.split()[0] for line in told if not line.startswith(" ")] == ["DIFFERS", "same", "DIFFERS"]
    assert "         in package/differs.py" in told


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
    (folder / "ROOM").write_text("1\n")
    (folder / "requirements" / f"{HERE}.txt").write_text("")
    for script in (INSTALLER, INSTALLER.with_name("fresh_place.sh")):
        (folder / script.name).write_bytes(script.read_bytes())
    _seal(folder)
    return folder


def _seal(folder: Path) -> None:
    done = subprocess.run("sha256sum GLIBC ROOM VERSION *.sh requirements/* > SHA256SUMS", shell=True, cwd=folder, check=True)
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
    assert not (tmp_path / "prefix").exists()


def _program(path: Path, text: str) -> str:
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


def test_a_python_that_is_too_old_is_named_whichever_others_are_looked_for(bundle: Path, tmp_path: Path) -> None:
    code = "import sys; sys.version_info = (3, 10, 2); code = sys.argv[1]; del sys.argv[1]; exec(code)"
    _program(tmp_path / "bin" / "python3", f"""shift 2; exec {sys.executable} -I -c '{code}' "$@" """)
    for name in ("cat", "dirname", "sed"):
        (tmp_path / "bin" / name).symlink_to(shutil.which(name) or name)
    path = str(tmp_path / "bin")
    done = subprocess.run(
        [shutil.which("sh") or "sh", str(bundle / "install.sh"), "--check"], env={"PATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "python3: it is Python 3.10, and 3.11 to 3.14 are wanted" in done.stderr
    assert "--python names a Python that is elsewhere" in done.stderr


def test_a_disk_that_is_too_small_is_told_of_before_anything_is_made(bundle: Path, tmp_path: Path) -> None:
    (bundle / "ROOM").write_text("999999999\n")
    _seal(bundle)
    done = _install(bundle, "--python", sys.executable, "--prefix", str(tmp_path / "prefix"))
    assert done.returncode == 1
    assert f"MB are free at {tmp_path}, and an installation takes 999999999 MB: make room, or name a folder on another disk" in done.stderr
    assert not (tmp_path / "prefix").exists()


def test_a_folder_in_which_a_file_is_missing_is_unpacked_anew(bundle: Path) -> None:
    (bundle / "GLIBC").unlink()
    done = _install(bundle, "--check")
    assert (done.returncode, done.stdout) == (1, "")
    assert f"there is no GLIBC in {bundle}: unpack the archive anew" in done.stderr


def test_what_a_killed_installation_left_is_removed_by_the_next(bundle: Path, tmp_path: Path) -> None:
    """Its Python kills the installer where a virtual environment is to be made, as a loss of power would."""
    kill = f"""case "$*" in *" venv "*) kill -KILL $PPID; exit;; *) exec {sys.executable} "$@";; esac"""
    deadly, prefix = _program(tmp_path / "bin" / "python3", kill), tmp_path / "made" / "prefix"
    killed = _install(bundle, "--python", deadly, "--prefix", str(prefix))
    assert killed.returncode == -signal.SIGKILL
    assert sorted(path.name for path in prefix.iterdir()) == [".9.9.9.unfinished", "9.9.9"]
    done = _install(bundle, "--python", sys.executable, "--prefix", str(prefix))
    assert (done.returncode, "there is no wheel of pip" in done.stderr) == (1, True)
    assert f"an installation into {prefix}/9.9.9 was interrupted; it is removed" in done.stdout
    assert "/proc" not in done.stderr
    assert not (tmp_path / "made").exists(), "folders that the killed one had made stay"


def test_services_are_not_begun_where_they_cannot_be_set_up(bundle: Path, tmp_path: Path) -> None:
    _program(tmp_path / "bin" / "id", "echo 1000")
    command = ["sh", str(bundle / "install.sh"), "--prefix", str(tmp_path / "prefix"), "--python", sys.executable, "--service"]
    environment = os.environ | {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert "wants root: sudo sh install.sh" in done.stderr
    if not Path("/run/systemd/system").exists():
        _program(tmp_path / "bin" / "id", "echo 0")
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (1, "")
        assert "wants a machine that systemd started, and this is none: leave it out" in done.stderr
    assert not (tmp_path / "prefix").exists()


@pytest.mark.parametrize("wrong", [["--prefix"], ["--frefix", "/x"], ["here"]])
def test_options_that_the_installer_does_not_know_are_refused(bundle: Path, wrong: list[str]) -> None:
    assert _install(bundle, *wrong).returncode == 2
