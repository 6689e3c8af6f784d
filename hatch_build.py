"""Build hook: compile the C sources into shared libraries beside them, and tag the wheel for this platform.

A plain C compiler is all it takes; the libraries are called through ctypes, so they fit every Python. No headers of Python, no fused
multiply-adds, no fast maths: the same sources give the same results on every machine with IEEE 754 doubles. On a machine without a
compiler a wheel is made without them: gateway and mapper have a slower way for all that they do, the simulator cannot run.
"""

import os
import shlex
import shutil
import subprocess
import sysconfig
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ENGINE = Path("simulator") / "engine" / "_engine.so"
KERNELS = Path("mapper") / "kernels" / "_kernels.so"
BULK = Path("gateway") / "bulk" / "_bulk.so"
FLAGS = ("-std=c11", "-ffp-contract=off", "-fno-fast-math", "-fPIC", "-fvisibility=hidden", "-shared", "-Wall", "-Wextra")
LIBRARIES = {ENGINE: "-O2", KERNELS: "-O3", BULK: "-O3"}
_WIRE = Path("firmware_protocol") / "c"
ELSEWHERE = {
    BULK: tuple(
        _WIRE / name
        for name in ("biobot_codec.c", "biobot_codec.h", "biobot_crc.c", "biobot_crc.h", "biobot_frame.c", "biobot_frame.h",
                     "biobot_layouts.c", "biobot_layouts.h", "bulk/biobot_bulk.c", "bulk/biobot_bulk.h")
    )
}  # fmt: skip
"""Sources that a library has beside those of its own folder."""


class LibrariesBuildHook(BuildHookInterface):  # type: ignore[type-arg]  # hatchling is untyped here
    """Compiles the libraries before a wheel, editable or not, is put together."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and add the libraries to the wheel."""
        root = Path(self.root)
        compiler = find_compiler()
        if compiler is None:
            self.app.display_warning("biobot: no C compiler (gcc and libc6-dev): the simulator will not run, the mapper will be slow")
            return
        for library in LIBRARIES:
            compile_library(root, library, compiler=compiler)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
        if version != "editable":
            build_data["force_include"].update({str(root / library): str(library) for library in LIBRARIES})


def find_compiler() -> str | None:
    """Name the C compiler: CC, or the first there is; None without one."""
    return os.environ.get("CC") or next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)


def compile_library(root: Path, library: Path, *, compiler: str) -> None:
    """Compile the C files of a library of a source tree; it appears whole or not at all."""
    fresh = root / library.with_suffix(f".{os.getpid()}.so")
    files = sources_of(root, library)
    total = f"-DSOURCES={sum_sources(files)}"
    sources = [str(path) for path in files if path.suffix == ".c"]
    command = [*shlex.split(compiler), *FLAGS, LIBRARIES[library], total, *sources, "-o", str(fresh), "-lm"]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        reason = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
        message = f"biobot: {library} does not compile ({shlex.join(command)}):\n{reason}\ninstall gcc and libc6-dev, or set CC"
        raise SystemExit(message) from error
    fresh.replace(root / library)


def sources_of(root: Path, library: Path) -> list[Path]:
    """List the C files of a library: those beside it by name, then those from elsewhere."""
    folder = (root / library).parent
    return [*sorted((*folder.glob("*.c"), *folder.glob("*.h"))), *(root / path for path in ELSEWHERE.get(library, ()))]


def sum_sources(files: Iterable[Path]) -> int:
    """Return the CRC-32 of C sources, file after file: a library says which it was built from, and is not used with others."""
    total = 0
    for path in files:
        total = zlib.crc32(path.read_bytes(), total)
    return total
