"""Throw inputs at the C side under libFuzzer and the address and undefined-behaviour sanitizers (make fuzz-c; needs clang).

    python scripts/fuzz_c.py                       20,000 inputs for each target: half a minute
    python scripts/fuzz_c.py --inputs 10000000     the campaign whose result is in docs/wire-fuzz.md
    python scripts/fuzz_c.py --targets fuzz_link   some of them
    python scripts/fuzz_c.py --replay              the seeds alone, with any C compiler: a second; what the tests do

Seeds are the golden vectors of `firmware_protocol/vectors`, and what earlier runs found (`artifacts/fuzz-c`). Exit 1 where an input breaks
a law, reads or writes what it must not, hangs, or takes more memory than the limit; the input is kept and named.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "firmware_protocol" / "c"
VECTORS = ROOT / "firmware_protocol" / "vectors"
COMPILER = "clang"
FLAGS = ("-std=c11", "-g", "-Wall", "-Wextra", "-Werror", "-fno-omit-frame-pointer", "-fno-sanitize-recover=all")
FUZZING = ("-O2", "-fsanitize=fuzzer,address,undefined")
REPLAYING = ("-O1", "-fsanitize=address,undefined")
MEMORY_LIMIT_MB = 256
"""For the whole process, sanitizers and corpus included; a single allocation may take an eighth of it."""
HANG_S = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A fuzzing target: its modules besides its own file, and where its seeds come from."""

    modules: tuple[str, ...]
    longest: int
    """Octets of an input."""
    seeds: Callable[[], Iterator[bytes]]
    defines: tuple[str, ...] = ()


def _vectors(name: str) -> list[dict[str, Any]]:
    vectors: list[dict[str, Any]] = json.loads((VECTORS / f"{name}.json").read_text())
    return vectors


def _frame_seeds() -> Iterator[bytes]:
    for vector in _vectors("framing"):
        yield bytes.fromhex(vector["hex"])
    for size in (250, 251, 252, 253, 254, 255, 300):  # around the longest body
        yield bytes([0, min(size + 1, 255), *([0x11] * size), 0])


def _codec_seeds() -> Iterator[bytes]:
    """Yield the octet that chooses the kind, then the message."""
    for kind, name in enumerate(("uplink", "downlink", "envelope")):
        for vector in _vectors(name):
            yield bytes([kind]) + bytes.fromhex(vector["hex"])


def _link_seeds() -> Iterator[bytes]:
    """Yield the role, then frames received (action 0), frames taken (4) and time passed (5)."""
    for story in _vectors("link_sessions"):
        seed = bytes([story["role"] == "initiator"])
        for step in story["steps"]:
            body = bytes.fromhex(step["what"]) if step["do"] == "receive" else b""
            if step["do"] == "receive" and len(body) < 32:
                seed += bytes([len(body) << 3]) + body
            seed += bytes([4, 5, 100, 0])
        yield seed


def _coordinator_seeds() -> Iterator[bytes]:
    """Yield a session that is opened (action 2), an envelope that is said in it (1), and what the coordinator says let out (3)."""
    reset = b"\x92\x01\x01\x00\x00"  # of link version 1, session 1
    sends = (b"\x20\x34\x12\x78\x56" + bytes([0xA5] * size) for size in (0, 1, 57, 58, 235))
    configurations = (b"\x13\x01\x00\xff\xff" + bytes([channel, 255]) for channel in (0, 10, 11, 26, 27))
    envelopes = [bytes.fromhex(vector["hex"]) for vector in _vectors("envelope")]
    for envelope in (*envelopes, *sends, *configurations):
        if len(envelope) <= 240:
            yield reset + b"\x03\xff\x01" + bytes([len(envelope)]) + envelope + b"\x03\xff"


def _backpack_seeds() -> Iterator[bytes]:
    """Yield each message of the format given to a backpack to report (action 3) or to hear (1), then said (5) and acknowledged (2)."""
    for vector in _vectors("uplink"):
        payload = bytes.fromhex(vector["hex"])
        if len(payload) <= 57:
            yield b"\x05\x03" + payload.ljust(57, b"\0")[:57] + b"\x05\x06\xff\x02\x00\x00\x05"
            yield b"\x05\x03" + payload  # the last action: a block takes what there is
    for vector in _vectors("downlink"):
        payload = bytes.fromhex(vector["hex"])
        if "fields" in vector:
            body = payload[4:-2].ljust(40, b"\0")[:40]
            yield (bytes([1 | (payload[0] - 0x81) << 3]) + body + b"\x07\x05") * 2
    yield b"\x05" + b"\x04\x01\x05\x82" * 40  # the oldest number is never acknowledged, and the window comes to its end


def _delivery_seeds() -> Iterator[bytes]:
    """Yield both ends given payloads, frames put on the wire and carried over, some lost, some doubled."""
    yield bytes([2, 3, 0x82, 0x83] * 3 + [0, 0x80, 2, 0x82, 3, 0x83, 5, 0x45, 0xC5, 6 | 15 << 3] * 6)


