"""Build the images, run both compose files, and say how large, how long and what was seen; ``make containers``."""

import argparse
import json
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from scripts.containers.checks import check_demo, check_labels, check_site
from scripts.containers.podman import CheckFailedError, Podman, missing
from scripts.debian_root import make_root
from scripts.release.version import read_version, source_revision

_ROOT = Path(__file__).parents[2]
_TARGETS = ("gateway", "router", "mapper", "simulator")
_BASE = "docker.io/library/debian:bookworm-slim"
_SUITE = "bookworm"


def main(arguments: Sequence[str] | None = None) -> int:
    """Do it; 0 all is as it should be, or skipped with --skip; 1 something is not; 2 something is missing here."""
    options = _parser().parse_args(arguments)
    if problems := missing():
        print("containers cannot be built and run here:", *(f"  {problem}" for problem in problems), sep="\n", file=sys.stderr)
        if options.skip:
            print("skipped: make containers")
            return 0
        return 2
    podman = Podman(options.home.resolve())
    facts: dict[str, object] = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "machine": platform.machine(), "versions": _versions()}
    say = _Said(facts)
    try:
        if not options.no_build:
            _build(podman, facts)
        for name, check in (("demo", check_demo), ("site", check_site)):
            if options.only in {None, name}:
                say.part = name
                check(podman, say)
    except (CheckFailedError, subprocess.SubprocessError) as error:
        print(f"failed: {error}", file=sys.stderr)
        return 1
    finally:
        (podman.home / "result.json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    print(f"all as it should be; {podman.home / 'result.json'}")
    return 0


class _Said:
    """Prints what was seen with the time that it took, and keeps it for the result."""

    def __init__(self, facts: dict[str, object]) -> None:
        self._facts = facts
        self._started = time.monotonic()
        self.part = ""

    def __call__(self, text: str) -> None:
        print(f"{time.monotonic() - self._started:6.0f} s  {self.part}: {text}", flush=True)
        lines = self._facts.setdefault(self.part, [])
        assert isinstance(lines, list)
        lines.append(text)


def _build(podman: Podman, facts: dict[str, object]) -> None:
    if podman.attempt("image", "exists", _BASE).returncode:
        root = podman.home / "base"
        started = time.monotonic()
        make_root(root, suite=_SUITE, is_slim=True)
        with subprocess.Popen(["tar", "--directory", str(root), "--create", "."], stdout=subprocess.PIPE) as archive:
            podman.load_root(archive.stdout, name=_BASE)
        print(f"{_BASE} made by debootstrap in {time.monotonic() - started:.0f} s", flush=True)
    values = {"VERSION": read_version(), "REVISION": source_revision()}
    images = {}
    for target in _TARGETS:
        tag = f"localhost/biobot-{target}:latest"
        took_s = podman.build(target, tag=tag, dockerfile=_ROOT / "docker" / "Dockerfile", context=_ROOT, values=values)
        check_labels(podman, target, tag=tag, values=values)
        size_mb = int(podman.run("image", "inspect", "--format", "{{.Size}}", tag)) / 1e6
        images[target] = {"size_mb": round(size_mb), "build_s": round(took_s)}
        print(f"{target:10} {size_mb:5.0f} MB, built in {took_s:.0f} s", flush=True)
    facts["base_mb"] = round(int(podman.run("image", "inspect", "--format", "{{.Size}}", _BASE)) / 1e6)
    facts["images"] = images


def _versions() -> dict[str, str]:
    asked = {"podman": ["podman", "--version"], "buildah": ["buildah", "--version"], "podman-compose": ["podman-compose", "--version"]}
    return {
        name: (subprocess.run(command, capture_output=True, text=True, check=False).stdout.splitlines() or ["?"])[0]
        for name, command in asked.items()
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="make containers ARGS=...", description=(__doc__ or "").partition(";")[0] + ".")
    parser.add_argument("--only", choices=["demo", "site"], help="run this compose file alone")
    parser.add_argument("--no-build", action="store_true", help="run what was built before")
    parser.add_argument("--skip", action="store_true", help="where something is missing, say what and count as done")
    parser.add_argument(
        "--home", type=Path, default=Path("artifacts/containers"), help="store, logs and result (default: artifacts/containers)"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
