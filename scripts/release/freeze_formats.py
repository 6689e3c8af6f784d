"""``make formats``: keep the files that this version leaves behind, so that every later one can be held to read them.

A small site runs for real: 46 biobots, a gateway that records its line, a mapper. What it leaves is packed into tests/data/formats/VERSION,
with what it tells today. To be run once for a release, when its version number has been set; a folder that is there is never written over.
"""

import argparse
import json
import lzma
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from scripts.release.formats import FROZEN, Told, tell_journal, tell_map, tell_recording, tell_run, tell_store, tell_tokens, unpack_frozen
from scripts.release.promises import tell_interfaces
from scripts.release.version import read_version
from studies.system import RunningSystem, SystemSettings

TELLERS: dict[str, Callable[[Path], Told]] = {
    "gateway.sqlite": tell_journal,
    "mapper.sqlite": tell_store,
    "line.biorec": tell_recording,
    "map.json": tell_map,
    "run": tell_run,
    "tokens.json": tell_tokens,
}
"""What is frozen, and what tells it."""
INTERFACES = "interfaces.json.xz"
"""OpenAPI document and flags (``scripts.release.promises``)."""
CONFIGURATIONS = {"gateway.toml": "gateway", "mapper.toml": "mapper"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Freeze the formats of this version; 0 where that was done."""
    parser = argparse.ArgumentParser(prog="make formats", description="Keep the files that this version leaves behind.")
    parser.add_argument("--out", type=Path, default=FROZEN / read_version(), help="where to (default: %(default)s)")
    out: Path = parser.parse_args(arguments).out
    if out.exists():
        print(f"error: {out} is there, and what a version left behind does not change; set a new version first", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as place:
        left = Path(place) / "left"
        run_a_site(left, Path(place) / "site")
        freeze(left, out)
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    print(f"{out}: {size / 1000:.0f} kB")
    return 0


def run_a_site(left: Path, out: Path) -> None:
    """Let a site run until the mapper has every encounter that the gateway has, and gather the files that it leaves."""
    left.mkdir(parents=True)
    gateway, mapper = ("--record", str(out)), ("--min-interval-s", "1")
    settings = SystemSettings(
        out=out, n_biobots=46, n_landmarks=12, dispersion_s=2, exploration_s=10, gateway_args=gateway, mapper_args=mapper
    )
    with RunningSystem(settings=settings) as system:
        system.process("simulator").wait()
        system.wait_for(lambda: system.get("/healthz")["n_encounters"] > 0 and _has_map(system), what="a map", timeout_s=60)
        system.wait_for(lambda: _journal(out, left) == _known(system), what="all encounters", timeout_s=60)
        system.post("/api/v1/stop", {})
    for name in ("gateway.sqlite", "mapper.sqlite", "tokens.json"):
        shutil.copyfile(out / name, left / name)
    (recording,) = out.glob("*.biorec")
    shutil.copyfile(recording, left / "line.biorec")
    run = left / "run"
    _call(
        "simulator", "run", "--scenario", "two-obstacles", "--seed", "1", "--biobots", "60", "--position-samples", "10", "--out", str(run)
    )
    _call("mapper", "run", str(run / "encounters.csv"), "--modes", str(run / "modes.csv"), "--json", str(left / "map.json"))
    for name, program in CONFIGURATIONS.items():
        (left / name).write_bytes(_call(program, "config", "print-default"))


def freeze(left: Path, out: Path) -> None:
    """Pack the files and note what they tell."""
    out.mkdir(parents=True)
    for path in sorted(left.rglob("*")):
        if path.is_file():
            target = out / path.relative_to(left)
            target.parent.mkdir(exist_ok=True)
            target.with_name(target.name + ".xz").write_bytes(lzma.compress(path.read_bytes(), preset=9))
    told = {name: asdict(tell_frozen(out, name)) for name in TELLERS if (left / name).exists()}
    (out / INTERFACES).write_bytes(lzma.compress(json.dumps(tell_interfaces()).encode(), preset=9))
    (out / "facts.json").write_text(json.dumps(told, indent=1) + "\n")


def tell_frozen(folder: Path, name: str) -> Told:
    """Tell a frozen file, or folder of files, by this version's programs; copies are opened."""
    with tempfile.TemporaryDirectory() as place:
        packed = folder / name
        if packed.is_dir():
            for path in packed.iterdir():
                unpack_frozen(path, Path(place))
            return TELLERS[name](Path(place))
        return TELLERS[name](unpack_frozen(folder / f"{name}.xz", Path(place)))


def _has_map(system: RunningSystem) -> bool:
    return system.get("/healthz")["map_version"] is not None


def _known(system: RunningSystem) -> int:
    n_encounters: int = system.get("/healthz")["n_encounters"]
    return n_encounters


def _journal(out: Path, left: Path) -> int:
    """Count the encounters in the journal of the running gateway, in a copy."""
    _call("gateway", "journal", "export", str(out / "gateway.sqlite"), "--csv", str(left / "so-far.csv"))
    n_rows = (left / "so-far.csv").read_text().count("\n") - 1
    (left / "so-far.csv").unlink()
    return n_rows


def _call(*arguments: str) -> bytes:
    return subprocess.run([sys.executable, "-m", *arguments], check=True, capture_output=True).stdout


if __name__ == "__main__":
    sys.exit(main())
