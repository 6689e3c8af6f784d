"""What the libraries inside a wheel were compiled for: the processor of each, and the C library that it wants."""

import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

_MACHINES = {62: "x86_64", 183: "aarch64"}  # ELF gABI, e_machine: EM_X86_64, EM_AARCH64
_GLIBC = re.compile(rb"\0GLIBC_(\d+)\.(\d+)(?:\.\d+)?(?=\0)")
_MANYLINUX = re.compile(r"manylinux_(\d+)_(\d+)_")


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """A shared library: its place in the wheel, its processor, the newest version of glibc of which it names a symbol."""

    name: str
    machine: str
    glibc: tuple[int, int]


def libraries_of(wheel: Path) -> list[Library]:
    """List the shared libraries and extension modules in a wheel.

    Raises
    ------
    ValueError
        One is no ELF file.
    """
    found = []
    with zipfile.ZipFile(wheel) as content:
        for name in sorted(content.namelist()):
            if not re.search(r"\.so(\.\d+)*$", name):
                continue
            data = content.read(name)
            if data[:4] != b"\x7fELF":
                raise ValueError(f"{wheel.name}: {name} is called a library, and is no ELF file")
            number = int.from_bytes(data[18:20], "little")
            versions = [(int(major), int(minor)) for major, minor in _GLIBC.findall(data)]
            found.append(Library(name=name, machine=_MACHINES.get(number, f"ELF machine {number}"), glibc=max(versions, default=(0, 0))))
    return found


def wheel_faults(wheel: Path) -> list[str]:
    """Return what libraries of a wheel contradict its name: another processor, a newer C library, any where the name says none."""
    platform = wheel.stem.split("-")[-1]
    allowed = max(((int(major), int(minor)) for major, minor in _MANYLINUX.findall(platform)), default=None)
    faults = []
    for library in libraries_of(wheel):
        if not platform.endswith(library.machine):
            faults.append(f"{wheel.name}: {library.name} is for {library.machine}")
        elif allowed is not None and library.glibc > allowed:
            faults.append(f"{wheel.name}: {library.name} wants glibc {library.glibc[0]}.{library.glibc[1]}")
    return faults


def glibc_needed(wheels: list[Path]) -> tuple[int, int]:
    """Return the oldest glibc with which all libraries of these wheels can be loaded."""
    return max((library.glibc for wheel in wheels for library in libraries_of(wheel)), default=(0, 0))
