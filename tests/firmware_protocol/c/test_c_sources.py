"""The C sources are what the table of layouts says, and compile for every chip whose compiler is here."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)


def test_the_layouts_of_c_are_those_of_python() -> None:
    done = run("scripts/generate_c.py", "--check")

    assert done.returncode == 0, done.stderr


def test_every_target_compiles_without_a_warning_and_within_its_budget() -> None:
    done = run("scripts/firmware_size.py")

    assert done.returncode == 0, done.stdout + done.stderr
    assert "Cortex-M0+" in done.stdout
    assert "8051" in done.stdout