TARGETS = {
    "fuzz_backpack": Target(modules=("backpack", "codec", "crc", "layouts"), longest=600, seeds=_backpack_seeds),
    "fuzz_frame": Target(modules=("crc", "frame"), longest=600, seeds=_frame_seeds),
    "fuzz_codec": Target(modules=("codec", "crc", "layouts"), longest=256, seeds=_codec_seeds),
    "fuzz_link": Target(modules=("link",), longest=600, seeds=_link_seeds, defines=("-DBB_LINK_INITIATOR=1",)),
    "fuzz_delivery": Target(modules=("link",), longest=400, seeds=_delivery_seeds, defines=("-DBB_LINK_INITIATOR=1",)),
    "fuzz_coordinator": Target(modules=("codec", "coordinator", "crc", "frame", "layouts", "link"), longest=1000, seeds=_coordinator_seeds),
}


def compile_target(name: str, folder: Path, *, compiler: str, flags: Sequence[str], extra: Sequence[str] = ()) -> Path:
    """Compile a target, with what else it takes to make a program of it; a warning is an error."""
    target = TARGETS[name]
    program = folder / name
    modules = (f"biobot_{module}" for module in target.modules)
    sources = [SOURCES / f"{source}.c" for source in (f"fuzz/{name}", *extra, *modules)]
    command = [*compiler.split(), *FLAGS, *flags, *target.defines, f"-I{SOURCES}", *map(str, sources), "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name} does not compile ({' '.join(command)}):\n{done.stderr}")
    return program


def write_seeds(name: str, corpus: Path) -> list[Path]:
    """Put the seeds of a target into its corpus, and return them."""
    corpus.mkdir(parents=True, exist_ok=True)
    seeds = []
    for index, seed in enumerate(TARGETS[name].seeds()):
        seeds.append(corpus / f"seed-{index:04}")
        seeds[-1].write_bytes(seed[: TARGETS[name].longest])
    return seeds


def replay(name: str, *, compiler: str, folder: Path) -> str | None:
    """Run a target on its seeds alone; return what was found, or None."""
    program = compile_target(name, folder, compiler=compiler, flags=REPLAYING, extra=["fuzz/replay"])
    seeds = write_seeds(name, folder / "corpus" / name)
    done = subprocess.run([str(program), *map(str, seeds)], capture_output=True, text=True, check=False)
    print(f"{name}: {len(seeds)} seeds, {'nothing found' if done.returncode == 0 else 'FOUND SOMETHING'}")
    return None if done.returncode == 0 else f"{name}: exit status {done.returncode}\n{done.stderr[-4000:]}"


def fuzz(name: str, *, inputs: int, seed: int, folder: Path) -> str | None:
    """Run a target and print its row; return what was found, or None."""
    program = compile_target(name, folder, compiler=COMPILER, flags=FUZZING)
    corpus, found = folder / "corpus" / name, folder / "found"
    write_seeds(name, corpus)
    found.mkdir(exist_ok=True)
    command = [
        str(program), str(corpus), f"-runs={inputs}", f"-seed={seed}", f"-max_len={TARGETS[name].longest}", f"-timeout={HANG_S}",
        f"-rss_limit_mb={MEMORY_LIMIT_MB}", f"-malloc_limit_mb={MEMORY_LIMIT_MB // 8}", f"-artifact_prefix={found}/{name}-",
        "-print_final_stats=1", "-verbosity=1",
    ]  # fmt: skip
    environment = os.environ | {"ASAN_OPTIONS": "quarantine_size_mb=4:malloc_context_size=0", "UBSAN_OPTIONS": "print_stacktrace=1"}
    began = time.monotonic()
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    lasted = time.monotonic() - began
    output = done.stderr.decode(errors="replace")
    counts = dict(re.findall(r"^stat::(\w+):\s+(\d+)", output, re.MULTILINE))
    edges = re.findall(r"cov: (\d+)", output)
    n = int(counts.get("number_of_executed_units", 0))
    verdict = "nothing found" if done.returncode == 0 else "FOUND SOMETHING"
    print(
        f"| {name.removeprefix('fuzz_'):<11} | {n:>10,} | {lasted:>6,.0f} | {n / lasted:>8,.0f} | {edges[-1] if edges else '-':>5} "
        f"| {sum(1 for _ in corpus.iterdir()):>6,} | {counts.get('peak_rss_mb', '-'):>8} | {verdict} |",
        flush=True,
    )
    return None if done.returncode == 0 else output[-4000:]


def main(arguments: list[str]) -> int:
    """Return 1 where something was found or cannot be run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=20_000, metavar="N", help="for each target (default: 20000)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of libFuzzer (default: 1)")
    parser.add_argument("--targets", nargs="+", default=list(TARGETS), choices=list(TARGETS), metavar="NAME", help=", ".join(TARGETS))
    parser.add_argument("--folder", type=Path, default=ROOT / "artifacts" / "fuzz-c", help="for programs, corpora and what is found")
    parser.add_argument("--replay", action="store_true", help="run the seeds alone, with CC or cc; no clang is needed")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.replay:
        findings = [replay(name, compiler=os.environ.get("CC") or "cc", folder=options.folder) for name in options.targets]
    elif shutil.which(COMPILER) is None:
        print("fuzz_c: no clang here; install clang and its runtime (Debian: clang libclang-rt-14-dev)", file=sys.stderr)
        return 1
    else:
        print("| target      |     inputs |      s | inputs/s | edges | corpus | RSS [MB] | result |")
        print("|---|---|---|---|---|---|---|---|")
        findings = [fuzz(name, inputs=options.inputs, seed=options.seed, folder=options.folder) for name in options.targets]
    for finding in filter(None, findings):
        print(finding, file=sys.stderr)
    return 1 if any(findings) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
