"""``make bundle``: one archive from which biobot is installed where there is no network.

In it are the wheels of all services and of all that they need, for each Python and processor; install.sh (beside this file), which checks
and installs them; pins with hashes for each kind of machine; the bill of materials; licences; SHA256SUMS.
"""

import argparse
import hashlib
import io
import os
import shutil
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

from packaging.utils import canonicalize_name, parse_wheel_filename

from scripts.release.elf import glibc_needed, wheel_faults
from scripts.release.lock_file import MACHINES, PYTHONS, Target, pins_for, read_lock
from scripts.release.sbom import make_sbom, write_sbom
from scripts.release.version import ROOT, read_version, source_moment
from scripts.release.wheels import ReleaseError, build_universal, download_wheels, make_sdist, make_wheel

LOCK = ROOT / "requirements" / "bundle.txt"
_ENVIRONMENT_MB = 20
_README = """biobot {version}, to be installed without a network

    sh install.sh --help
    sudo sh install.sh                          into /opt/biobot/{version}
    sh install.sh --prefix ~/biobot             into a folder of yours
    sudo sh install.sh --service --port serial:/dev/serial/by-id/... --site tent

It wants Linux with glibc {glibc} or newer and one of: {targets} (Python and processor).
wheels/ has biobot and all that it needs, requirements/ which of it each machine takes, licences/ under which terms, sbom.cdx.json a bill of
materials (CycloneDX). SHA256SUMS covers every file and is checked by install.sh; whoever gave you this should have given you the SHA-256 of
the archive itself by another way. The source code of biobot is in biobot_gateway-{version}.tar.gz.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the bundle; 0 where it was made, 1 where something that it needs is not there."""
    options = _parser().parse_args(arguments)
    targets = [Target(python=python, machine=machine) for machine in options.machine for python in options.python]
    options.out.mkdir(parents=True, exist_ok=True)
    # Wheels are built in other folders than this one.
    options.out = options.out.resolve()
    with tempfile.TemporaryDirectory(dir=options.out, prefix=".bundle-") as place:
        try:
            tree = assemble(targets, Path(place))
        except ReleaseError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        archive = options.out / f"{tree.name}-linux.tar"
        pack(tree, archive)
    digest = _sha256(archive)
    archive.with_name(archive.name + ".sha256").write_text(f"{digest}  {archive.name}\n")
    print(f"{archive}: {archive.stat().st_size / 1e6:.0f} MB, {len(targets)} kinds of machine\nSHA-256 {digest}")
    return 0


def assemble(targets: list[Target], place: Path) -> Path:
    """Lay out what goes into the archive in a folder, and return the folder.

    Raises
    ------
    ReleaseError
        A wheel, a compiler or a licence is missing, or a wheel is not what its name says.
    """
    version, pins = read_version(), read_lock(LOCK)
    tree, work = place / f"biobot-{version}", place / "work"
    wheels, requirements = tree / "wheels", tree / "requirements"
    for folder in (work, wheels, requirements):
        folder.mkdir(parents=True)
    sdist = make_sdist(work)
    ours = {machine: make_wheel(sdist, machine=machine, folder=work) for machine in {target.machine for target in targets}}
    build_universal(pins, work)
    universal = list(work.glob("*-none-any.whl"))
    for target in targets:
        downloaded = work / target.name
        downloaded.mkdir()
        needed = pins_for(pins, target)
        download_wheels(needed, target, downloaded)
        names = {canonicalize_name(pin.name) for pin in needed}
        taken = [*downloaded.iterdir(), *(wheel for wheel in universal if _name_of(wheel) in names), ours[target.machine]]
        for wheel in taken:
            shutil.copyfile(wheel, wheels / wheel.name)
        lines = (f"{_name_of(wheel)}=={parse_wheel_filename(wheel.name)[1]} --hash=sha256:{_sha256(wheel)}\n" for wheel in taken)
        (requirements / f"{target.name}.txt").write_text("".join(sorted(lines)))
        print(f"{target.name}: {len(taken)} wheels", flush=True)
    packed = sorted(wheels.iterdir())
    faults = [fault for wheel in packed for fault in wheel_faults(wheel)]
    if faults:
        raise ReleaseError("wheels that are not what they are called:\n" + "\n".join(faults))
    glibc = ".".join(map(str, glibc_needed(packed)))
    shutil.copyfile(sdist, tree / sdist.name)
    for source, name in (
        (ROOT / "scripts/release/install.sh", "install.sh"),
        (ROOT / "scripts/release/fresh_place.sh", "fresh_place.sh"),
        (ROOT / "LICENSE", "LICENSE"),
        (ROOT / "CHANGELOG.md", "CHANGELOG.md"),
    ):
        shutil.copyfile(source, tree / name)
    (tree / "VERSION").write_text(f"{version}\n")
    (tree / "GLIBC").write_text(f"{glibc}\n")
    (tree / "ROOM").write_text(f"{room_needed(wheels, requirements)}\n")
    (tree / "README.txt").write_text(_README.format(version=version, glibc=glibc, targets=", ".join(target.name for target in targets)))
    _copy_licences(packed, tree / "licences")
    write_sbom(make_sbom(lock=LOCK, wheels=packed, moment=source_moment()), tree / "sbom.cdx.json")
    files = sorted(path.relative_to(tree) for path in tree.rglob("*") if path.is_file())
    (tree / "SHA256SUMS").write_text("".join(f"{_sha256(tree / path)}  {path}\n" for path in files))
    return tree


