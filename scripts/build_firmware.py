"""Build the coordinator firmware of a port: an image for the emulated board, or one for a chip (make firmware-image).

Each port is a folder of `firmware_protocol/c/ports`; what it is built with, and what its parts of memory hold, stands in ``PORTS``.
"""

import argparse
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "firmware_protocol" / "c"
CORE = ("biobot_codec", "biobot_coordinator", "biobot_crc", "biobot_frame", "biobot_layouts", "biobot_link")


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """What it takes to build a port: modules and folders besides the core, the compiler, and flags for compiling and for linking.

    ``suffix`` is of the image. ``object_suffix`` is of an object file.
    """

    modules: tuple[str, ...] = ()
    folders: tuple[str, ...]
    compiler: str
    flags: tuple[str, ...]
    link_flags: tuple[str, ...]
    suffix: str
    object_suffix: str


_CORTEX_M3 = ("-mcpu=cortex-m3", "-mthumb")
_WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror")
# Without the last one gcc makes memcpy of the loop in memcpy itself.
_FREESTANDING = ("-std=c11", "-Os", "-g", "-ffreestanding", "-ffunction-sections", "-fdata-sections", "-fno-tree-loop-distribute-patterns")
_MPS2_MEMORY = str(SOURCES / "ports" / "mps2_an385" / "board.ld")
_8051 = ("-mmcs51", "--model-large")
# What these optimisations win in time they pay in the 128 octets of fast memory, which do not suffice (docs/firmware-boards.md).
_SPARING = ("--opt-code-size", "--nogcse", "--noinvariant", "--noinduction")

PORTS = {
    "mps2_an385": Port(
        modules=("biobot_backpack",),
        folders=("bench", "ports/mps2_an385"),
        compiler="arm-none-eabi-gcc",
        flags=(*_CORTEX_M3, *_FREESTANDING, *_WARNINGS, "-DBB_BACKPACK_SLOTS=16u"),
        link_flags=(*_CORTEX_M3, "-nostdlib", "-Wl,--gc-sections", "-Wl,--fatal-warnings", "-T", _MPS2_MEMORY, "-lgcc"),
        suffix=".elf",
        object_suffix=".o",
    ),
    "cc2530": Port(
        folders=("ports/cc2530",),
        compiler="sdcc",
        flags=(*_8051, "--std-c11", *_SPARING, "--Werror", "-DBB_COORDINATOR_QUEUE_SIZE=3072u", "-DBB_CODEC_MESSAGES=0"),
        # Flash of 256 KiB, of which code without banks uses the lowest 64; 8 KiB of RAM, the last 256 of them the 8051's own.
        link_flags=(*_8051, "--code-size", "0x10000", "--xram-loc", "0x0000", "--xram-size", "0x1F00"),
        suffix=".hex",
        object_suffix=".rel",
    ),
}


class BuildError(Exception):
    """A compiler is missing, or does not like what it is given; the message says which and what."""


def build(name: str, *, out: Path) -> Path:
    """Build the image of a port into a folder, made if need be, and return its path.

    Raises
    ------
    BuildError
        The compiler is not installed, or it failed.
    """
    port = PORTS[name]
    if shutil.which(port.compiler) is None:
        raise BuildError(f"no {port.compiler} here: run make system-packages")
    objects = out / name
    objects.mkdir(parents=True, exist_ok=True)
    includes = [f"-I{SOURCES}", *(f"-I{SOURCES / folder}" for folder in port.folders)]
    made = []
    for source in _sources(port):
        target = objects / (source.stem + port.object_suffix)
        _run([port.compiler, *port.flags, *includes, "-c", str(source), "-o", str(target)])
        made.append(str(target))
    image = out / (name + port.suffix)
    _run([port.compiler, *made, *port.link_flags, "-o", str(image)])
    return image


def _sources(port: Port) -> list[Path]:
    """Return the C files of a port; the one with main() comes first, as SDCC's linker wants it."""
    found = [SOURCES / f"{name}.c" for name in (*CORE, *port.modules)]
    for folder in port.folders:
        found += sorted((SOURCES / folder).glob("*.c"))
    return sorted(found, key=lambda path: path.name != "main.c")


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"{' '.join(command)}\n{done.stdout}{done.stderr}")


def main(arguments: list[str]) -> int:
    """Return 0 where all images were built."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("ports", nargs="*", metavar="PORT", default=list(PORTS), help=f"of {', '.join(PORTS)} (default: all)")
    parser.add_argument("--out", type=Path, default=ROOT / "artifacts" / "firmware", metavar="FOLDER", help="where images go")
    options = parser.parse_args(arguments)
    status = 0
    for name in options.ports:
        if name not in PORTS:
            parser.error(f"no port {name!r}; there are {', '.join(PORTS)}")
        try:
            print(build(name, out=options.out))
        except BuildError as error:
            print(f"build_firmware: {name}: {error}", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
