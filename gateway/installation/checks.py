"""What must hold before anything is changed: programs that the services' user may run, room on the disk, ports that are free."""

import contextlib
import os
import shutil
import stat
import subprocess
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from gateway.errors import InstallationError
from gateway.installation.layout import CONFIGURATION, DATA, SERVICES, UNITS
from gateway.obstacles import why_taken

MIN_FREE_BYTES = 64 * 1024 * 1024
"""For units and configurations a hundredth would do; a journal needs some from its first minute on."""

_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # noqa: S108  # named because units do not see them
"""What ProtectHome= and PrivateTmp= of the units hide from them (systemd.exec(5))."""

_MAKE_PROGRAMS = "install the wheel into a virtual environment there, and run its biobot-gateway; or name its folder with --programs"
_PACKAGES = {"router": ("zenoh",), "gateway": ("zenoh", "serial", "uvicorn"), "mapper": ("zenoh", "fastapi", "scipy")}
_EXTRAS = {"router": "gateway", "gateway": "gateway", "mapper": "mapper"}
_LISTENS: dict[str, dict[str, object]] = {
    "router": {"listen": ["tcp/127.0.0.1:7447"]},
    "gateway": {"listen": ["tcp/127.0.0.1:7447"]},
    "mapper": {"serve": {"host": "127.0.0.1", "port": 8080}},
}
"""Where a service listens by default, by the keys of its configuration."""


def missing_programs(root: Path, programs: PurePosixPath, *, services: Sequence[str]) -> list[str]:
    """Return the programs that units are to start and that are not there below ``root``, by their paths on the installed system."""
    wanted = dict.fromkeys(programs / "bin" / SERVICES[name].program for name in services)
    return [str(path) for path in wanted if not (root / path.relative_to("/")).exists()]


def warn_of_missing(root: Path, programs: PurePosixPath, *, services: Sequence[str]) -> list[str]:
    """Return what has to be said where units are written for programs that are not there, which an image may still get."""
    missing = missing_programs(root, programs, services=services)
    where = "" if root == Path("/") else f" below {root}"
    return [f"warning: {path} is not there{where}, and units are to start it: {_MAKE_PROGRAMS}" for path in missing]


def check_programs(programs: PurePosixPath, *, services: Sequence[str]) -> None:
    """Raise ``InstallationError`` where the units could not start the programs that are there."""
    if missing := missing_programs(Path("/"), programs, services=services):
        raise InstallationError(what=missing[0], reason="is not there", next_step=_MAKE_PROGRAMS)
    python = Path(programs) / "bin" / "python"
    for name in services:
        wanted = ", ".join(repr(package) for package in _PACKAGES[name])
        asked = f"from importlib.util import find_spec; print(*[one for one in ({wanted},) if find_spec(one) is None])"
        done = subprocess.run([str(python), "-c", asked], capture_output=True, text=True, check=False, cwd="/")
        if missing := done.stdout.split() if done.returncode == 0 else [done.stderr.strip()[-200:]]:
            next_step = f"install biobot-gateway[{_EXTRAS[name]}] there, or choose fewer --services"
            raise InstallationError(what=f"{python}, for {name}", reason=f"has no {missing[0]}", next_step=next_step)
    for path in (python, Path(os.path.realpath(python))):
        _check_reachable(path)


def _check_reachable(path: Path) -> None:
    next_step = "make the virtual environment in a folder such as /opt/biobot, of a Python that all may run, such as /usr/bin/python3"
    if hidden := next((folder for folder in _HIDDEN if path.is_relative_to(folder)), None):
        raise InstallationError(what=str(path), reason=f"units do not see what is in {hidden}", next_step=next_step)
    for folder in path.parents:
        if not folder.stat().st_mode & stat.S_IXOTH:
            raise InstallationError(what=str(folder), reason="the services' user may not enter it", next_step=next_step)


def check_room(root: Path) -> None:
    """Raise ``InstallationError`` where there is little room on a disk that is written to."""
    for path in (UNITS, CONFIGURATION, DATA):
        here = root / path.relative_to("/")
        there = next(folder for folder in (here, *here.parents) if folder.exists())
        free = shutil.disk_usage(there).free
        if free < MIN_FREE_BYTES:
            limit = f"{free / 1e6:.0f} MB are free, and {MIN_FREE_BYTES / 1e6:.0f} MB are needed"
            raise InstallationError(what=str(path), reason=limit, next_step="make room")


def read_configuration(name: str) -> bytes:
    """Return what stands in a service's configuration; nothing where it is not there or cannot be read."""
    try:
        return Path(SERVICES[name].configuration).read_bytes()
    except OSError:
        return b""


def check_addresses(
    services: Sequence[str], *, running: Sequence[str], configuration_of: Callable[[str], bytes] = read_configuration
) -> list[str]:
    """Return what stands in the way of the services' ports: two that want the same, or another program that has it."""
    problems = []
    wanted: dict[tuple[str, int], str] = {}
    for name in services:
        for address in _addresses(name, configuration_of(name)):
            host, port = address
            other = wanted.setdefault(address, name)
            if other != name:
                problems.append(
                    f"{other} and {name} both listen on {host}:{port}; beside a router, gateway.toml has "
                    f'listen = [] and connect = ["tcp/127.0.0.1:{port}"], as in gateway.toml.new'
                )
            elif name not in running and (reason := why_taken(host, port)):
                problems.append(f"{name} is to listen on {host}:{port}: {reason}; end what listens there (ss -ltnp), or change {name}.toml")
    return problems


def _addresses(name: str, configuration: bytes) -> Iterator[tuple[str, int]]:
    """Yield host and port of all that a service's configuration listens on; one that cannot be read is told by its own program."""
    written: dict[str, object] = {}
    with contextlib.suppress(ValueError):
        written = tomllib.loads(configuration.decode())
    keys = _LISTENS[name] | written
    listen, serve, monitor = keys.get("listen"), keys.get("serve"), keys.get("monitor")
    texts = [str(endpoint).partition("/")[2] for endpoint in listen] if isinstance(listen, list) and name != "mapper" else []
    if name == "mapper" and isinstance(serve, dict):
        page = {"host": "127.0.0.1", "port": 8080} | serve
        texts.append(f"{page['host']}:{page['port']}")
    if isinstance(monitor, dict):
        texts.append(str(monitor.get("listen", "")))
    for text in texts:
        host, _, port = text.rpartition(":")
        if port.isascii() and port.isdigit() and 0 < int(port) < 65536:
            yield host.strip("[]"), int(port)
