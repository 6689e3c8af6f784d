"""The compiled kernels touch no memory that is not theirs, whatever they are given."""

import subprocess
import sys
from pathlib import Path

import pytest

from hatch_build import find_compiler

ROOT = Path(__file__).parents[2]


def test_the_kernels_keep_to_their_memory_and_to_the_language() -> None:
    """A few examples here; ``make check-kernels`` takes as many as usual."""
    compiler = find_compiler()
    probe = "int main(void) { return 0; }"
    command = [*(compiler or "cc").split(), "-fsanitize=address,undefined", "-x", "c", "-", "-o", "/dev/null"]
    if compiler is None or subprocess.run(command, input=probe, text=True, capture_output=True, check=False).returncode:
        pytest.skip("no C compiler with the sanitizers' libraries here: install gcc")
    check = [sys.executable, "scripts/check_kernels.py", "tests/mapper/test_kernels.py", "--hypothesis-profile=few"]
    done = subprocess.run(check, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "skipped" not in done.stdout
