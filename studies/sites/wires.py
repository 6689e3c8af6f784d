"""Machines as network namespaces, joined by cables that can be pulled, or swallow what they carry. Linux, root or user namespaces.

The program itself is at one place of its own, the hall, where all switches stand: each cable is a switch with two wires. Everything is gone
with the program, because it runs in namespaces of its own (`studies.campaign.surroundings.enter_namespaces`).
"""

import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Final, Self, TypeAlias

from studies.campaign.surroundings import is_in_namespaces
from studies.errors import SitesError

HALL: Final = "hall"
"""Where the program itself is."""

Cable: TypeAlias = tuple[str, str]
"""Two machines, in the order in which the cable was given."""

_NETWORK: Final = "10.88"
_WAIT_S: Final = 10.0
_MOST_CABLES: Final = 250


def find_problem() -> str | None:
    """Say why this machine has no wires, or None; what is tried is taken away again."""
    if not is_in_namespaces():
        return "no namespaces: wants Linux, root or unprivileged user namespaces, and unshare"
    missing = [program for program in ("ip", "nsenter") if shutil.which(program) is None]
    if missing:
        return f"no {' and no '.join(missing)} (packages iproute2, util-linux)"
    try:
        with Wires([(HALL, "probe")]) as wires:
            _run(*wires.prefix("probe"), "true")
    except SitesError as error:
        return f"network namespaces, bridges or pairs of devices are not allowed here: {error}"
    return None


class Wires:
    """See the module.

    Parameters
    ----------
    cables
        Which machines have a cable between them; each is a network of its own.
    """

    def __init__(self, cables: Sequence[Cable]) -> None:
        if len(cables) > _MOST_CABLES:
            raise ValueError(f"{len(cables)} cables are too many; {_MOST_CABLES} have addresses")
        self._cables = {cable: number for number, cable in enumerate(cables, start=1)}
        self._holders: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        try:
            for host in dict.fromkeys(host for cable in self._cables for host in cable if host != HALL):
                self._holders[host] = _hold()
            _ip("link", "set", "lo", "up")
            for cable, number in self._cables.items():
                self._lay(cable, number)
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._remove()

    def address(self, host: str, *, cable: Cable) -> str:
        """Return the address of a machine on one of its cables."""
        return f"{_NETWORK}.{self._cables[cable]}.{1 + cable.index(host)}"

    def addresses(self, host: str) -> list[str]:
        """Return all addresses of a machine."""
        return [self.address(host, cable=cable) for cable in self._cables if host in cable]

    def prefix(self, host: str) -> list[str]:
        """Return what stands before a command that is to run on a machine."""
        return [] if host == HALL else ["nsenter", f"--net=/proc/{self._holders[host].pid}/ns/net"]

    def carried(self, cable: Cable) -> int:
        """Return how many bytes a cable has carried, both ways, with the heads of all packets."""
        devices = (line.partition(":") for line in Path("/proc/self/net/dev").read_text(encoding="ascii").splitlines())
        received = {name.strip(): int(counters.split()[0]) for name, colon, counters in devices if colon}
        return sum(received[self._port(cable, end)] for end in (0, 1))

    def pull(self, cable: Cable) -> None:
        """Pull a cable: both machines see that there is no carrier."""
        for end in (0, 1):
            _ip("link", "set", self._port(cable, end), "down")

    def plug(self, cable: Cable) -> None:
        """Put it in again."""
        for end in (0, 1):
            _ip("link", "set", self._port(cable, end), "up")

    def swallow(self, cable: Cable) -> None:
        """Have all that it carries vanish without a word."""
        _ip("link", "set", self._port(cable, 0), "nomaster")

    def pass_on(self, cable: Cable) -> None:
        """Have it carried again."""
        _ip("link", "set", self._port(cable, 0), "master", self._switch(cable))

    def _lay(self, cable: Cable, number: int) -> None:
        switch = self._switch(cable)
        _ip("link", "add", switch, "type", "bridge")
        _ip("link", "set", switch, "up")
        for end, host in enumerate(cable):
            port, wire = self._port(cable, end), f"w{number}{'ab'[end]}"
            there = [] if host == HALL else ["netns", str(self._holders[host].pid)]
            _ip("link", "add", port, "type", "veth", "peer", "name", wire, *there)
            _ip("link", "set", port, "master", switch, "up")
            inside = self.prefix(host)
            _run(*inside, "ip", "address", "add", f"{self.address(host, cable=cable)}/24", "dev", wire)
            for device in ("lo", wire):
                _run(*inside, "ip", "link", "set", device, "up")

    def _switch(self, cable: Cable) -> str:
        return f"s{self._cables[cable]}"

    def _port(self, cable: Cable, end: int) -> str:
        return f"p{self._cables[cable]}{'ab'[end]}"

    def _remove(self) -> None:
        for holder in self._holders.values():
            holder.kill()
            holder.wait()
        self._holders.clear()
        for cable in self._cables:  # the wires have gone with the machines, but for those that end in the hall
            for device in (self._switch(cable), *(self._port(cable, end) for end in (0, 1))):
                subprocess.run(["ip", "link", "delete", device], check=False, capture_output=True)


def _hold() -> subprocess.Popen[bytes]:
    """Make a network namespace, which lasts as long as the process that is returned."""
    holder = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
    ours, theirs = Path("/proc/self/ns/net"), Path(f"/proc/{holder.pid}/ns/net")
    deadline = time.monotonic() + _WAIT_S
    while theirs.readlink() == ours.readlink():
        if holder.poll() is not None or time.monotonic() > deadline:
            raise SitesError("a machine of the topology cannot be made: `unshare --net` gave no network namespace")
        time.sleep(0.01)
    return holder


def _ip(*arguments: str) -> None:
    _run("ip", *arguments)


def _run(*command: str) -> None:
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    if result.returncode:
        raise SitesError(f"{' '.join(command)}: {result.stderr.strip() or 'failed'}")
