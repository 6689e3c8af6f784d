"""A trial of what is released on one machine, and its report."""

import argparse
import json
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Callable
from pathlib import Path

from scripts.release.machines import Machine, find_machines
from scripts.release.version import ROOT, read_version

_INSIDE = ROOT / "scripts" / "release" / "inside.py"

Trial = Callable[[Machine, Path], bool]
"""Tries one machine, with the folder of the unpacked bundle; whether all went well."""


def make_parser(program: str, description: str) -> argparse.ArgumentParser:
    """Make the parser of a command that tries a release on machines."""
    parser = argparse.ArgumentParser(prog=f"make {program} ARGS=...", description=description)
    bundle = Path("dist") / f"biobot-{read_version()}-linux.tar"
    parser.add_argument("--bundle", type=Path, default=bundle, help="the archive (default: %(default)s)")
    parser.add_argument("--tree", type=Path, nargs="+", default=[], help="folders with other systems, as system_tree.sh makes them (root)")
    parser.add_argument("--only", nargs="+", default=[], metavar="PYTHON-MACHINE", help="try these alone, as 3.11-x86_64")
    return parser


def try_machines(trial: Trial, *, bundle: Path, trees: list[Path], only: list[str]) -> int:
    """Try all machines that are found and asked for; 0 where each does well, 1 where one does not or there is none.

    What is missing is told at the end, with the reason.
    """
    machines, missing = find_machines([tree.resolve() for tree in trees])
    n_tried = n_failed = 0
    for machine in machines:
        if only and machine.target not in only:
            continue
        with tempfile.TemporaryDirectory(dir=machine.scratch(), prefix="biobot-trial-") as place:
            folder = _unpack(bundle, Path(place))
            if not (folder / "requirements" / f"{machine.target}.txt").exists():
                missing.append(f"{machine.name}: the bundle has nothing for it")
                continue
            print(f"\n{machine.name}", flush=True)
            n_tried += 1
            n_failed += not trial(machine, folder)
    print()
    for reason in missing:
        print(f"not tried: {reason}")
    print(f"{n_tried} machines tried, {n_failed} failed")
    return 0 if n_tried and not n_failed else 1


def run_inside(machine: Machine, kind: str, folder: Path, *more: str) -> bool:
    """Take the steps of inside.py on a machine whose network is cut off, and print them as they are done."""
    with tempfile.TemporaryDirectory(dir=folder.parent) as place:
        inside = shutil.copy(_INSIDE, place)
        told = (machine.place(Path(inside)), kind, machine.place(folder), machine.place(Path(place)), machine.program)
        command = machine.command(machine.program, *told, *more)
        has_failed = False
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                step = json.loads(line)
                has_failed = "failed" in step
                said = f"FAILED     {step['failed']}" if has_failed else f"{step['seconds']:7.1f} s  {step['step']:<38} {step['said']}"
                print(f"  {said}", flush=True)
        return process.returncode == 0 and not has_failed


def _unpack(bundle: Path, place: Path) -> Path:
    with tarfile.open(bundle) as archive:
        archive.extractall(place, filter="data")
    (folder,) = place.iterdir()
    return folder
