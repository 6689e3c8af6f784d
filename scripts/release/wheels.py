"""Wheels for machines that may not be this one: ours out of our sdist, those of others as the lock file pins them."""

import os
import platform
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

from scripts.release.lock_file import Pin, Target
from scripts.release.version import ROOT, source_moment

WITHOUT_WHEELS = frozenset({"cobs"})
"""Packages that come as sources alone. Each is built once, without a compiler, into a wheel for every machine: cobs does in Python then
what its C would do, and where bytes come fast, gateway/bulk unstuffs them itself."""
_NEWEST_GLIBC = 36
"""Of Debian 12 and Raspberry Pi OS 12; wheels that want a newer one are not taken."""


class ReleaseError(Exception):
    """Something that a release needs is not there; the message says what to do."""


def make_sdist(folder: Path) -> Path:
    """Make the sdist of this source tree in a folder, and return its path."""
    code = "import sys; from hatchling.build import build_sdist; print(build_sdist(sys.argv[1]))"
    return folder / _run([sys.executable, "-c", code, str(folder.resolve())], cwd=ROOT).splitlines()[-1]


def make_wheel(sdist: Path, *, machine: str, folder: Path) -> Path:
    """Make our wheel for a processor out of the sdist, with a cross compiler where it is not this machine's, and return its path.

    Raises
    ------
    ReleaseError
        There is no compiler for that processor, or it does not compile.
    """
    tree = folder / f"sources-{machine}"
    with tarfile.open(sdist) as archive:
        archive.extractall(tree, filter="data")
    (source,) = tree.iterdir()
    # What sysconfig.get_platform() says then is what the build hook names the wheel for.
    variables = {"_PYTHON_HOST_PLATFORM": f"linux-{machine}"}
    if machine != platform.machine():
        compiler = f"{machine}-linux-gnu-gcc"
        if shutil.which(compiler) is None:
            next_step = f"make system-packages installs it on Debian; or leave that processor out (--machine {platform.machine()})"
            raise ReleaseError(f"no {compiler} to compile our kernels for {machine}: {next_step}")
        variables["CC"] = compiler
    code = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"
    made = folder / _run([sys.executable, "-c", code, str(folder.resolve())], cwd=source, **variables).splitlines()[-1]
    shutil.rmtree(tree)
    return made


def build_universal(pins: list[Pin], folder: Path) -> None:
    """Build the packages that have no wheels, without a compiler, and put their wheels into a folder.

    Raises
    ------
    ReleaseError
        One is not for every machine after all.
    """
    listed = _write_requirements([pin for pin in pins if pin.name in WITHOUT_WHEELS], folder / "sources.txt")
    for pin in pins:
        if pin.name in WITHOUT_WHEELS:
            made = folder / "universal"
            command = [
                "wheel",
                "--no-deps",
                "--no-cache-dir",
                "--no-build-isolation",
                "--no-binary=:all:",
                "--require-hashes",
                "--wheel-dir",
                str(made),
            ]
            _pip(*command, "--requirement", str(_write_requirements([pin], listed)), CC=shutil.which("false") or "/bin/false")
            (wheel,) = made.iterdir()
            if not wheel.name.endswith("-none-any.whl"):
                raise ReleaseError(f"{wheel.name} was built for this machine alone; take {pin.name} out of WITHOUT_WHEELS")
            wheel.replace(folder / wheel.name)
            made.rmdir()
    listed.unlink()


def download_wheels(pins: list[Pin], target: Target, folder: Path) -> None:
    """Download the wheels that a kind of machine needs, checked by the lock's hashes.

    Raises
    ------
    ReleaseError
        pip finds one missing, or one that does not have its hash.
    """
    listed = _write_requirements([pin for pin in pins if pin.name not in WITHOUT_WHEELS], folder / "download.txt")
    tags = [f"manylinux_2_{minor}_{target.machine}" for minor in range(_NEWEST_GLIBC, 4, -1)]
    flags = [flag for tag in (*tags, f"manylinux2014_{target.machine}") for flag in ("--platform", tag)]
    for abi in (f"cp{target.python.replace('.', '')}", "abi3", "none"):
        flags += ["--abi", abi]
    command = ["download", "--no-deps", "--only-binary=:all:", "--require-hashes", "--dest", str(folder)]
    _pip(*command, "--python-version", target.python, "--implementation", "cp", *flags, "--requirement", str(listed))
    listed.unlink()


def _write_requirements(pins: list[Pin], path: Path) -> Path:
    lines = [f"{pin.name}=={pin.version} {' '.join(f'--hash=sha256:{digest}' for digest in pin.sha256s)}\n" for pin in pins]
    path.write_text("".join(lines))
    return path


def _pip(*arguments: str, **variables: str) -> None:
    _run([sys.executable, "-m", "pip", *arguments, "--quiet", "--disable-pip-version-check"], cwd=ROOT, **variables)


def _run(command: list[str], *, cwd: Path, **variables: str) -> str:
    # Modes of files and the times of those that are generated get into wheels: neither may depend on who builds, and when.
    moment = {"SOURCE_DATE_EPOCH": str(source_moment())}
    done = subprocess.run(command, cwd=cwd, env=os.environ | moment | variables, umask=0o022, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ReleaseError(f"{' '.join(command[:4])} … failed:\n{done.stderr.strip()}")
    return done.stdout
