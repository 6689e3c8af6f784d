"""The version of this source tree, ``project.version`` of pyproject.toml, where it is written once; and its date.

``python -m scripts.release.version`` prints it. What is installed takes it from the wheel's own facts (``importlib.metadata``).
"""

import os
import subprocess
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def read_version(root: Path = ROOT) -> str:
    """Return the version that a source tree says it has."""
    version: str = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    return version


def source_moment() -> int:
    """Return when these sources were committed [s, Unix time]: ``SOURCE_DATE_EPOCH``, else what git says, else 1980, where zip begins."""
    told = os.environ.get("SOURCE_DATE_EPOCH")
    if told is None:
        done = subprocess.run(["git", "log", "-1", "--format=%ct"], cwd=ROOT, capture_output=True, text=True, check=False)
        told = done.stdout.strip() or "315532800"
    return int(told)


if __name__ == "__main__":
    print(read_version())
