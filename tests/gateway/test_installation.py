"""Services that are installed below a folder: what an installation, an upgrade and a removal leave of what was there."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.__main__ import main
from gateway.installation.changes import AppliedChanges
from gateway.installation.layout import SERVICES, Wishes, choose_services, default_configuration
from gateway.installation.plan import plan_installation, plan_removal
from gateway.installation.record import read_record
from mapper.__main__ import main as mapper_main

SOURCE = Path(__file__).parents[2]
ALL = "gateway,mapper,router"
UNITS = Path("etc/systemd/system")


def tree_of(root: Path) -> dict[str, object]:
    """Return all that is below a folder: contents of files, targets of links, None for folders."""
    return {
        str(path.relative_to(root)): path.readlink() if path.is_symlink() else path.read_bytes() if path.is_file() else None
        for path in sorted(root.rglob("*"))
    }


def make_programs(root: Path, version: str) -> Path:
    """Make what a virtual environment of a version looks like from outside."""
    programs = root / "opt" / "biobot" / version
    (programs / "bin").mkdir(parents=True)
    (programs / "pyvenv.cfg").write_text("home = /usr/bin\n")
    for program in ("biobot-gateway", "biobot-mapper"):
        (programs / "bin" / program).write_text("#!/bin/sh\n")
    return programs


def install(root: Path, *flags: str, programs: str = "/opt/biobot/1") -> int:
    return main(["install-service", "--root", str(root), "--programs", programs, *flags])


def uninstall(root: Path, *flags: str) -> int:
    return main(["uninstall-service", "--root", str(root), *flags])


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A system with some things of its own."""
    root = tmp_path / "root"
    for folder in ("etc/systemd/system", "etc/ssh", "usr/bin", "opt"):
        (root / folder).mkdir(parents=True)
    (root / "etc/ssh/config").write_text("Port 22\n")
    (root / "etc/systemd/system/other.service").write_text("[Service]\nExecStart=/bin/true\n")
    return root


@pytest.mark.parametrize("services", ["gateway", "mapper", "router", "gateway,mapper", ALL])
def test_what_is_installed_and_removed_was_never_there(root: Path, services: str) -> None:
    before = tree_of(root)
    assert install(root, "--services", services) == 0
    units = {f"biobot-{name}.service" for name in services.split(",")}
    assert {path.name for path in (root / UNITS).glob("biobot-*")} == units
    assert {path.name for path in (root / UNITS / "multi-user.target.wants").iterdir()} == units
    assert uninstall(root) == 0
    assert tree_of(root) == before


def test_installed_twice_is_installed_once(root: Path) -> None:
    install(root, "--services", ALL)
    once = tree_of(root)
    assert install(root, "--services", "mapper") == 0
    assert tree_of(root) == once


def test_units_and_links_name_the_programs_and_an_upgrade_those_of_the_new_version(root: Path) -> None:
    make_programs(root, "1")
    make_programs(root, "2")
    for version in ("1", "2"):
        assert main(["install-service", "--root", str(root), "--programs", str(root / "opt/biobot" / version)]) == 0
        unit = (root / UNITS / "biobot-gateway.service").read_text()
        assert f"ExecStart=/opt/biobot/{version}/bin/biobot-gateway run --config /etc/biobot/gateway.toml\n" in unit
        assert (root / "usr/local/bin/biobot-mapper").readlink() == Path(f"/opt/biobot/{version}/bin/biobot-mapper")
    record = read_record(root)
    assert record is not None
    assert (record.programs, record.previous) == ("/opt/biobot/2", "/opt/biobot/1")
    assert uninstall(root) == 0
    assert list((root / "opt").iterdir()) == []


