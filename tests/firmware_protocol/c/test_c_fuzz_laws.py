"""The laws of the fuzzing targets hold on their seeds, which are the golden vectors and the edges of them; `make fuzz-c` goes further."""

import subprocess
import sys
from pathlib import Path

import pytest

from hatch_build import find_compiler

ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "scripts" / "fuzz_c.py"


def replay(*arguments: str, compiler: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, str(SCRIPT), "--replay", *arguments], cwd=ROOT, env={"CC": compiler, "PATH": "/usr/bin:/bin"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_seeds_break_no_law_and_touch_no_memory_that_is_not_theirs(tmp_path: Path) -> None:
    compiler = find_compiler()
    probe = "int main(void) { return 0; }"
    command = [*(compiler or "cc").split(), "-fsanitize=address,undefined", "-x", "c", "-", "-o", "/dev/null"]
    if compiler is None or subprocess.run(command, input=probe, text=True, capture_output=True, check=False).returncode:
        pytest.skip("no C compiler with the sanitizers' libraries here: install gcc")

    done = replay("--folder", str(tmp_path), compiler=compiler)

    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("nothing found") == 6
