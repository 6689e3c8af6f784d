"""Compile the C side with every compiler that is here, without a warning, and print code and RAM for each target (make check-c).

    python scripts/firmware_size.py           a table, module by module
    python scripts/firmware_size.py --quiet   only what is wrong

Exit 1 where a compiler warns or a budget is exceeded; compilers that are not installed are named and passed over.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[1] / "firmware_protocol" / "c"
WARNINGS = ("-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror")
GNU_FLAGS = ("-Os", "-ffreestanding", "-ffunction-sections", "-fcallgraph-info=su")
CODEC_AND_LINK = ("biobot_crc", "biobot_frame", "biobot_layouts", "biobot_codec", "biobot_link")
CODE_BUDGET = 6 * 1024
RAM_BUDGET = 512
CC2530_CODE = 256 * 1024
CC2530_RAM = 8 * 1024

# What codec and link keep in RAM: the state of both, the frame that goes out, and the message that is looked at. A decoder's and a link's
# memory is its owner's, so no module's own size shows it.
STATE = """
#include "biobot_codec.h"
#include "biobot_coordinator.h"
#include "biobot_frame.h"
#include "biobot_link.h"
struct bb_frame_decoder state_decoder;
struct bb_link state_link;
struct bb_link_event state_event;
struct bb_envelope state_envelope;
uint8_t state_frame[BB_COORDINATOR_FRAME_SIZE];
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A compiler and what it compiles for."""

    name: str
    compiler: str
    flags: tuple[str, ...]
    size_tool: str = ""
    """Of GNU binutils; none for SDCC."""


TARGETS = (
    Target(name="Cortex-M0+", compiler="arm-none-eabi-gcc", flags=("-mcpu=cortex-m0plus", "-mthumb"), size_tool="arm-none-eabi-size"),
    Target(name="Cortex-M3", compiler="arm-none-eabi-gcc", flags=("-mcpu=cortex-m3", "-mthumb"), size_tool="arm-none-eabi-size"),
    Target(name="this machine", compiler="gcc", flags=(), size_tool="size"),
    Target(name="8051 (CC2530)", compiler="sdcc", flags=("-mmcs51", "--model-large", "--std-c11", "--opt-code-size")),
)


@dataclass(slots=True)
class Report:
    """Sizes [B] of a target: code with constants, and RAM, by module; RAM of codec and link; deepest stack of codec and link."""

    code: dict[str, int] = field(default_factory=dict)
    ram: dict[str, int] = field(default_factory=dict)
    state: int = 0
    stack: int | None = None


def compile_file(target: Target, source: Path, folder: Path, extra: Sequence[str] = ()) -> Path:
    """Compile one file; a warning is an error."""
    is_gnu = bool(target.size_tool)
    output = folder / source.with_suffix(".o" if is_gnu else ".rel").name
    flags = (*WARNINGS, *GNU_FLAGS) if is_gnu else ()
    command = [target.compiler, *target.flags, *flags, *extra, f"-I{SOURCES}", "-c", str(source), "-o", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    if done.returncode or "warning" in done.stderr:
        raise SystemExit(f"{source.name} for {target.name} ({' '.join(command)}):\n{done.stderr}")
    return output


def measure(target: Target, output: Path) -> tuple[int, int]:
    """Return code with constants and RAM of an object file [B]."""
    if target.size_tool:
        done = subprocess.run([target.size_tool, str(output)], capture_output=True, text=True, check=True)
        text, data, bss = (int(word) for word in done.stdout.splitlines()[1].split()[:3])
        return text + data, data + bss
    sizes = {name: int(size, 16) for name, size in re.findall(r"^A (\S+) size ([0-9A-F]+)", output.read_text(), re.MULTILINE)}
    code = sum(sizes.get(name, 0) for name in ("CSEG", "CONST", "HOME", "GSINIT", "GSFINAL", "XINIT"))
    return code, sum(sizes.get(name, 0) for name in ("XSEG", "XISEG", "PSEG", "DSEG", "OSEG", "ISEG", "BSEG"))


def deepest_stack(folder: Path) -> int:
    """Return the deepest stack [B] that a chain of calls in the objects of a folder takes, as GCC tells; there is no recursion."""
    frames: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for path in sorted(folder.glob("*.ci")):
        text = path.read_text()
        for name, size in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes \(', text):
            frames[name] = int(size)
        for caller, called in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            calls.setdefault(caller, set()).add(called)
    depths: dict[str, int] = {}

    def depth(name: str) -> int:
        if name not in depths:
            depths[name] = frames.get(name, 0) + max((depth(called) for called in calls.get(name, ())), default=0)
        return depths[name]

    return max((depth(name) for name in frames), default=0)


def report(target: Target) -> Report:
    """Compile everything for a target."""
    found = Report()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for source in sorted(SOURCES.glob("*.c")):
            output = compile_file(target, source, folder)
            if source.stem not in CODEC_AND_LINK:
                for path in folder.glob(f"{source.stem}*.ci"):
                    path.unlink()
            found.code[source.stem], found.ram[source.stem] = measure(target, output)
        found.stack = deepest_stack(folder) if target.size_tool else None
        state = folder / "state.c"
        state.write_text(STATE)
        found.state = measure(target, compile_file(target, state, folder))[1]
        # The initiator's half, and the configurations that nobody measures, must compile as well.
        compile_file(target, SOURCES / "biobot_link.c", folder, ("-DBB_LINK_INITIATOR=1",))
    return found


def show(target: Target, found: Report) -> None:
    """Print a target's sizes."""
    print(f"\n{target.name}: {target.compiler} {' '.join((*target.flags, *(('-Os',) if target.size_tool else ())))}")
    print(f"  {'module':24}{'code [B]':>10}{'RAM [B]':>10}")
    for module, code in found.code.items():
        print(f"  {module:24}{code:>10,}{found.ram[module]:>10,}")
    code = sum(found.code[module] for module in CODEC_AND_LINK)
    own = sum(found.ram[module] for module in CODEC_AND_LINK)
    stack = "" if found.stack is None else f" + {found.stack} of stack"
    print(f"  codec and link: code {code:,}, RAM {own + found.state:,} (state {found.state:,} + their own {own:,}){stack}")


