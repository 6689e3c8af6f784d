"""The running machine: its service manager, users and devices, all of them through systemd's own programs."""

import grp
import os
import pwd
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from gateway.errors import InstallationError
from gateway.installation.layout import COMMENT, DATA, SERVICES, SYSUSERS, USER, Service

_BOOTED = Path("/run/systemd/system")
"""There where systemd runs (sd_booted(3))."""

_N_LINES = 4
"""Last lines of a service's log that are told when it does not come up."""


class Machine:
    """The machine that this runs on.

    Raises
    ------
    InstallationError
        Not root, or no systemd that could start anything.
    """

    def __init__(self) -> None:
        if os.geteuid() != 0:
            raise InstallationError(
                what="this user", reason="may not change the system", next_step="run it as root, or give --root DIR to write below a folder"
            )
        missing = [name for name in ("systemctl", "systemd-sysusers", "udevadm", "journalctl") if shutil.which(name) is None]
        if missing or not _BOOTED.is_dir():
            reason = f"it has no {missing[0]}" if missing else "it was not started by systemd"
            next_step = "start the programs by what this system has, or in containers (docker/); --root DIR writes the files alone"
            raise InstallationError(what="this machine", reason=reason, next_step=next_step)

    def make_user(self) -> None:
        """Make the services' user and its groups, where they are not there."""
        _run("systemd-sysusers", str(SYSUSERS))

    def make_data_folders(self, services: Sequence[Service]) -> None:
        """Make the services' folders; systemd makes them too, at the first start."""
        for service in services:
            folder = Path(service.data)
            folder.mkdir(mode=0o750, exist_ok=True, parents=True)
            shutil.chown(folder, USER, USER)

    def remove_user(self) -> str | None:
        """Remove the user if it is the services' own; returns what stood in the way."""
        try:
            entry = pwd.getpwnam(USER)
        except KeyError:
            return None
        if entry.pw_gecos != COMMENT or entry.pw_dir != str(DATA):
            return f"user {USER} is not one that biobot made, and stays"
        for command in (("userdel", USER), ("groupdel", USER)):
            if shutil.which(command[0]) is None:
                return f"there is no {command[0]}: user {USER} stays"
            # groupdel: userdel takes the group with it where /etc/login.defs says so.
            subprocess.run(command, check=False, capture_output=True)
        return None

    def read_units(self) -> None:
        """Have systemd read the units again."""
        _run("systemctl", "daemon-reload")

    def read_rules(self) -> None:
        """Have udev read its rules again and name the dongles that are plugged in; where no udev runs, it does so when it starts."""
        subprocess.run(("udevadm", "control", "--reload"), check=False, capture_output=True)
        subprocess.run(("udevadm", "trigger", "--subsystem-match=tty", "--action=change", "--settle"), check=False, capture_output=True)

    def running(self) -> tuple[str, ...]:
        """Return the services that run or are being started, in the order in which they are started."""
        return running_services()

    def show(self, service: Service, key: str) -> str:
        """Return a property of a unit."""
        return _show(service, key)

    def stop(self, service: Service) -> None:
        """Stop a service, and have systemd forget that it ever failed."""
        _run("systemctl", "stop", service.unit)
        subprocess.run(("systemctl", "reset-failed", service.unit), check=False, capture_output=True)

    def start(self, service: Service) -> bool:
        """Start a service and wait until it says that it serves; returns whether it did."""
        return subprocess.run(("systemctl", "restart", service.unit), check=False, capture_output=True).returncode == 0

    def last_words(self, service: Service) -> str:
        """Return how the service ended, and the last lines that it said itself."""
        asked = (f"_SYSTEMD_UNIT={service.unit}", f"--lines={_N_LINES}", "--output=cat", "--no-pager")
        said = subprocess.run(("journalctl", *asked), check=False, capture_output=True, text=True).stdout
        return " | ".join([self.show(service, "Result"), *(line.strip() for line in said.splitlines())])

    def problems_of(self, service: Service, *, programs: Path) -> list[str]:
        """Return what a service's program finds wrong with its configuration, asked as the service's user in the service's folder."""
        return problems_of(service, programs=programs, configuration=Path(service.configuration), folder=Path(service.data), user=USER)


def running_services() -> tuple[str, ...]:
    """Return the services that run or are being started, in the order in which they are started; none where no systemd runs."""
    if shutil.which("systemctl") is None or not _BOOTED.is_dir():
        return ()
    states = {name: _show(service, "ActiveState") for name, service in SERVICES.items()}
    return tuple(name for name, state in states.items() if state in {"active", "activating", "reloading"})


def has_user() -> bool:
    """Return whether the services' user is there already."""
    try:
        return bool(pwd.getpwnam(USER))
    except KeyError:
        return False


def problems_of(service: Service, *, programs: Path, configuration: Path, folder: Path, user: str | None) -> list[str]:
    """Return what a service's program finds wrong with a configuration, asked in a folder; ``user`` None: as whoever asks."""
    command = (str(programs / "bin" / service.program), *service.check, "--config", str(configuration), "--check-config")
    done = subprocess.run(
        command,
        check=False,
        capture_output=True,
        text=True,
        user=user,
        group=user,
        extra_groups=None if user is None else [group.gr_gid for group in grp.getgrall() if user in group.gr_mem],
        cwd=folder,
        env={"PATH": os.environ.get("PATH", os.defpath), "MPLCONFIGDIR": "/nonexistent"},
    )
    return [] if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"{command[0]} returned {done.returncode}"])


def _show(service: Service, key: str) -> str:
    return _run("systemctl", "show", f"--property={key}", "--value", service.unit).strip()


def _run(*command: str) -> str:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        reason = (done.stderr or done.stdout).strip() or f"returned {done.returncode}"
        raise InstallationError(what=" ".join(command), reason=reason, next_step="correct that, and run it again")
    return done.stdout
