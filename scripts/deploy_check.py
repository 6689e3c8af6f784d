"""Check units and udev rules of gateway/installation/system with systemd's own tools; what a tool finds, or says at all, is a fault.

``systemd-analyze verify`` only warns of unknown keys and returns 0, so each line that it writes counts. The commands of the units are
replaced by one that is there, because /opt/biobot is not there where this is checked. ``udevadm verify`` came with systemd 254; before it,
the rules are held against their grammar here (udev(7)).
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SYSTEM = Path(__file__).parents[1] / "gateway" / "installation" / "system"
MAX_EXPOSURE = 20
"""Most exposure that ``systemd-analyze security`` may find, in tenths: 2.0 of 10. Units without any protection have 9.6."""

MATCHES = {"ACTION", "ATTR", "ATTRS", "DEVPATH", "DRIVER", "DRIVERS", "ENV", "KERNEL", "KERNELS", "SUBSYSTEM", "SUBSYSTEMS", "TAG", "TEST"}
ASSIGNMENTS = {"ATTR", "ENV", "GOTO", "GROUP", "IMPORT", "LABEL", "MODE", "OPTIONS", "OWNER", "SYMLINK", "TAG"}
_TOKEN = re.compile(r'\s*([A-Z]+)(\{[^}"]+\})?\s*(==|!=|\+=|-=|:=|=)\s*"([^"]*)"\s*(,|$)')


def check_units(folder: Path = SYSTEM) -> list[str]:
    """Return what systemd finds wrong with the units, and those that are too exposed."""
    units = sorted(folder.glob("*.service"))
    problems = [] if units else [f"{folder}: no units"]
    with tempfile.TemporaryDirectory() as place:
        copies = []
        for unit in units:
            copy = Path(place) / unit.name
            copy.write_text(re.sub(r"^(Exec\w+=)/opt/biobot/bin/\S+", rf"\1{shutil.which('true')}", unit.read_text(), flags=re.MULTILINE))
            copies.append(copy)
        for copy in copies:
            told = _run("systemd-analyze", "verify", "--man=no", str(copy))
            problems += [f"{copy.name}: {line}" for line in told.splitlines()]
            told = _run(
                "systemd-analyze", "security", "--offline=true", f"--threshold={MAX_EXPOSURE}", "--no-pager", str(copy), only_failed=True
            )
            problems += [f"{copy.name}: {line}" for line in told.splitlines() if "Overall exposure" in line or "Failed" in line]
    return problems


def exposures(folder: Path = SYSTEM) -> dict[str, str]:
    """Return what ``systemd-analyze security`` says of each unit, in one line."""
    found = {}
    for unit in sorted(folder.glob("*.service")):
        told = subprocess.run(
            ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)], capture_output=True, text=True, check=False
        )
        found[unit.name] = next((line.strip("→ ") for line in told.stdout.splitlines() if "Overall exposure" in line), told.stderr)
    return found


def check_rules(folder: Path = SYSTEM) -> list[str]:
    """Return what is wrong with the rules, by udev where it can tell, and by its grammar."""
    rules = sorted(folder.glob("*.rules"))
    problems = [] if rules else [f"{folder}: no rules"]
    for path in rules:
        problems += _grammar(path)
        if _can_verify():
            told = _run("udevadm", "verify", "--no-summary", str(path), only_failed=True)
            problems += [f"{path.name}: {line}" for line in told.splitlines()]
    return problems


def _grammar(path: Path) -> list[str]:
    problems, labels, jumps = [], set(), set()
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        at = 0
        while at < len(line):
            token = _TOKEN.match(line, at)
            if token is None:
                problems.append(f'{path.name}:{number}: no KEY{{name}}=="value" at {line[at:]!r}')
                break
            at = token.end()
            key, _, operator, value, comma = token.groups()
            if key not in (MATCHES if operator in {"==", "!="} else ASSIGNMENTS):
                problems.append(f"{path.name}:{number}: {key} cannot stand before {operator}")
            if comma and at >= len(line.rstrip()):
                problems.append(f"{path.name}:{number}: nothing follows the last comma")
            labels |= {value} if key == "LABEL" else set()
            jumps |= {value} if key == "GOTO" else set()
    return problems + [f"{path.name}: no LABEL {name!r} for GOTO" for name in sorted(jumps - labels)]


def _can_verify() -> bool:
    if shutil.which("udevadm") is None:
        return False
    told = subprocess.run(["udevadm", "--version"], capture_output=True, text=True, check=False).stdout
    return told.strip().isdigit() and int(told) >= 254


def _run(*command: str, only_failed: bool = False) -> str:
    """Return all that a program says; nothing where it succeeded and only failures count."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "SYSTEMD_COLORS": "0"})
    if only_failed and done.returncode == 0:
        return ""
    said = (done.stdout + done.stderr).strip()
    return said or (f"{command[0]} returned {done.returncode}" if done.returncode else "")


def main() -> int:
    """Check all; returns the exit status."""
    problems = check_rules()
    if shutil.which("systemd-analyze") is None:
        print("systemd-analyze is not here: the units are not checked; install systemd")
    else:
        problems += check_units()
        for name, exposure in exposures().items():
            print(f"{name}: {exposure}")
    if not _can_verify():
        print("udevadm verify is not here (it came with systemd 254): the rules are held against their grammar alone")
    for problem in problems:
        print(problem, file=sys.stderr)
    print(f"{len(problems)} faults")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main())
