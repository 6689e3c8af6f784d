"""What is installed where: the services, their units and configurations, and the folder of programs that the units name."""

import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import PurePosixPath

from gateway.errors import InstallationError

USER = "biobot"
COMMENT = "biobot services"
"""The user's description in /etc/passwd, by which it is known as ours."""

CONFIGURATION = PurePosixPath("/etc/biobot")
DATA = PurePosixPath("/var/lib/biobot")
CACHE = PurePosixPath("/var/cache/biobot-mapper")
FOLDERS_MADE = "folders-made"
"""A file in the virtual environment: folders above it that had to be made for it, one a line (scripts/release/fresh_place.sh)."""
RECORD = DATA / "installed.json"
UNITS = PurePosixPath("/etc/systemd/system")
WANTED = UNITS / "multi-user.target.wants"
COMMANDS = PurePosixPath("/usr/local/bin")
SYSUSERS = PurePosixPath("/etc/sysusers.d/biobot.conf")
RULES = PurePosixPath("/etc/udev/rules.d/70-biobot.rules")
SIMULATOR = "biobot-sim"

_PLACEHOLDER = "/opt/biobot/bin/"
_ON_THIS_MACHINE = "tcp/127.0.0.1:7447"


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """One of the services."""

    name: str
    program: str
    check: tuple[str, ...]
    """Arguments with which its program says what is wrong with its configuration."""

    @property
    def unit(self) -> str:
        """Name of its unit."""
        return f"biobot-{self.name}.service"

    @property
    def configuration(self) -> PurePosixPath:
        """Its configuration."""
        return CONFIGURATION / f"{self.name}.toml"

    @property
    def data(self) -> PurePosixPath:
        """The folder of its data, which is its working directory too."""
        return DATA / self.name


SERVICES = {
    service.name: service
    for service in (
        # In the order in which they are started.
        Service(name="router", program="biobot-gateway", check=("router",)),
        Service(name="gateway", program="biobot-gateway", check=("run",)),
        Service(name="mapper", program="biobot-mapper", check=("serve",)),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """What is to be installed.

    Attributes
    ----------
    services
        Names in ``SERVICES``.
    programs
        Folder of the virtual environment, as the installed system will see it.
    ports, site, name
        Written into a configuration that is made new; None: as the default has it.
    """

    services: tuple[str, ...]
    programs: PurePosixPath
    ports: tuple[str, ...] = ()
    site: str | None = None
    name: str | None = None


def choose_services(text: str) -> tuple[str, ...]:
    """Return the services that a list such as ``gateway,mapper`` names, in the order in which they are started."""
    names = {name.strip() for name in text.split(",")}
    if unknown := sorted(names - SERVICES.keys()):
        raise InstallationError(
            what=f"--services {text}", reason=f"there is no service {unknown[0]!r}", next_step=f"choose from {', '.join(SERVICES)}"
        )
    return tuple(name for name in SERVICES if name in names)


def system_files(services: tuple[str, ...], *, programs: PurePosixPath) -> dict[PurePosixPath, bytes]:
    """Return what belongs to the program itself and is replaced by an upgrade: path and content."""
    wanted = {SYSUSERS: _packaged("biobot.sysusers")}
    if "gateway" in services:
        wanted[RULES] = _packaged("70-biobot.rules")
    for name in services:
        unit = SERVICES[name].unit
        text = _packaged(unit).decode()
        wanted[UNITS / unit] = text.replace(_PLACEHOLDER, f"{programs}/bin/").encode()
    return wanted


def default_configuration(name: str, *, services: tuple[str, ...]) -> str:
    """Return the default configuration of a service, which depends on who else is on the machine: beside a router nobody else listens."""
    text = _packaged(f"{name}.toml").decode()
    if name == "gateway" and "router" in services:
        text = _set(_set(text, "listen", []), "connect", [_ON_THIS_MACHINE])
    return text


def first_configuration(name: str, wishes: Wishes, *, services: tuple[str, ...]) -> str:
    """Return the configuration that is made where there is none: the default, with what was wished for."""
    text = default_configuration(name, services=services)
    if name != "router" and wishes.site is not None:
        text = _set(text, "site", wishes.site)
    if name == "gateway":
        if wishes.name is not None:
            text = _set(text, "name", wishes.name)
        if wishes.ports:
            text = _set(text, "ports", list(wishes.ports))
    return text


def _set(text: str, key: str, value: str | list[str]) -> str:
    """Replace the value of a key that stands on one line."""
    values = value if isinstance(value, list) else [value]
    quoted = ['"' + one.replace("\\", "\\\\").replace('"', '\\"') + '"' for one in values]
    written = f"[{', '.join(quoted)}]" if isinstance(value, list) else quoted[0]
    changed, n_changed = re.subn(rf"^{key} = .*$", lambda _: f"{key} = {written}", text, count=1, flags=re.MULTILINE)
    assert n_changed == 1
    return changed


def _packaged(name: str) -> bytes:
    return (files("gateway") / "installation" / "system" / name).read_bytes()
