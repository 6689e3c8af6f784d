"""Machines on which a release is tried: every Python that is found here, and system trees of other systems and processors.

A system tree is a folder with another Linux in it, as ``sh scripts/release/system_tree.sh`` makes them; it is entered by chroot. Trees for
another processor run under QEMU, which is made known to the kernel in a user namespace of its own (Linux 6.7): nothing of this machine is
changed.
"""

import os
import platform
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from scripts.release.lock_file import PYTHONS

_HOMES = (
    "~/.pyenv/versions/{version}*/bin/python3",
    "~/.local/share/uv/python/cpython-{version}*/bin/python3",
    "/opt/python{version}/bin/python3",
)
_ASK = "import os, sys; print('%d.%d' % sys.version_info[:2], os.uname().machine)"
# binfmt_misc(7): octets 18 and 19 of an ELF header are the processor's number, octet 16 says that it is a program.
_MAGIC = {"aarch64": r"\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00"}
_MASK = r"\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff"


class MachineError(Exception):
    """A machine cannot be entered here; the message says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A Python of this machine, or of a system tree (``root``)."""

    program: str
    python: str
    processor: str
    root: Path | None = None

    @property
    def name(self) -> str:
        """Name it for people."""
        place = "" if self.root is None else f", {self.root.name}"
        return f"Python {self.python}, {self.processor}{place}"

    @property
    def target(self) -> str:
        """Name its kind, as the bundle's pins are named."""
        return f"{self.python}-{self.processor}"

    def place(self, folder: Path) -> str:
        """Return a folder's path as a process on that machine sees it."""
        return str(folder) if self.root is None else "/" + str(folder.relative_to(self.root))

    def scratch(self) -> Path:
        """Return where a process on that machine may have files."""
        return Path(os.environ.get("TMPDIR", "/tmp")) if self.root is None else self.root / "tmp"  # noqa: S108  # a folder of its own is made in it

    def command(self, *arguments: str) -> list[str]:
        """Return the command that runs ``arguments`` there, with no network but loopback."""
        return _enter(self.root, self.processor, list(arguments))


def find_machines(trees: list[Path]) -> tuple[list[Machine], list[str]]:
    """Find all machines, one for each Python and processor; and what is missing, with the reason."""
    found: list[Machine] = []
    for version in PYTHONS:
        for candidate in _candidates(version):
            told = subprocess.run([candidate, "-I", "-c", _ASK], capture_output=True, text=True, check=False).stdout.split()
            if told and told[0] == version:
                found.append(Machine(program=candidate, python=version, processor=told[1]))
                break
    missing = []
    for root in trees:
        program = next((f"/usr/bin/python{version}" for version in PYTHONS if (root / f"usr/bin/python{version}").exists()), None)
        if program is None:
            missing.append(f"{root}: no Python that we support in it")
            continue
        number = int.from_bytes((root / program[1:]).read_bytes()[18:20], "little")
        processor = {62: "x86_64", 183: "aarch64"}.get(number, f"ELF machine {number}")
        try:
            _enter(root, processor, [])
        except MachineError as error:
            missing.append(f"{root}: {error}")
            continue
        found.append(Machine(program=program, python=program.removeprefix("/usr/bin/python"), processor=processor, root=root))
    there = {(machine.python, machine.processor) for machine in found}
    missing += [f"Python {version}: not on this machine" for version in PYTHONS if (version, platform.machine()) not in there]
    return found, missing


def _candidates(version: str) -> list[str]:
    homes = [path for pattern in _HOMES for path in _expand(pattern.format(version=version))]
    return [*([program] if (program := shutil.which(f"python{version}")) else []), *homes]


def _expand(pattern: str) -> list[str]:
    path = Path(pattern).expanduser()
    base = Path(path.anchor)
    return sorted(map(str, base.glob(str(path.relative_to(base)))))


def _enter(root: Path | None, processor: str, command: list[str]) -> list[str]:
    if shutil.which("ip") is None:
        raise MachineError("no ip here, which is in iproute2")
    flags, steps, run = ["--net"], ["ip link set lo up"], 'exec "$@"'
    if root is None:
        if os.getuid() != 0:
            flags.append("--map-root-user")
    else:
        if os.getuid() != 0:
            raise MachineError("only root can enter a system tree")
        flags += ["--mount", "--propagation", "private"]
        there = shlex.quote(str(root))
        if processor != platform.machine():
            qemu = shutil.which(f"qemu-{processor}-static")
            if qemu is None:
                raise MachineError(f"no qemu-{processor}-static here (apt-get install qemu-user-static)")
            flags += ["--map-root-user"]
            known = f":biobot-{processor}:M::{_MAGIC[processor]}:{_MASK}:{qemu}:F"
            steps += [
                "mount -t binfmt_misc none /proc/sys/fs/binfmt_misc",
                f"printf %s {shlex.quote(known)} > /proc/sys/fs/binfmt_misc/register",
            ]
        steps += [f"mount --rbind /dev {there}/dev", f"mount --rbind /proc {there}/proc"]
        run = f'exec chroot {there} /usr/bin/env -i PATH=/usr/bin:/bin HOME=/tmp LANG=C.UTF-8 "$@"'
    return ["unshare", *flags, "sh", "-c", " && ".join([*steps, run]), "sh", *command]
