"""Install biobot on a machine, and map there: this runs on that machine, with Python's own library alone, and tells each step as JSON.

inside.py bundle BUNDLE WORK PROGRAM [DEMO_SPEED]     with install.sh, where there must be no network
inside.py wheel  BUNDLE WORK PROGRAM FILE             a wheel or an sdist in a bare environment, beside the bundle's wheels of all else
"""

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

_OUTSIDE = ("192.0.2.1", 443)  # RFC 5737: TEST-NET-1, which is nobody's


class StepError(Exception):
    """A step that did not do what it should."""


def main() -> int:
    """Take the steps; 0 where all went well."""
    kind, bundle, work, program, *rest = sys.argv[1:]
    try:
        if kind == "bundle":
            install_bundle(Path(bundle), Path(work), program, speed=rest[0] if rest else None)
        else:
            install_files(Path(bundle), Path(work), program, [Path(name) for name in rest])
    except StepError as error:
        print(json.dumps({"failed": str(error)}), flush=True)
        return 1
    return 0


def install_bundle(bundle: Path, work: Path, program: str, *, speed: str | None) -> None:
    """Install by the bundle's own installer where nobody can be reached, map, and let the demo run: three processes over loopback."""
    expect_no_network()
    tell("cut off", seconds=0, said="only loopback, and nobody can be reached")
    prefix = work / "prefix"
    step("install", ["sh", f"{bundle}/install.sh", "--prefix", str(prefix), "--python", program])
    (environment,) = prefix.iterdir()
    map_a_recording(environment / "bin", work)
    if speed is not None:
        run_demo(environment / "bin", work, speed=speed)


def install_files(bundle: Path, work: Path, program: str, files: list[Path]) -> None:
    """Install a wheel and then an sdist, which is compiled, with the dependencies that are pinned, and map with each."""
    environment = work / "environment"
    python = environment / "bin" / "python"
    step("environment", [program, "-m", "venv", "--without-pip", str(environment)])
    told = subprocess.run([str(python), "-c", _ASK], capture_output=True, text=True, check=True).stdout.strip()
    lines = (bundle / "requirements" / f"{told}.txt").read_text().splitlines(keepends=True)
    needed = work / "needed.txt"
    needed.write_text("".join(line for line in lines if not line.startswith("biobot-gateway==")))
    (pip,) = (bundle / "wheels").glob("pip-*.whl")
    # Nothing is compiled to bytecode ahead: that is most of the time, and no part of what is tried.
    install = [
        str(python),
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-index",
        "--no-cache-dir",
        "--no-compile",
        f"--find-links={bundle}/wheels",
    ]
    variables = {"PYTHONPATH": str(pip), "PIP_CONFIG_FILE": os.devnull, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    step("dependencies", [*install, "--no-deps", "--require-hashes", f"--requirement={needed}"], variables=variables)
    for file in files:
        if not file.name.endswith(".whl"):
            step("build tools", [*install, f"--find-links={bundle}/build-tools", "hatchling", "editables"], variables=variables)
        step(file.name, [*install, "--no-deps", "--no-build-isolation", "--force-reinstall", str(file)], variables=variables)
        step("pip check", [str(python), "-m", "pip", "check"])
        map_a_recording(environment / "bin", work / file.suffix)


_ASK = "import os, sys; print('%d.%d-%s' % (*sys.version_info[:2], os.uname().machine))"


def expect_no_network() -> None:
    """Raise where there is an interface beside loopback, or a way out."""
    names = [name for _, name in socket.if_nameindex()]
    if names != ["lo"]:
        raise StepError(f"there are network interfaces: {names}")
    with socket.socket() as outside:
        outside.settimeout(5)
        try:
            outside.connect(_OUTSIDE)
        except OSError:
            return
    raise StepError(f"{_OUTSIDE} answered")


def map_a_recording(programs: Path, work: Path) -> None:
    """Let insects walk among two obstacles, and map their encounters: two holes have to be found, with the compiled kernels."""
    work.mkdir(exist_ok=True)
    run, map_file = work / "run", work / "map.json"
    for name in ("biobot-gateway", "biobot-mapper", "biobot-sim"):
        step(f"{name} --version", [str(programs / name), "--version"])
    step("walk", [str(programs / "biobot-sim"), "run", "--scenario", "two-obstacles", "--seed", "1", "--out", str(run)])
    mapping = [str(programs / "biobot-mapper"), "run", f"{run}/encounters.csv", "--modes", f"{run}/modes.csv", "--json", str(map_file)]
    seconds = step("map", mapping, is_told=False)
    found: dict[str, Any] = json.loads(map_file.read_text())
    if found["betti_numbers"] != [1, 2]:
        raise StepError(f"the map has Betti numbers {found['betti_numbers']}, and the arena [1, 2]")
    tell("map", seconds=seconds, said=f"Betti numbers {found['betti_numbers']}, of {found['n_encounters']} encounters")


def run_demo(programs: Path, work: Path, *, speed: str) -> None:
    """Run simulator, gateway and mapper over loopback: every encounter has to arrive.

    How many of the arena's holes a map shows is left to it: the insects walk in real time, so on a busy machine no two runs are alike.
    """
    demo = [str(programs / "python"), "-m", "studies.demo", "--exit", "--speed", speed, "--out", f"{work}/demo"]
    begun = time.monotonic()
    done = subprocess.run(demo, capture_output=True, text=True, check=False, cwd="/")
    told = {line.split()[0]: " ".join(line.split()[1:]) for line in done.stdout.splitlines() if line.strip()}
    if "0 missing, 0 twice" not in told.get("encounters", "") or not (work / "demo" / "map.json").exists():
        raise StepError(f"demo: exit status {done.returncode}: {(done.stderr + done.stdout)[-2000:]}")
    holes, true_holes = told["holes"].split()[:2]
    tell("demo", seconds=time.monotonic() - begun, said=f"{holes} of {true_holes} holes; encounters {told['encounters']}")


def step(name: str, command: list[str], *, is_told: bool = True, variables: dict[str, str] | None = None) -> float:
    """Run a command, tell how long it took and what it said last, and return the former [s]."""
    begun = time.monotonic()
    environment = os.environ | (variables or {})
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd="/", env=environment)
    seconds = time.monotonic() - begun
    if done.returncode != 0:
        raise StepError(f"{name}: exit status {done.returncode}: {(done.stderr or done.stdout)[-2000:]}")
    if "plain kernels" in done.stderr:
        raise StepError(f"{name}: the compiled kernels do not run here: {done.stderr[-500:]}")
    if is_told:
        tell(name, seconds=seconds, said=(done.stdout.strip().splitlines() or [""])[-1])
    return seconds


def tell(name: str, *, seconds: float, said: str) -> None:
    """Write a step as a line of JSON."""
    print(json.dumps({"step": name, "seconds": round(seconds, 1), "said": said}), flush=True)


if __name__ == "__main__":
    sys.exit(main())
