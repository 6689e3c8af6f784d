"""A Debian machine with systemd as its first process, in a container that has no network but its own loopback."""

import hashlib
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from scripts.containers.podman import CheckFailedError, Podman
from scripts.debian_root import make_root


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A machine by what is on it before anything of ours is."""

    name: str
    packages: tuple[str, ...]

    @property
    def image(self) -> str:
        """Name of its image."""
        return f"localhost/{self.name}-machine:latest"


_SYSTEM = ("systemd", "systemd-sysv", "udev", "dbus", "python3", "iproute2")
WITH_COMPILER = Kind(name="biobot-install-check", packages=(*_SYSTEM, "python3-venv", "make", "gcc", "libc6-dev"))
"""Before the first command of docs/installing.md."""
WITH_PYTHON = Kind(name="biobot-bundle-check", packages=_SYSTEM)
"""Before the first command of docs/bundle.md: neither pip nor ``python3-venv``."""

_SOURCES = ("firmware_protocol", "gateway", "mapper", "simulator", "studies", "scripts", "requirements", "hatch_build.py", "pyproject.toml",
            "README.md", "LICENSE", "Makefile")  # fmt: skip
_REQUIREMENTS = ("build", "gateway", "mapper", "simulator")
_UNLISTED = ("/proc", "/sys", "/run", "/dev", "/tmp", "/src", "/wheels", "/sim", "/home", "/media")  # noqa: S108
_LISTED = f"find / -xdev \\( {' -o '.join(f'-path {path}' for path in _UNLISTED)} \\) -prune -o -printf '%p %y %l\\n' | sort"
_CGROUPS_V1 = Path("/sys/fs/cgroup/systemd")


class Machine:
    """The machine, running within the context; ``brings`` has folders of this one that it has too, to read, by their places on it."""

    def __init__(self, podman: Podman, kind: Kind, *, suite: str, brings: Mapping[str, Path]) -> None:
        self._podman = podman
        self._kind = kind
        self._brings = brings
        if podman.attempt("image", "exists", kind.image).returncode:
            root = podman.home / f"{kind.name}-root"
            make_root(root, suite=suite, include=kind.packages)
            with subprocess.Popen(["tar", "--directory", str(root), "--create", "."], stdout=subprocess.PIPE) as archive:
                podman.load_root(archive.stdout, name=kind.image)

    def __enter__(self) -> Self:
        self._podman.attempt("rm", "--force", "--time", "5", self._kind.name)
        command = [
            "run",
            "--detach",
            "--name",
            self._kind.name,
            "--hostname",
            "base1",
            "--systemd=always",
            "--network",
            "none",
            "--no-healthcheck",
        ]
        command += ["--cap-add", "SYS_ADMIN", "--security-opt", "seccomp=unconfined", "--security-opt", "unmask=all"]
        command += ["--tmpfs", "/run", "--tmpfs", "/run/lock"]
        command += [part for place, folder in self._brings.items() for part in ("--volume", f"{folder}:{place}:ro")]
        if _CGROUPS_V1.is_dir():
            command += ["--volume", f"{_CGROUPS_V1}:{_CGROUPS_V1}:rw"]
        self._podman.run(*command, self._kind.image, "/lib/systemd/systemd")
        self.wait_until_up()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if error is not None:
            journal = self._podman.attempt("exec", self._kind.name, "journalctl", "--no-pager", "--output=short-precise").stdout
            (self._podman.home / "journal.log").write_text(journal, encoding="utf-8")
        self._podman.attempt("rm", "--force", "--time", "10", self._kind.name)

    def restart(self) -> None:
        """Start the machine anew, as after a loss of power."""
        self._podman.attempt("kill", "--signal", "KILL", self._kind.name)
        self._podman.run("start", self._kind.name)
        self.wait_until_up()

    def wait_until_up(self) -> None:
        """Wait until systemd has started all that it starts at boot; units that fail here for want of hardware do not matter."""
        until(lambda: self.attempt("systemctl is-system-running").stdout.strip() in {"running", "degraded"}, what="systemd is up")

    def copy_checkout(self, place: str, *, version: str, patch: Sequence[tuple[str, str, str]] = ()) -> None:
        """Copy this checkout's files into the machine, as another version; ``patch`` has files with what to replace by what."""
        copied = (
            f"tar --create --exclude='*.so' --exclude=__pycache__ --directory /src {' '.join(_SOURCES)} | tar --extract --directory {place}"
        )
        self.run(f"rm -rf {place} && mkdir -p {place} && {copied}")
        self.run(f"sed -i 's/^version = .*/version = \"{version}\"/' {place}/pyproject.toml")
        for file, old, new in patch:
            self.run(f"python3 - {shlex.quote(f'{place}/{file}')} {shlex.quote(old)} {shlex.quote(new)}", stdin=_REPLACE)

    def attempt(self, command: str, *, timeout_s: float = 60) -> subprocess.CompletedProcess[str]:
        """Run a shell command in the machine, whatever comes of it."""
        return self._podman.attempt("exec", self._kind.name, "sh", "-c", command, timeout_s=timeout_s)

    def run(self, command: str, *, timeout_s: float = 60, status: int = 0, stdin: str | None = None) -> str:
        """Run a shell command in the machine; return what it says.

        Raises
        ------
        CheckFailedError
            It ended otherwise than with ``status``.
        """
        if stdin is not None:
            command = f"{command} <<'END'\n{stdin}\nEND"
        done = self.attempt(command, timeout_s=timeout_s)
        said = done.stdout + done.stderr
        if done.returncode != status:
            raise CheckFailedError(f"{command.splitlines()[0]}: status {done.returncode}, not {status}: {said[-3000:]}")
        return said

    def files(self) -> set[str]:
        """List all files, folders and links but those that are not on the disk, and those that this check brought."""
        return set(self.run(_LISTED).splitlines())


