"""buildah and podman with a store and settings of their own, so that nothing of this machine's containers is touched or relied on."""

import os
import resource
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

PROGRAMS = {
    "buildah": "apt-get install buildah",
    "podman": "apt-get install podman",
    "runc": "apt-get install runc",
    "iptables": "apt-get install iptables, without which podman's networks do not come up",
    "debootstrap": "apt-get install debootstrap",
    "podman-compose": "pip install podman-compose, in an environment of its own, and put its folder on PATH",
}
_NETWORK_PROGRAMS = {"netavark": "apt-get install netavark", "aardvark-dns": "apt-get install aardvark-dns"}
_NETWORK_FOLDERS = ("/usr/lib/podman", "/usr/libexec/podman", "/usr/local/lib/podman", "/usr/local/libexec/podman")

_MAX_FILES, _MAX_PROCESSES = 20_000, 32_768
"""No more than this, because podman lowers its own limits to its defaults first and may have no right to raise them again."""


class CheckFailedError(Exception):
    """Something is not as it has to be; the text says what."""


def missing() -> list[str]:
    """Return what stands in the way of building and running containers here, one line each."""
    found = [f"{program} is missing: {advice}" for program, advice in PROGRAMS.items() if shutil.which(program) is None]
    for program, advice in _NETWORK_PROGRAMS.items():
        if not any(Path(folder, program).exists() for folder in _NETWORK_FOLDERS) and shutil.which(program) is None:
            found.append(f"{program} is missing: {advice}")
    if os.geteuid() != 0:
        found.append("this user is not root: debootstrap and podman's networks need it")
    return found


class Podman:
    """Runs the programs with a store in ``home``, where the configuration is written to."""

    def __init__(self, home: Path) -> None:
        self.home = home
        home.mkdir(parents=True, exist_ok=True)
        (home / "storage.conf").write_text(
            f'[storage]\ndriver = "overlay"\ngraphroot = "{home}/storage"\nrunroot = "{home}/run"\n', encoding="utf-8"
        )
        (home / "containers.conf").write_text(_containers_conf(), encoding="utf-8")
        self._environment = {
            **os.environ,
            "CONTAINERS_STORAGE_CONF": str(home / "storage.conf"),
            "CONTAINERS_CONF": str(home / "containers.conf"),
            "BUILDAH_ISOLATION": "chroot",
        }
        self._secrets = _pip_secrets(home)

    def build(self, target: str, *, tag: str, dockerfile: Path, context: Path, values: Mapping[str, str]) -> float:
        """Build a target of a Dockerfile, its log in ``home/build-TARGET.log``; return how long that took [s]."""
        log = self.home / f"build-{target}.log"
        command = ["buildah", "bud", "--format", "docker", "--layers", *self._secrets]
        command += [part for name, value in values.items() for part in ("--build-arg", f"{name}={value}")]
        command += ["--target", target, "--tag", tag, "--file", str(dockerfile), str(context)]
        started = time.monotonic()
        with log.open("w", encoding="utf-8") as out:
            done = subprocess.run(command, env=self._environment, stdout=out, stderr=subprocess.STDOUT, check=False)
        if done.returncode:
            raise CheckFailedError(f"{target} does not build: {_tail(log.read_text(encoding='utf-8', errors='replace'))}; all is in {log}")
        return time.monotonic() - started

    def load_root(self, archive: IO[bytes] | None, *, name: str) -> None:
        """Make an image of a root file system, which comes as a tar archive."""
        command = ["podman", "import", "--quiet", "--change", 'CMD=["bash"]', "-", name]
        done = subprocess.run(command, stdin=archive, env=self._environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise CheckFailedError(f"podman import: {_tail(done.stderr)}")

    def run(self, *command: str, timeout_s: float = 120) -> str:
        """Run podman; return what it prints.

        Raises
        ------
        CheckFailedError
            It failed, or took too long.
        """
        done = self.attempt(*command, timeout_s=timeout_s)
        if done.returncode:
            raise CheckFailedError(f"podman {' '.join(command)}: status {done.returncode}: {_tail(done.stderr or done.stdout)}")
        return done.stdout.strip()

    def attempt(self, *command: str, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
        """Run podman, whatever comes of it."""
        return _finish(["podman", *command], environment=self._environment, timeout_s=timeout_s)

    def compose(
        self, files: Sequence[Path], *command: str, project: str, variables: Mapping[str, str] | None = None, timeout_s: float = 300
    ) -> str:
        """Run podman-compose over files, with variables that they ask for."""
        line = ["podman-compose", "--project-name", project, *(part for file in files for part in ("--file", str(file))), *command]
        done = _finish(line, environment=self._environment | dict(variables or {}), timeout_s=timeout_s)
        if done.returncode:
            raise CheckFailedError(f"{' '.join(line)}: status {done.returncode}: {_tail(done.stderr or done.stdout)}")
        return done.stdout.strip()


def _finish(command: Sequence[str], *, environment: Mapping[str, str], timeout_s: float) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=timeout_s)
    except subprocess.TimeoutExpired as error:
        raise CheckFailedError(f"{' '.join(command)}: not done within {timeout_s:g} s") from error


def _containers_conf() -> str:
    """Write settings that do without systemd and without the right to raise limits."""
    limits = {"nofile": (resource.RLIMIT_NOFILE, _MAX_FILES), "nproc": (resource.RLIMIT_NPROC, _MAX_PROCESSES)}
    ulimits = []
    for name, (kind, most) in limits.items():
        hard = resource.getrlimit(kind)[1]
        limit = most if hard == resource.RLIM_INFINITY else min(hard, most)
        ulimits.append(f'"{name}={limit}:{limit}"')
    return f"""[containers]
default_ulimits = [{", ".join(ulimits)}]
[network]
network_backend = "netavark"
[engine]
runtime = "runc"
cgroup_manager = "cgroupfs"
events_logger = "file"
"""


def _pip_secrets(home: Path) -> list[str]:
    """Return the flags by which pip in the build believes the certificates that this machine's pip is told to."""
    bundle = os.environ.get("PIP_CERT") or os.environ.get("SSL_CERT_FILE")
    if not bundle:
        return []
    (home / "pip.conf").write_text("[global]\ncert = /run/secrets/ca\n", encoding="utf-8")
    return ["--secret", f"id=ca,src={bundle}", "--secret", f"id=pip,src={home / 'pip.conf'}"]


def _tail(text: str, n_lines: int = 12) -> str:
    return "\n".join(text.strip().splitlines()[-n_lines:])
