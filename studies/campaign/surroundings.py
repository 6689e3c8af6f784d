"""What the services of a campaign stand in: networks that can be cut, disks that can be filled, wall clocks that can be set.

Each is made for the campaign alone, in namespaces and files of its own, and is gone with it. What the machine does not allow is
named in `Possible` and left out of the plan.
"""

import contextlib
import os
import shutil
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

_IN_NAMESPACES = "CAMPAIGN_IN_NAMESPACES"
_WAIT_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Possible:
    """What can be done on this machine; where not, why."""

    networks: str | None
    disks: str | None
    clocks: str | None


def enter_namespaces(program: str) -> None:
    """Start this very program, a module, again in network, mount and process namespaces of its own; return where that is not allowed.

    Whatever it starts there ends with it, even where it is killed.
    """
    if _IN_NAMESPACES in os.environ or shutil.which("unshare") is None:
        return
    command = ["unshare", "--net", "--mount", "--propagation", "private", "--pid", "--fork", "--kill-child", "--mount-proc"]
    if os.geteuid() != 0:
        command.append("--map-root-user")
    if subprocess.run([*command, "true"], capture_output=True, check=False).returncode != 0:
        return
    os.environ[_IN_NAMESPACES] = "1"
    sys.stdout.flush()
    os.execvp(command[0], [*command, sys.executable, "-m", program, *sys.argv[1:]])  # noqa: S606  # our own program


def is_in_namespaces() -> bool:
    """Whether `enter_namespaces` could."""
    return _IN_NAMESPACES in os.environ


@dataclass(slots=True)
class Network:
    """A namespace for each of some hosts, joined to ours, the hall, by a cable of its own; without namespaces, all are on loopback."""

    hosts: tuple[str, ...]
    problem: str | None = None
    _holders: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def open(self) -> None:
        """Lay the cables; ``problem`` says what it was where that is not possible."""
        if not is_in_namespaces():
            self.problem = "no namespaces: wants root or unprivileged user namespaces, and unshare"
            return
        if shutil.which("ip") is None or shutil.which("nsenter") is None:
            self.problem = "no ip or nsenter (packages iproute2, util-linux)"
            return
        _run("ip", "link", "set", "lo", "up")
        Path("/proc/sys/net/ipv4/ip_forward").write_text("1", encoding="ascii")
        try:
            for number, host in enumerate(self.hosts, start=1):
                self._lay(number, host)
        except subprocess.CalledProcessError as error:
            self.problem = f"no pair of network devices: {error.stderr.decode(errors='replace').strip()}"
            self.close()

    def address_of_hall(self, host: str) -> str:
        """Return under which address a host reaches the hall."""
        return "127.0.0.1" if self.problem else f"10.77.{1 + self.hosts.index(host)}.1"

    def address_of(self, host: str) -> str:
        """Return under which address others reach a host."""
        return "127.0.0.1" if self.problem else f"10.77.{1 + self.hosts.index(host)}.2"

    def prefix(self, host: str) -> list[str]:
        """Return what stands before a command that is to run on a host."""
        return [] if self.problem else ["nsenter", f"--net=/proc/{self._holders[host].pid}/ns/net"]

    def cut(self, host: str) -> None:
        """Let nothing pass any more; nobody is told."""
        _run("ip", "link", "set", f"hall-{host}", "down")

    def heal(self, host: str) -> None:
        """Let everything pass again."""
        _run("ip", "link", "set", f"hall-{host}", "up")

    def close(self) -> None:
        """Take it all away."""
        for holder in self._holders.values():
            holder.kill()
            holder.wait()
        self._holders.clear()

    def _lay(self, number: int, host: str) -> None:
        holder = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
        self._holders[host] = holder
        ours, theirs = Path("/proc/self/ns/net"), Path(f"/proc/{holder.pid}/ns/net")
        deadline = time.monotonic() + _WAIT_S
        while theirs.readlink() == ours.readlink() and time.monotonic() < deadline:
            time.sleep(0.01)
        there = ["nsenter", f"--net={theirs}"]
        _run("ip", "link", "add", f"hall-{host}", "type", "veth", "peer", "name", "cable", "netns", str(holder.pid))
        _run("ip", "address", "add", f"10.77.{number}.1/24", "dev", f"hall-{host}")
        _run("ip", "link", "set", f"hall-{host}", "up")
        _run(*there, "ip", "address", "add", f"10.77.{number}.2/24", "dev", "cable")
        _run(*there, "ip", "link", "set", "cable", "up")
        _run(*there, "ip", "link", "set", "lo", "up")
        _run(*there, "ip", "route", "add", "10.77.0.0/16", "via", f"10.77.{number}.1")