def fetch_wheels(podman: Podman, *, source: Path) -> Path:
    """Fetch all that the machine with a compiler will want, by the pinned hashes, since it has no network to do so; returns the folder.

    Raises
    ------
    CheckFailedError
        The machine has another Python than this one, and wants other wheels.
    """
    theirs = podman.run("run", "--rm", "--network", "none", WITH_COMPILER.image, "python3", "--version").split()[-1]
    ours = f"{sys.version_info.major}.{sys.version_info.minor}."
    if not theirs.startswith(ours):
        raise CheckFailedError(f"the machine has Python {theirs}, and this is Python {ours}x: run it with the machine's, for its wheels")
    wheels = podman.home / "wheels"
    wheels.mkdir(exist_ok=True)
    files = [source / "requirements" / f"{name}.txt" for name in _REQUIREMENTS]
    wanted = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
    mark = wheels / "complete"
    if mark.exists() and mark.read_text(encoding="utf-8") == wanted:
        return wheels
    for name in _REQUIREMENTS:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-build-isolation", "--require-hashes"]
        command += ["--dest", str(wheels), "--requirement", f"requirements/{name}.txt"]
        subprocess.run(command, cwd=source, check=True)
    mark.write_text(wanted, encoding="utf-8")
    return wheels


def until(is_so: Callable[[], bool], *, what: str, timeout_s: float = 120) -> float:
    """Wait until something is so; return how long it took [s].

    Raises
    ------
    CheckFailedError
        It was not, for ``timeout_s``.
    """
    started = time.monotonic()
    while not is_so():
        if time.monotonic() - started > timeout_s:
            raise CheckFailedError(f"not within {timeout_s:g} s: {what}")
        time.sleep(0.2)
    return time.monotonic() - started


_REPLACE = """import sys
from pathlib import Path
path, old, new = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
text = path.read_text()
assert text.count(old) == 1, f"{text.count(old)} times in {path}: {old}"
path.write_text(text.replace(old, new))"""
