"""A Debian machine with only python3, make, gcc and git; on it the README's commands, timed; ``make bare-machine``.

debootstrap makes the machine once; each run starts from it anew, in namespaces of its own for processes and mounts, with this machine's
network. What is committed is cloned there, as a stranger would. Of this machine nothing is in it but the name servers and, where the
environment names one (PIP_CERT or SSL_CERT_FILE), the bundle of certificates that pip has to believe.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from scripts.debian_root import make_root

_ROOT = Path(__file__).parents[1]
_PACKAGES = ("python3", "make", "gcc", "git")
_PROGRAMS = {"debootstrap": "debootstrap", "unshare": "util-linux", "chroot": "coreutils", "git": "git"}
_FIRST_PAGE = "live page"
_CERTIFICATES = "/root/certificates.pem"

_ENTER = """set -e
mount -t overlay overlay -o "lowerdir=$1/base,upperdir=$1/changes,workdir=$1/work" "$1/machine"
cd "$1/machine"
mount -t proc proc proc
mount -t sysfs -o ro sysfs sys
mount -t tmpfs -o mode=1777 tmpfs dev/shm
mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
rm -f dev/ptmx && ln -s pts/ptmx dev/ptmx
shift
exec chroot . "$@"
"""
"""What the first process of the machine does; its first argument is the folder of the machine, the rest is run in it."""


class BareMachine:
    """A machine whose files are in ``home``; fresh from the start."""

    def __init__(self, home: Path, *, suite: str) -> None:
        self._home = home
        make_root(home / "base", suite=suite, include=_PACKAGES)
        for name in ("changes", "work"):
            shutil.rmtree(home / name, ignore_errors=True)
        for name in ("changes", "work", "machine"):
            (home / name).mkdir(exist_ok=True)
        self._environment = {
            "HOME": "/root", "LANG": "C.UTF-8", "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "TERM": "dumb",
        }  # fmt: skip
        self._environment |= {key: value for key, value in os.environ.items() if key.lower() in {"http_proxy", "https_proxy", "no_proxy"}}
        self._give("/etc/resolv.conf", Path("/etc/resolv.conf").read_bytes())
        bundle = os.environ.get("PIP_CERT") or os.environ.get("SSL_CERT_FILE")
        if bundle:
            self._give(_CERTIFICATES, Path(bundle).read_bytes())
            self._environment |= {"PIP_CERT": _CERTIFICATES, "SSL_CERT_FILE": _CERTIFICATES}

    def clone(self, repository: Path) -> None:
        """Clone what is committed here, as ``/root/biobot``."""
        bundle = self._home / "biobot.bundle"
        subprocess.run(["git", "-C", str(repository), "bundle", "create", "--quiet", str(bundle), "HEAD"], check=True)
        self._give("/root/biobot.bundle", bundle.read_bytes())
        if self.run("git -c advice.detachedHead=false clone --quiet /root/biobot.bundle /root/biobot", folder="/root").status:
            raise SystemExit("git clone failed on the bare machine; what it said is above")

    def run(self, command: str, *, folder: str = "/root/biobot") -> "Ran":
        """Run a shell command in the machine and pass on what it prints, each line with the seconds since it began."""
        line = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", _ENTER, "sh", str(self._home)]
        line += ["/usr/bin/env", "--ignore-environment", *(f"{key}={value}" for key, value in self._environment.items())]
        line += ["sh", "-c", f"cd {folder} && {command}"]
        started = time.monotonic()
        first_page_s = None
        print(f"$ {command}", flush=True)
        with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True) as process:
            assert process.stdout is not None
            for text in process.stdout:
                passed_s = time.monotonic() - started
                if text.startswith(_FIRST_PAGE) and first_page_s is None:
                    first_page_s = passed_s
                print(f"{passed_s:7.1f} s  {text}", end="", flush=True)
        return Ran(command=command, status=process.returncode, took_s=time.monotonic() - started, first_page_s=first_page_s)

    def _give(self, path: str, content: bytes) -> None:
        place = self._home / "changes" / path.lstrip("/")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)


class Ran:
    """What came of a command: its exit status, how long it took and when the live page was up [s]; None where it never was."""

    def __init__(self, *, command: str, status: int, took_s: float, first_page_s: float | None) -> None:
        self.command, self.status, self.took_s, self.first_page_s = command, status, took_s, first_page_s


def main(arguments: Sequence[str] | None = None) -> int:
    """Do it; 0 all commands passed, 1 one did not, 2 something is missing here."""
    options = _parser().parse_args(arguments)
    problems = [f"{name} is missing: apt-get install {package}" for name, package in _PROGRAMS.items() if shutil.which(name) is None]
    problems += [] if os.geteuid() == 0 else ["this user is not root: debootstrap and mounts need it"]
    if problems:
        print("a bare machine cannot be made here:", *(f"  {problem}" for problem in problems), sep="\n", file=sys.stderr)
        return 2
    home: Path = options.home.resolve()
    home.mkdir(parents=True, exist_ok=True)
    if subprocess.run(["git", "-C", str(_ROOT), "status", "--porcelain"], capture_output=True, text=True, check=True).stdout:
        print("note: changes that are not committed are not on the bare machine", file=sys.stderr)
    started = time.monotonic()
    machine = BareMachine(home, suite=options.suite)
    print(f"Debian {options.suite} with {', '.join(_PACKAGES)}: {time.monotonic() - started:.0f} s", flush=True)
    started = time.monotonic()
    machine.clone(_ROOT)
    clone_s = time.monotonic() - started
    commands = ["make demo ARGS=--exit", *([] if options.no_tests else [_test_command(options.tests)])]
    ran = [machine.run(command) for command in commands]
    _record(home, suite=options.suite, clone_s=clone_s, ran=ran)
    for one in ran:
        page = "" if one.first_page_s is None else f", live page after {one.first_page_s:.0f} s"
        print(f"{'passed' if one.status == 0 else f'FAILED with {one.status}'}: {one.command}: {one.took_s:.0f} s{page}")
    return int(any(one.status for one in ran))


def _test_command(arguments: str) -> str:
    return f'make test ARGS="{arguments}"' if arguments else "make test"


def _record(home: Path, *, suite: str, clone_s: float, ran: Sequence[Ran]) -> None:
    commit = subprocess.run(["git", "-C", str(_ROOT), "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True)
    result = {
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "commit": commit.stdout.strip(),
        "suite": suite,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "clone_s": round(clone_s, 1),
        "commands": [
            {"command": one.command, "status": one.status, "took_s": round(one.took_s), "first_page_s": one.first_page_s} for one in ran
        ],
    }
    (home / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="make bare-machine ARGS=...", description=(__doc__ or "").partition(";")[0] + ".")
    parser.add_argument("--suite", default="bookworm", help="release of Debian (default: bookworm)")
    parser.add_argument("--tests", default="", metavar="ARGS", help="what `make test` is given (default: nothing, so all tests)")
    parser.add_argument("--no-tests", action="store_true", help="leave `make test` out")
    parser.add_argument("--home", type=Path, default=Path("artifacts/bare-machine"), help="where the machine and the result are")
    return parser


if __name__ == "__main__":
    sys.exit(main())
