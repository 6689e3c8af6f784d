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
    return int(os.environ.get("SOURCE_DATE_EPOCH") or _ask_git("log", "-1", "--format=%ct") or 315532800)


def source_revision() -> str:
    """Return the commit that these sources are of, with ``-changed`` where they differ from it; ``unknown`` where git does not know."""
    commit = _ask_git("rev-parse", "HEAD")
    return f"{commit}-changed" if commit and _ask_git("status", "--porcelain", "--untracked-files=no") else commit or "unknown"


def _ask_git(*question: str) -> str:
    try:
        return subprocess.run(["git", *question], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    except FileNotFoundError:
        return ""


if __name__ == "__main__":
    print(read_version())