def room_needed(wheels: Path, requirements: Path) -> int:
    """Return how much an installation takes where it takes most [MB]: what is in the wheels, Python twice, as it is and compiled.

    Files fill blocks of 4096 octets, and the environment itself is small.
    """
    sizes: dict[str, int] = {}
    for wheel in wheels.iterdir():
        with zipfile.ZipFile(wheel) as content:
            blocks = [(entry.filename, -(-entry.file_size // 4096) * 4096) for entry in content.infolist()]
        name, version, _, _ = parse_wheel_filename(wheel.name)
        size = sum(octets * (2 if path.endswith(".py") else 1) for path, octets in blocks)
        sizes[f"{name}=={version}"] = max(size, sizes.get(f"{name}=={version}", 0))
    rooms = [sum(sizes[line.split()[0]] for line in path.read_text().splitlines()) for path in requirements.iterdir()]
    return max(rooms) // 1_000_000 + _ENVIRONMENT_MB


def pack(tree: Path, archive: Path) -> None:
    """Put a folder into an uncompressed tar, since wheels are compressed; names sorted, one time, nobody's user."""
    moment = source_moment()
    fresh = archive.with_name(f".{archive.name}.{os.getpid()}")
    with tarfile.open(fresh, "w", format=tarfile.PAX_FORMAT) as tar:
        for path in sorted(tree.rglob("*")):
            if not path.is_file():
                continue
            entry = tarfile.TarInfo(f"{tree.name}/{path.relative_to(tree)}")
            entry.size, entry.mtime = path.stat().st_size, moment
            entry.mode = 0o755 if path.suffix == ".sh" else 0o644
            with path.open("rb") as file:
                tar.addfile(entry, file)
    fresh.replace(archive)


def _copy_licences(wheels: list[Path], folder: Path) -> None:
    """Copy the licence files of each package, once for each version."""
    seen = set()
    for wheel in wheels:
        name, version, _, _ = parse_wheel_filename(wheel.name)
        if (name, version) in seen:
            continue
        seen.add((name, version))
        with zipfile.ZipFile(wheel) as content:
            info = next(entry.split("/")[0] for entry in content.namelist() if ".dist-info/" in entry)
            place = folder / f"{name}-{version}"
            place.mkdir(parents=True)
            for entry in content.namelist():
                inside = Path(entry)
                if inside.parts[0] == info and not entry.endswith("/") and _is_licence(inside):
                    shutil.copyfileobj(io.BytesIO(content.read(entry)), (place / "-".join(inside.parts[1:])).open("wb"))
            shutil.copyfileobj(io.BytesIO(content.read(f"{info}/METADATA")), (place / "METADATA").open("wb"))


def _is_licence(path: Path) -> bool:
    words = ("licen", "copying", "notice", "authors")
    return "licenses" in path.parts or any(word in path.name.lower() for word in words)


def _name_of(wheel: Path) -> str:
    return parse_wheel_filename(wheel.name)[0]


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="make bundle ARGS=...", description="Make the archive from which biobot is installed without a network."
    )
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for the archive and its SHA-256 (default: dist)")
    parser.add_argument("--python", nargs="+", choices=PYTHONS, default=PYTHONS, help="versions of Python (default: all)")
    parser.add_argument("--machine", nargs="+", choices=MACHINES, default=MACHINES, help="processors (default: both)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
