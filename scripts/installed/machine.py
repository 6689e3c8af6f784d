"""A Debian machine with systemd as its first process, in a container that has no network but its own loopback."""

import hashlib
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from scripts.containers.podman import CheckFailedError, Podman
from scripts.debian_root import make_root

IMAGE = "localhost/biobot-machine:latest"
NAME = "biobot-install-check"
PACKAGES = ("systemd", "systemd-sysv", "udev", "dbus", "python3", "python3-venv", "make", "gcc", "libc6-dev", "iproute2")
"""What the machine has before the first command of docs/installing.md."""

_SOURCES = ("firmware_protocol", "gateway", "mapper", "simulator", "studies", "scripts", "requirements", "hatch_build.py", "pyproject.toml",
            "README.md", "LICENSE", "Makefile")  # fmt: skip
_REQUIREMENTS = ("build", "gateway", "mapper", "simulator")
_UNLISTED = ("/proc", "/sys", "/run", "/dev", "/tmp", "/src", "/wheels", "/sim", "/home/checkout")  # noqa: S108  # left out
_LISTED = f"find / -xdev \\( {' -o '.join(f'-path {path}' for path in _UNLISTED)} \\) -prune -o -printf '%p %y %l\\n' | sort"
_CGROUPS_V1 = Path("/sys/fs/cgroup/systemd")


class Machine:
    """The machine, running within the context. This checkout is ``/src`` on it."""

    def __init__(self, podman: Podman, *, source: Path, suite: str) -> None:
        self._podman = podman
        self._source = source
        if podman.attempt("image", "exists", IMAGE).returncode:
            root = podman.home / "root"
            make_root(root, suite=suite, include=PACKAGES)
            with subprocess.Popen(["tar", "--directory", str(root), "--create", "."], stdout=subprocess.PIPE) as archive:
                podman.load_root(archive.stdout, name=IMAGE)
        self._wheels = podman.home / "wheels"

    def fetch_wheels(self) -> None:
        """Fetch all that the machine will want, by the pinned hashes; it has no network to do so itself."""
        theirs = self._podman.run("run", "--rm", "--network", "none", IMAGE, "python3", "--version").split()[-1]
        ours = f"{sys.version_info.major}.{sys.version_info.minor}."
        if not theirs.startswith(ours):
            raise CheckFailedError(
                f"the machine has Python {theirs}, and this is Python {ours}x: run it with the machine's, for its wheels"
            )
        self._wheels.mkdir(exist_ok=True)
        files = [self._source / "requirements" / f"{name}.txt" for name in _REQUIREMENTS]
        wanted = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
        mark = self._wheels / "complete"
        if mark.exists() and mark.read_text(encoding="utf-8") == wanted:
            return
        for name in _REQUIREMENTS:
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-build-isolation", "--require-hashes"]
            command += ["--dest", str(self._wheels), "--requirement", f"requirements/{name}.txt"]
            subprocess.run(command, cwd=self._source, check=True)
        mark.write_text(wanted, encoding="utf-8")

    def __enter__(self) -> Self:
        self._podman.attempt("rm", "--force", "--time", "5", NAME)
        command = ["run", "--detach", "--name", NAME, "--hostname", "base1", "--systemd=always", "--network", "none", "--no-healthcheck"]
        command += ["--cap-add", "SYS_ADMIN", "--security-opt", "seccomp=unconfined", "--security-opt", "unmask=all"]
        command += [
            "--tmpfs",
            "/run",
            "--tmpfs",
            "/run/lock",
            "--volume",
            f"{self._wheels}:/wheels:ro",
            "--volume",
            f"{self._source}:/src:ro",
        ]
        if _CGROUPS_V1.is_dir():
            command += ["--volume", f"{_CGROUPS_V1}:{_CGROUPS_V1}:rw"]
        self._podman.run(*command, IMAGE, "/lib/systemd/systemd")
        self.wait_until_up()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if error is not None:
            journal = self._podman.attempt("exec", NAME, "journalctl", "--no-pager", "--output=short-precise").stdout
            (self._podman.home / "journal.log").write_text(journal, encoding="utf-8")
        self._podman.attempt("rm", "--force", "--time", "10", NAME)

    def restart(self) -> None:
        """Start the machine anew, as after a loss of power."""
        self._podman.attempt("kill", "--signal", "KILL", NAME)
        self._podman.run("start", NAME)
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
        return self._podman.attempt("exec", NAME, "sh", "-c", command, timeout_s=timeout_s)

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
