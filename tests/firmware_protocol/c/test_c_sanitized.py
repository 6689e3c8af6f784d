"""The C side touches no memory that is not its own, whatever arrives: its tests once more, under the sanitizers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hatch_build import find_compiler

ROOT = Path(__file__).parents[3]
_SANITIZERS = "-g -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer"


def test_the_c_side_keeps_to_its_memory_and_to_the_language() -> None:
    compiler = find_compiler()
    runtime = _runtime(compiler) if compiler else None
    if compiler is None or runtime is None:
        pytest.skip("no C compiler with the sanitizers' libraries here: install gcc")
    environment = os.environ | {
        "CC": f"{compiler} {_SANITIZERS}",
        "LD_PRELOAD": runtime,
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own are none of ours
        "PYTHONPATH": str(ROOT),
    }
    names = ("agreement", "backpack", "coordinator", "link")
    tests = [f"tests/firmware_protocol/c/test_c_{name}.py" for name in names] + ["tests/gateway/test_bulk.py"]
    check = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--hypothesis-profile=few", "-k", "not more_frames", *tests]
    done = subprocess.run(check, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "skipped" not in done.stdout


def _runtime(compiler: str) -> str | None:
    """Return the sanitizer's library, which must be loaded before Python's own."""
    probe = "int main(void) { return 0; }"
    command = [*compiler.split(), "-fsanitize=address,undefined", "-x", "c", "-", "-o", "/dev/null"]
    if subprocess.run(command, input=probe, text=True, capture_output=True, check=False).returncode:
        return None
    done = subprocess.run([*compiler.split(), "-print-file-name=libasan.so"], capture_output=True, text=True, check=False)
    path = done.stdout.strip()
    return path if Path(path).is_absolute() else None