def test_a_configuration_is_never_overwritten_and_a_new_default_lies_beside_it(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    install(root, "--site", "tent", "--name", "b7", "--port", "tcp:10.0.0.2:6638", "--port", "serial:/dev/biobot/a?dialect=znp")
    path = root / "etc/biobot/gateway.toml"
    mine = path.read_text()
    written = tomllib.loads(mine)
    assert (written["site"], written["name"]) == ("tent", "b7")
    assert written["ports"] == ["tcp:10.0.0.2:6638", "serial:/dev/biobot/a?dialect=znp"]
    install(root, "--site", "elsewhere")
    assert path.read_text() == mine
    assert not path.with_name("gateway.toml.new").exists()

    capsys.readouterr()
    install(root, "--services", "router")  # beside a router, a gateway's default is another
    assert path.read_text() == mine
    assert tomllib.loads(path.with_name("gateway.toml.new").read_text())["listen"] == []
    assert "compare it with the new default in /etc/biobot/gateway.toml.new" in capsys.readouterr().out
    again = tree_of(root)
    install(root)
    assert tree_of(root) == again

    uninstall(root)
    assert {path.name for path in (root / "etc/biobot").iterdir()} == {"gateway.toml", "mapper.toml"}  # they name a site
    assert path.read_text() == mine


def test_a_unit_that_was_changed_by_hand_is_kept_aside(root: Path) -> None:
    install(root)
    unit = root / UNITS / "biobot-gateway.service"
    unit.write_text(unit.read_text() + "# mine\n")
    install(root)
    assert "# mine" not in unit.read_text()
    assert (root / "etc/biobot/biobot-gateway.service.edited").read_text().endswith("# mine\n")


def test_what_was_disabled_stays_disabled(root: Path) -> None:
    install(root)
    link = root / UNITS / "multi-user.target.wants/biobot-mapper.service"
    link.unlink()
    install(root, programs="/opt/biobot/2")
    assert not link.is_symlink()
    assert (link.parent / "biobot-gateway.service").is_symlink()


def test_a_command_that_is_somebody_elses_stays(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    theirs = root / "usr/local/bin/biobot-gateway"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("#!/bin/sh\n")
    install(root)
    assert "somebody's own" in capsys.readouterr().out
    uninstall(root, "--purge", "--yes")
    assert theirs.read_text() == "#!/bin/sh\n"


def test_an_installation_that_fails_half_way_changes_nothing(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (root / "etc/biobot").write_text("a file where a folder is to be\n")
    before = tree_of(root)
    assert install(root) == 1
    assert "nothing was changed" in capsys.readouterr().err
    assert tree_of(root) == before


def test_a_dry_run_says_all_and_changes_nothing(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = tree_of(root)
    assert uninstall(root, "--dry-run") == 0
    assert capsys.readouterr().out == f"no service of biobot is installed below {root}\n"
    assert install(root, "--dry-run") == 0
    said = capsys.readouterr().out.splitlines()
    assert tree_of(root) == before
    install(root)
    made = set(tree_of(root)) - set(before)
    assert {line.split(" ")[-1 if line.startswith("make") else 1].removeprefix("/") for line in said} == made
    capsys.readouterr()
    there = tree_of(root)
    assert uninstall(root, "--dry-run") == 0
    assert "remove /etc/systemd/system/biobot-gateway.service" in capsys.readouterr().out.splitlines()
    assert tree_of(root) == there


@pytest.mark.skipif(Path("/etc/biobot").exists(), reason="biobot is installed here: what it does depends on what is configured")
def test_a_dry_run_on_this_machine_makes_the_checks_of_the_real_run_and_changes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Programs where no unit can start them, a gateway without a radio, a page's port that somebody has: each told, in one round."""
    programs = tmp_path / "programs"
    programs.symlink_to(sys.prefix)
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):  # somebody else has it: as well
            held.enter_context(socket.create_server(("127.0.0.1", 8080)))
        assert main(["install-service", "--dry-run", "--programs", str(programs)]) == 1
    told = capsys.readouterr()
    assert f"would be refused: {programs}/bin/python: units do not see what is in" in told.err or "may not enter it" in told.err
    assert (
        "biobot-gateway.service would not be started: biobot-gateway: /etc/biobot/gateway.toml: no radio: name at least one with --port"
        in told.out
    )
    assert "mapper is to listen on 127.0.0.1:8080: another program has it; end what listens there" in told.out
    assert "write /etc/biobot/gateway.toml" in told.out
    assert not Path("/etc/biobot").exists()
    assert main(["install-service", "--dry-run", "--programs", str(tmp_path / "nowhere"), "--port", "tcp:127.0.0.1:1"]) == 1
    assert f"would be refused: {tmp_path}/nowhere/bin/biobot-gateway: is not there; install the wheel" in capsys.readouterr().err


def test_data_stay_unless_they_are_to_go_and_then_somebody_must_agree(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    install(root)
    journal = root / "var/lib/biobot/gateway/biobot-gateway.sqlite"
    journal.parent.mkdir()
    journal.write_bytes(b"records")
    assert uninstall(root, "--purge") == 1
    assert "give --yes" in capsys.readouterr().err
    uninstall(root)
    assert journal.read_bytes() == b"records"
    install(root)
    uninstall(root, "--purge", "--yes")
    assert not (root / "var/lib/biobot").exists()


@pytest.mark.parametrize(
    ("flags", "reason"),
    [(["--services", "gatway"], "there is no service 'gatway'"), (["--services", ""], "there is no service ''")],
)
def test_a_service_that_there_is_not_is_named(root: Path, capsys: pytest.CaptureFixture[str], flags: list[str], reason: str) -> None:
    assert install(root, *flags) == 1
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize("services", ["gateway", ALL])
def test_an_installation_that_was_killed_anywhere_is_completed_by_the_next_and_removed_without_a_trace(root: Path, services: str) -> None:
    (root / "var/lib").mkdir(parents=True)
    before, pristine = tree_of(root), root.with_name("pristine")
    shutil.copytree(root, pristine, symlinks=True)
    wishes = Wishes(services=choose_services(services), programs=PurePosixPath("/opt/biobot/1"), site="tent")
    changes = plan_installation(root, wishes, record=None, version="1").changes
    install(root, "--services", services, "--site", "tent")
    whole = tree_of(root)
    for n_made in range(len(changes)):
        shutil.rmtree(root)
        shutil.copytree(pristine, root, symlinks=True)
        AppliedChanges(changes[:n_made], root=root)
        assert install(root, "--services", services, "--site", "tent") == 0
        # The record may know of a folder less: the one that it is in, which goes in any case.
        differ = {path for path, _ in tree_of(root).items() ^ whole.items()}
        assert differ <= {"var/lib/biobot/installed.json"}, f"killed after {n_made} of {len(changes)} changes"
        assert uninstall(root, "--purge", "--yes") == 0
        assert tree_of(root) == before, f"killed after {n_made} of {len(changes)} changes"


def test_a_removal_that_was_killed_anywhere_is_completed_by_the_next(root: Path) -> None:
    (root / "var/lib").mkdir(parents=True)
    before, installed = tree_of(root), root.with_name("installed")
    install(root, "--services", ALL)
    shutil.copytree(root, installed, symlinks=True)
    changes = plan_removal(root, record=read_record(root), purges=False).changes
    for n_made in range(len(changes)):
        shutil.rmtree(root)
        shutil.copytree(installed, root, symlinks=True)
        AppliedChanges(changes[:n_made], root=root)
        assert uninstall(root) == 0
        assert tree_of(root) == before, f"killed after {n_made} of {len(changes)} changes"


def test_folders_that_were_made_for_the_programs_go_with_them(root: Path) -> None:
    """An image may have no /opt; the installer, which makes the virtual environment, says which folders above it are its own."""
    (root / "opt").rmdir()
    before = tree_of(root)
    (make_programs(root, "1") / "folders-made").write_text("/opt\n/opt/biobot\n")
    install(root, programs="/opt/biobot/1")
    (make_programs(root, "2") / "folders-made").write_text("")
    install(root, programs="/opt/biobot/2")
    assert uninstall(root) == 0
    assert tree_of(root) == before


def test_make_uninstall_takes_all_out_of_an_image_and_what_an_interrupted_installation_left_there(tmp_path: Path) -> None:
    """scripts/services.sh: one version is recorded, one never came up, one was killed half way, which is all that the last one is."""
    root = tmp_path / "image"
    root.mkdir()
    for version in ("1", "2", "3"):
        programs = make_programs(root, version)
        (programs / "bin" / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
        (programs / "bin" / "python").chmod(0o755)
        (programs / "bin" / "biobot-gateway").chmod(0o755)
        (programs / "folders-made").write_text("/opt\n/opt/biobot\n" if version == "1" else "")
    (root / "opt/biobot/3/bin/biobot-gateway").unlink()
    (root / "opt/biobot/.3.unfinished").write_text("999999999\n/opt/biobot\n")
    install(root, programs="/opt/biobot/1")
    environment = os.environ | {"DESTDIR": str(root), "PYTHONPATH": str(SOURCE)}
    done = subprocess.run(
        ["sh", str(SOURCE / "scripts" / "services.sh"), "uninstall"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert tree_of(root) == {}


def test_what_is_installed_can_be_read_by_the_services_whatever_the_umask(root: Path) -> None:
    before = os.umask(0o077)
    try:
        install(root)
    finally:
        os.umask(before)
    record = read_record(root)
    assert record is not None
    for path in ("etc/biobot", "etc/biobot/gateway.toml", *(name.removeprefix("/") for name in record.folders)):
        assert (root / path).stat().st_mode & 0o005 == (0o005 if (root / path).is_dir() else 0o004), path


@pytest.mark.parametrize("flags", [[], ["--dry-run"]])
def test_below_a_root_this_programs_own_folder_is_never_taken_for_the_installed_systems(
    root: Path, flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = tree_of(root)
    assert main(["install-service", "--root", str(root), *flags]) == 1
    said = capsys.readouterr()
    assert f"{sys.prefix}: is not below {root}; name the folder of programs" in said.err
    assert "--programs /opt/biobot/" in said.err
    assert (said.out, tree_of(root)) == ("", before)


@pytest.mark.parametrize("flags", [[], ["--dry-run"]])
def test_programs_that_are_not_there_are_named_with_what_is_to_be_done(
    root: Path, flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert install(root, *flags) == 0
    said = capsys.readouterr().err
    for program in ("biobot-gateway", "biobot-mapper"):
        assert f"warning: /opt/biobot/1/bin/{program} is not there below {root}, and units are to start it: install the wheel" in said
    make_programs(root, "1")
    install(root, *flags)
    assert capsys.readouterr().err == ""


def test_a_damaged_record_says_what_to_do(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    install(root)
    (root / "var/lib/biobot/installed.json").write_text("{")
    assert install(root) == 1
    assert "remove it, and install again" in capsys.readouterr().err


@pytest.mark.parametrize("services", [("gateway",), ("router", "gateway", "mapper")])
def test_the_default_configurations_are_valid_and_do_not_get_into_each_others_way(
    tmp_path: Path, services: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    listens: list[str] = []
    for name in services:
        path = tmp_path / f"{name}.toml"
        path.write_text(default_configuration(name, services=services))
        written = tomllib.loads(path.read_text())
        listens += written.get("listen", [])
        command: Callable[[list[str]], int] = mapper_main if name == "mapper" else main
        flags = ["--port", "tcp:127.0.0.1:7"] if name == "gateway" else []
        assert command([*SERVICES[name].check, "--config", str(path), "--check-config", *flags]) == 0, capsys.readouterr().err
    assert len(listens) == len(set(listens)) == 1


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("install"), st.sampled_from(["gateway", "mapper", "router", ALL]), st.sampled_from(["1", "2", "3"])),
        st.tuples(st.sampled_from(["edit", "disable"]), st.sampled_from(sorted(SERVICES)), st.just("")),
        st.tuples(st.just("uninstall"), st.just(""), st.just("")),
    ),
    max_size=6,
)


@pytest.fixture(scope="module")
def places() -> Iterator[Path]:
    """A folder for many systems."""
    with tempfile.TemporaryDirectory() as place:
        yield Path(place)


@given(steps=STEPS)
@settings(max_examples=20, deadline=None)
def test_whatever_was_done_before_a_removal_leaves_what_people_made_and_a_purge_nothing(
    places: Path, steps: list[tuple[str, str, str]]
) -> None:
    root = places / "root"
    shutil.rmtree(root, ignore_errors=True)
    (root / "etc").mkdir(parents=True)
    before = tree_of(root)
    edited: set[str] = set()
    for what, services, version in steps:
        if what == "install":
            assert install(root, "--services", services, programs=f"/opt/biobot/{version}") == 0
        elif what == "uninstall":
            assert uninstall(root) == 0
        elif what == "edit" and (path := root / f"etc/biobot/{services}.toml").exists():
            path.write_text(path.read_text() + "# mine\n")
            edited.add(f"etc/biobot/{services}.toml")
        elif what == "disable":
            (root / UNITS / "multi-user.target.wants" / SERVICES[services].unit).unlink(missing_ok=True)
    assert uninstall(root) == 0
    after = tree_of(root)
    assert {path for path, content in after.items() if content is not None} == edited
    assert uninstall(root, "--purge", "--yes") == 0
    assert tree_of(root) == before