def faults(target: Target, found: Report) -> list[str]:
    """Tell which budgets a target exceeds."""
    code = sum(found.code[module] for module in CODEC_AND_LINK)
    ram = sum(found.ram[module] for module in CODEC_AND_LINK) + found.state + (found.stack or 0)
    wrong = []
    if target.name == "Cortex-M0+":
        if code > CODE_BUDGET:
            wrong.append(f"{target.name}: codec and link take {code:,} B of code, the budget is {CODE_BUDGET:,}")
        if ram > RAM_BUDGET:
            wrong.append(f"{target.name}: codec and link take {ram:,} B of RAM with stack, the budget is {RAM_BUDGET:,}")
    if target.compiler == "sdcc":
        if sum(found.code.values()) > CC2530_CODE:
            wrong.append(f"{target.name}: all code takes {sum(found.code.values()):,} B, the flash has {CC2530_CODE:,}")
        if sum(found.ram.values()) > CC2530_RAM:
            wrong.append(f"{target.name}: all RAM takes {sum(found.ram.values()):,} B, the chip has {CC2530_RAM:,}")
    return wrong


def main() -> int:
    """Compile, print, judge."""
    parser = argparse.ArgumentParser(description="Compile the C side for every target and print its size.")
    parser.add_argument("--quiet", action="store_true", help="print only what is wrong")
    arguments = parser.parse_args()
    wrong = []
    for target in TARGETS:
        if shutil.which(target.compiler) is None:
            print(f"{target.name}: no {target.compiler} here (make system-packages)")
            continue
        found = report(target)
        if not arguments.quiet:
            show(target, found)
        wrong += faults(target, found)
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