@dataclass(slots=True)
class Disk:
    """A file system of its own in an image file (ext4 on a loop device) or, where that is not possible, in memory (tmpfs)."""

    place: Path
    size: int
    problem: str | None = None
    kind: str = "ext4"

    def open(self) -> None:
        """Make and mount it; ``problem`` says what it was where that is not possible, and the place is then a plain directory."""
        self.place.mkdir(parents=True, exist_ok=True)
        if not is_in_namespaces():
            self.problem = "no mount namespace"
            return
        image = self.place.with_suffix(".image")
        try:
            with image.open("wb") as file:
                file.truncate(self.size)
            _run("mkfs.ext4", "-q", "-F", "-m", "0", str(image))
            _run("mount", "-o", "loop", str(image), str(self.place))
        except (OSError, subprocess.CalledProcessError):
            image.unlink(missing_ok=True)
            self.kind = "tmpfs"
            try:
                _run("mount", "-t", "tmpfs", "-o", f"size={self.size}", "tmpfs", str(self.place))
            except (OSError, subprocess.CalledProcessError) as error:
                self.problem = f"cannot mount: {error}"
                return
        window = self.place.with_name("window")
        window.mkdir(exist_ok=True)
        _run("mount", "--bind", str(self.place), str(window))
        _run("mount", "-o", "remount,bind,ro", str(window))

    @property
    def window(self) -> Path | None:
        """The same files where nobody can write them: who looks at a database through it can do it no harm. None where there is none."""
        return None if self.problem else self.place.with_name("window")

    def fill(self) -> None:
        """Leave no room, while whoever writes goes on doing so."""
        ballast = os.open(self.place / "ballast", os.O_WRONLY | os.O_CREAT)
        try:
            at, step = os.fstat(ballast).st_size, 1 << 30
            while step >= 4096:
                try:
                    os.posix_fallocate(ballast, at, step)
                    at += step
                except OSError:
                    step //= 2
        finally:
            os.close(ballast)

    def free(self) -> None:
        """Give the room back."""
        (self.place / "ballast").unlink(missing_ok=True)

    def close(self) -> None:
        """Take it away, with its image."""
        if self.problem is None:
            with contextlib.suppress(subprocess.CalledProcessError):
                _run("umount", str(self.place.with_name("window")))
                _run("umount", str(self.place))
                self.place.with_suffix(".image").unlink(missing_ok=True)


@dataclass(slots=True)
class WallClocks:
    """Wall clocks of services, which can be set one by one; a library that is preloaded shifts what they read."""

    directory: Path
    problem: str | None = None

    def open(self) -> None:
        """Compile the library; ``problem`` says what it was where that is not possible."""
        compiler = shutil.which("cc") or shutil.which("gcc")
        if compiler is None or not sys.platform.startswith("linux"):
            self.problem = "no C compiler, or no Linux"
            return
        self.directory.mkdir(parents=True, exist_ok=True)
        source = Path(__file__).with_name("shifted_clock.c")
        try:
            _run(compiler, "-O2", "-shared", "-fPIC", "-o", str(self._library), str(source), "-ldl")
        except subprocess.CalledProcessError as error:
            self.problem = f"{source} does not compile: {error.stderr.decode(errors='replace').strip()}"

    def environment(self, service: str) -> dict[str, str]:
        """Return the variables that give a service a wall clock of its own."""
        if self.problem:
            return {}
        shift = self.directory / f"{service}.shift"
        if not shift.exists():
            shift.write_bytes(struct.pack("<q", 0))
        return {"LD_PRELOAD": str(self._library.resolve()), "CAMPAIGN_CLOCK_SHIFT": str(shift.resolve())}

    def shift(self, service: str, by_s: float) -> None:
        """Let a service's wall clock be off by this from now on."""
        with (self.directory / f"{service}.shift").open("r+b", buffering=0) as file:
            file.write(struct.pack("<q", round(by_s * 1e9)))  # eight bytes at once: nobody reads half of them

    @property
    def _library(self) -> Path:
        return self.directory / "shifted_clock.so"


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True)
