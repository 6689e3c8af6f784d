"""Fuzzing of all that reads from a line, guided by coverage: ``python -m studies.fuzz_wire --inputs 10000000``.

Needs atheris (Apache-2.0; ``pip install -r requirements/fuzz.txt``, or ``make fuzz-wire``). Each target of ``wire_targets`` runs in a
process of its own, for its share of the inputs; the first input that breaks a law is written to a file, and ends its target. A table for
``docs/wire-fuzz.md`` is printed at the end.
"""

import argparse
import importlib
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_LONGEST_INPUT = {"framing": 700, "host": 2048, "dongle": 2048, "both ends": 1024, "dongle with faults": 2048}
"""By the first words of a target's name [B]: of framings, more than two frames; others have 300, more than a frame's body."""

_HANG_S = 10
_CODE = ("firmware_protocol", "simulator.dongles", "simulator.lines.faulty_dongle")
"""Packages whose branches guide the fuzzer."""

_WEIGHTS = {"host": 3, "dongle": 3, "both ends": 1, "dongle with faults": 1}
"""Share of the inputs, by the first words of a target's name; others have 8."""

_DONE = re.compile(r"Done (\d+) runs in (\d+) second")
_COVERAGE = re.compile(r"cov: (\d+) ft: (\d+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of one target."""

    target: str
    n_inputs: int
    seconds: float
    coverage: str
    finding: str

    def row(self) -> str:
        """Return a row of the table."""
        return f"| {self.target} | {self.n_inputs:,} | {self.seconds:.0f} | {self.coverage} | {self.finding or 'nothing'} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz; return the exit status: 0 nothing found, 1 something found or atheris missing, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.fuzz_wire", description="Fuzz everything that reads from a line.")
    parser.add_argument("--inputs", type=int, default=1_000_000, metavar="N", help="inputs over all targets (default: %(default)s)")
    parser.add_argument("--target", action="append", metavar="NAME", help="only this one; again for more (default: all)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the fuzzer (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("fuzz-out"), metavar="DIR", help="corpora and findings (default: %(default)s)")
    parser.add_argument("--one", metavar="NAME", help=argparse.SUPPRESS)  # the process of one target
    options = parser.parse_args(arguments)
    try:
        atheris_version = version("atheris")
    except PackageNotFoundError:
        print("error: atheris is not installed; run: make fuzz-wire, or pip install -r requirements/fuzz.txt", file=sys.stderr)
        return 1
    if options.one is not None:
        _fuzz_one(options.one, n_inputs=options.inputs, seed=options.seed, out=options.out)
    names = list(importlib.import_module("studies.wire_targets").TARGETS)
    chosen = options.target or names
    if options.inputs < 1 or not set(chosen) <= set(names):
        parser.error(f"--inputs {options.inputs} --target {chosen}; wanted at least 1 input, and targets of: {', '.join(names)}")
    weights = [_WEIGHTS.get(name.partition(":")[0], 8) for name in chosen]
    outcomes = []
    for name, weight in zip(chosen, weights, strict=True):
        outcomes.append(_run(name, n_inputs=-(-options.inputs * weight // sum(weights)), seed=options.seed, out=options.out))
        print(outcomes[-1].row(), file=sys.stderr, flush=True)
    print(f"atheris {atheris_version}, Python {sys.version.split()[0]}, seed {options.seed}, inputs of up to 300 to 2048 bytes\n")
    print("| target | inputs | seconds | branches, features | found |\n|---|---|---|---|---|")
    for outcome in outcomes:
        print(outcome.row())
    print(f"| all | {sum(one.n_inputs for one in outcomes):,} | {sum(one.seconds for one in outcomes):.0f} | | |")
    return 1 if any(outcome.finding for outcome in outcomes) else 0


def _run(name: str, *, n_inputs: int, seed: int, out: Path) -> Outcome:
    place = out / re.sub(r"\W+", "-", name)
    (place / "corpus").mkdir(parents=True, exist_ok=True)
    command = [
        sys.executable, "-m", "studies.fuzz_wire", "--one", name, "--inputs", str(n_inputs), "--seed", str(seed), "--out", str(place)
    ]  # fmt: skip
    begin = time.monotonic()
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace", check=False)
    seconds = time.monotonic() - begin
    (place / "log").write_text(done.stderr)
    told = _DONE.search(done.stderr)
    found = _COVERAGE.findall(done.stderr)
    finding = "" if told and done.returncode == 0 else f"status {done.returncode}, see {place / 'log'}"
    return Outcome(
        target=name,
        n_inputs=int(told[1]) if told else 0,
        seconds=seconds,
        coverage=", ".join(found[-1]) if found else "?",
        finding=finding,
    )


def _fuzz_one(name: str, *, n_inputs: int, seed: int, out: Path) -> None:
    """Fuzz one target and leave the process with the fuzzer's status."""
    atheris = importlib.import_module("atheris")
    with atheris.instrument_imports(include=list(_CODE)):
        targets = importlib.import_module("studies.wire_targets")
    logging = importlib.import_module("logging")
    logging.disable(logging.CRITICAL)  # a virtual dongle tells when its faults begin and end
    longest = _LONGEST_INPUT.get(name.partition(":")[0], 300)
    flags = [
        f"-runs={n_inputs}", f"-seed={seed}", f"-max_len={longest}", f"-timeout={_HANG_S}", f"-artifact_prefix={out}/",
        "-rss_limit_mb=1024", "-print_final_stats=1", str(out / "corpus"),
    ]  # fmt: skip
    atheris.Setup([sys.argv[0], *flags], targets.TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
