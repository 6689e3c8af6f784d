"""Build hook: compile the C sources into shared libraries beside them, and tag the wheel for this platform.

A plain C compiler is all it takes; the libraries are called through ctypes, so they fit every Python. No headers of Python, no fused
multiply-adds, no fast maths: the same sources give the same results on every machine with IEEE 754 doubles. On a machine without a
compiler a wheel is made without them: the gateway needs none, the mapper has a slower way for all its kernels, the simulator cannot run.
"""

import os
import shlex
import shutil
import subprocess
import sysconfig
import zlib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ENGINE = Path("simulator") / "engine" / "_engine.so"
KERNELS = Path("mapper") / "kernels" / "_kernels.so"
FLAGS = ("-std=c11", "-ffp-contract=off", "-fno-fast-math", "-fPIC", "-fvisibility=hidden", "-shared", "-Wall", "-Wextra")
LIBRARIES = {ENGINE: "-O2", KERNELS: "-O3"}


class LibrariesBuildHook(BuildHookInterface):  # type: ignore[misc, type-arg]  # hatchling is untyped here
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
    """Compile the C files beside a library of a source tree; it appears whole or not at all."""
    fresh = root / library.with_suffix(f".{os.getpid()}.so")
    folder = (root / library).parent
    sources = [str(path) for path in sorted(folder.glob("*.c"))]
    command = [*shlex.split(compiler), *FLAGS, LIBRARIES[library], f"-DSOURCES={sum_sources(folder)}", *sources, "-o", str(fresh), "-lm"]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        reason = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
        message = f"biobot: {library} does not compile ({shlex.join(command)}):\n{reason}\ninstall gcc and libc6-dev, or set CC"
        raise SystemExit(message) from error
    fresh.replace(root / library)


def sum_sources(folder: Path) -> int:
    """Return the CRC-32 of the C sources, file after file by name: a library says which it was built from, and is not used with others."""
    total = 0
    for path in sorted((*folder.glob("*.c"), *folder.glob("*.h"))):
        total = zlib.crc32(path.read_bytes(), total)
    return total
