"""Build hook: compile the simulator's engine into a shared library beside its sources, and tag the wheel for this platform.

A plain C compiler is all it takes; the library is called through ctypes, so it fits every Python. No headers of Python, no fused
multiply-adds, no fast maths: the same sources give the same runs on every machine with IEEE 754 doubles.
"""

import os
import shlex
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ENGINE = Path("simulator") / "engine"
LIBRARY = ENGINE / "_engine.so"
FLAGS = ("-std=c11", "-O2", "-ffp-contract=off", "-fno-fast-math", "-fPIC", "-fvisibility=hidden", "-shared", "-Wall", "-Wextra")


class EngineBuildHook(BuildHookInterface):  # type: ignore[misc, type-arg]  # hatchling is untyped here
    """Compiles the engine before a wheel, editable or not, is put together."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and add the library to the wheel."""
        root = Path(self.root)
        compile_engine(root)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
        if version != "editable":
            build_data["force_include"][str(root / LIBRARY)] = str(LIBRARY)


def compile_engine(root: Path) -> None:
    """Compile the engine of a source tree; the library appears whole or not at all."""
    compiler = os.environ.get("CC") or next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
    if compiler is None:
        raise SystemExit("biobot: the simulator's engine needs a C compiler: install gcc and libc6-dev (Debian), or set CC")
    fresh = root / ENGINE / f"_engine.{os.getpid()}.so"
    sources = [str(path) for path in sorted((root / ENGINE).glob("*.c"))]
    command = [*shlex.split(compiler), *FLAGS, *sources, "-o", str(fresh), "-lm"]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except subprocess.CalledProcessError as error:
        message = f"biobot: the engine does not compile ({shlex.join(command)}):\n{error.stderr}\ninstall gcc and libc6-dev, or set CC"
        raise SystemExit(message) from error
    fresh.replace(root / LIBRARY)
