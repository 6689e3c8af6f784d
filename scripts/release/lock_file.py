"""What a lock file of requirements/ pins, and which of it one kind of machine needs."""

import re
from dataclasses import dataclass
from pathlib import Path

from packaging.requirements import Requirement

PYTHONS = ("3.11", "3.12", "3.13", "3.14")
MACHINES = ("x86_64", "aarch64")
_COMMENT = re.compile(r"^\s*#.*\n", re.MULTILINE)
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A kind of machine: Linux with glibc, a version of CPython, a processor."""

    python: str
    machine: str

    @property
    def name(self) -> str:
        """Name it for people and files."""
        return f"{self.python}-{self.machine}"

    @property
    def environment(self) -> dict[str, str]:
        """What markers of requirements ask for, as pip on that machine would say it."""
        return {
            "python_version": self.python,
            "python_full_version": f"{self.python}.0",
            "platform_machine": self.machine,
            "platform_python_implementation": "CPython",
            "implementation_name": "cpython",
            "platform_system": "Linux",
            "sys_platform": "linux",
            "os_name": "posix",
            "extra": "",
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Pin:
    """One version of one package, for those machines that its marker names."""

    name: str
    version: str
    marker: str
    sha256s: tuple[str, ...]


def read_lock(path: Path) -> list[Pin]:
    """Read a lock file as ``make lock`` writes it.

    Raises
    ------
    ValueError
        Something in it is not pinned, or has no hash.
    """
    pins = []
    for entry in re.split(r"\n(?=\S)", _COMMENT.sub("", path.read_text())):
        if not entry.strip():
            continue
        requirement = Requirement(entry.replace("\\\n", " ").split("--hash")[0].strip())
        specifiers, sha256s = list(requirement.specifier), tuple(_HASH.findall(entry))
        if len(specifiers) != 1 or specifiers[0].operator != "==" or not sha256s:
            raise ValueError(f"{path}: {requirement} is not pinned with a hash; make lock writes the file anew")
        pins.append(Pin(name=requirement.name, version=specifiers[0].version, marker=str(requirement.marker or ""), sha256s=sha256s))
    return pins


def pins_for(pins: list[Pin], target: Target) -> list[Pin]:
    """Return those pins that a kind of machine needs, by their markers."""
    found = []
    for pin in pins:
        marker = Requirement(f"{pin.name}; {pin.marker}").marker if pin.marker else None
        if marker is None or marker.evaluate(target.environment):
            found.append(pin)
    return found
