"""``make reproducible``: all that is released of one commit is made twice under other circumstances, and has to be the same to the octet.

Sources are unpacked from an sdist into two folders. There sdist, wheel, the wheels of packages that have none and the bill of
materials are made; with ``--bundle`` an offline bundle for one kind of machine, too. The circumstances that differ: folder, umask, times
of the files, clock (with faketime, where it is installed), time zone, language, home folder, seed of Python's hashes. Compiler and Python
are the same.
"""

import argparse
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from scripts.release import bundle
from scripts.release.lock_file import Target, read_lock
from scripts.release.sbom import NOT_SHIPPED, make_sbom, write_sbom
from scripts.release.version import source_moment
from scripts.release.wheels import ReleaseError, build_universal, make_sdist, make_wheel

_DAYS_LATER = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class Circumstances:
    """Under which something is made, and which must not show in it."""

    folder: str
    umask: int
    moment: int
    """Time of the source files [s, Unix time]."""
    days_later: int
    variables: dict[str, str]


FIRST = Circumstances(
    folder="a", umask=0o022, moment=1_000_000_000, days_later=0, variables={"TZ": "UTC", "LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "1"}
)
SECOND = Circumstances(
    folder="another place/b",
    umask=0o077,
    moment=1_700_000_001,
    days_later=_DAYS_LATER,
    variables={"TZ": "Pacific/Kiritimati", "LC_ALL": "C", "PYTHONHASHSEED": "2"},
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make all twice; 0 where both are the same, 1 where they are not or could not be made."""
    options = _parser().parse_args(arguments)
    if options.make is not None:
        make_here(options.make, has_others=not options.ours, has_bundle=options.bundle)
        return 0
    flags = [flag for flag, is_set in (("--ours", options.ours), ("--bundle", options.bundle)) if is_set]
    if shutil.which("faketime") is None:
        print("the clock is the same for both: apt-get install faketime gives the second one another")
    with tempfile.TemporaryDirectory() as place:
        try:
            made = make_twice(Path(place), flags=flags)
        except ReleaseError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        return 1 if compare(*made, say=print) else 0


def make_twice(place: Path, *, flags: Sequence[str] = ()) -> tuple[Path, Path]:
    """Make all in two folders below ``place``, and return them.

    Raises
    ------
    ReleaseError
        It could not be made.
    """
    sdist = make_sdist(place)
    first, second = (_make_under(one, sdist=sdist, place=place, flags=flags) for one in (FIRST, SECOND))
    # The tree itself, with all that lies in it beside the sources, makes the same as what was unpacked.
    shutil.copyfile(sdist, first / f"tree-{sdist.name}")
    shutil.copyfile(second / sdist.name, second / f"tree-{sdist.name}")
    return first, second


def make_here(folder: Path, *, has_others: bool = True, has_bundle: bool = False) -> None:
    """Make of this source tree what is released."""
    folder.mkdir(parents=True)
    sdist = make_sdist(folder)
    make_wheel(sdist, machine=platform.machine(), folder=folder)
    write_sbom(make_sbom(others=NOT_SHIPPED, moment=source_moment()), folder / "sbom.cdx.json")
    if has_others:
        build_universal(read_lock(bundle.LOCK), folder)
    if has_bundle:
        here = Target(python=f"{sys.version_info.major}.{sys.version_info.minor}", machine=platform.machine())
        if bundle.main(["--out", str(folder), "--python", here.python, "--machine", here.machine]) != 0:
            raise ReleaseError("the bundle could not be made (above)")


def compare(first: Path, second: Path, *, say: Callable[[str], None]) -> int:
    """Say of each file whether it is the same in both folders, and where it differs; returns how many are not."""
    n_different = 0
    for name in sorted({path.name for folder in (first, second) for path in folder.iterdir()}):
        digests = [_sha256(folder / name) for folder in (first, second)]
        is_same = digests[0] == digests[1] is not None
        n_different += not is_same
        say(f"{'same' if is_same else 'DIFFERS':8} {digests[0] or 'not made':64} {name}")
        if None not in digests and not is_same:
            contents = [_members(folder / name) for folder in (first, second)]
            inside = sorted({member for member, _ in contents[0] ^ contents[1]})
            say(f"         in {', '.join(inside[:8]) or 'its order, times or modes alone'}")
    return n_different


def _make_under(one: Circumstances, *, sdist: Path, place: Path, flags: Sequence[str]) -> Path:
    tree, out, home = place / one.folder, place / f"made-{one.days_later}", place / one.folder / "home"
    with tarfile.open(sdist) as archive:
        archive.extractall(tree, filter="data")
    (source,) = tree.iterdir()
    home.mkdir()
    for path in source.rglob("*"):
        os.utime(path, (one.moment, one.moment))
    later = ["faketime", "-f", f"+{one.days_later}d"] if one.days_later and shutil.which("faketime") else []
    command = [*later, sys.executable, "-m", "scripts.release.reproducible", "--make", str(out), *flags]
    variables = os.environ | one.variables | {"HOME": str(home), "SOURCE_DATE_EPOCH": str(source_moment())}
    done = subprocess.run(command, cwd=source, env=variables, umask=one.umask, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ReleaseError(f"nothing could be made in {tree.name}:\n{done.stderr.strip()[-3000:]}")
    return out


def _sha256(path: Path) -> str | None:
    if not path.exists():
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _members(path: Path) -> set[tuple[str, str]]:
    """Return what is in an archive: names, and digests of what they hold; of another file nothing."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return {(name, hashlib.sha256(archive.read(name)).hexdigest()) for name in archive.namelist()}
    if tarfile.is_tarfile(path):
        with tarfile.open(path) as tar:
            files = [(entry.name, tar.extractfile(entry)) for entry in tar]
            return {(name, hashlib.sha256(file.read()).hexdigest()) for name, file in files if file is not None}
    return set()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="make reproducible ARGS=...", description="Make what is released twice, and see that it is the same to the octet."
    )
    parser.add_argument("--bundle", action="store_true", help="the offline bundle too, for this kind of machine (fetches its wheels twice)")
    parser.add_argument("--ours", action="store_true", help="leave out packages of others that are built from source (needs no network)")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
