"""Run the mapper's tests of kernels on kernels that watch every access to memory and every number (make check-kernels).

The sources are copied to a temporary folder and compiled there with the address and undefined-behaviour sanitizers; the first report ends
the run. Arguments are pytest's; without any, all tests of `tests/mapper/test_kernels.py` and of the graphs run.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from hatch_build import KERNELS, compile_library, find_compiler  # noqa: E402  # found by the line above

_TREE = ("firmware_protocol", "mapper", "tests", "pyproject.toml")
_TESTS = ("test_kernels", "test_encounter_graph", "test_metric", "test_profiles", "test_plain_rows", "test_smoothing")
_SANITIZERS = "-g -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer"


def main(arguments: list[str]) -> int:
    """Return pytest's status, or 1 where there is no compiler with sanitizers."""
    compiler = find_compiler()
    runtime = _find_runtime(compiler) if compiler else None
    if compiler is None or runtime is None:
        print("check_kernels: no C compiler with libasan here; install gcc", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in _TREE:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
            else:
                shutil.copy(source, copy / name)
        compile_library(copy, KERNELS, compiler=f"{compiler} {_SANITIZERS}")
        environment = os.environ | {
            "LD_PRELOAD": runtime,
            # Python keeps what it has until it ends; that is no leak of ours.
            "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1:allocator_may_return_null=1",
            "UBSAN_OPTIONS": "print_stacktrace=1",
            "BIOBOT_KERNELS": "compiled",
            "PYTHONPATH": folder,
        }
        tests = arguments or [f"tests/mapper/{name}.py" for name in _TESTS]
        command = [sys.executable, "-m", "pytest", "-q", "--capture=no", "-p", "no:cacheprovider", *tests]
        return subprocess.run(command, cwd=copy, env=environment, check=False).returncode


def _find_runtime(compiler: str) -> str | None:
    """Find the sanitizer's library: it must be loaded before Python's own allocator."""
    command = [*compiler.split(), "-print-file-name=libasan.so"]
    path = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    return str(Path(path).resolve()) if Path(path).is_absolute() else None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
