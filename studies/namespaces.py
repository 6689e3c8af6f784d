"""Network namespaces joined by a bridge, for studies of links that fail (root): each host has an address, and a cable that can be cut."""

import subprocess
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Self


class Namespaces:
    """One namespace a host, and one for the bridge between them; they are gone when the context ends.

    Parameters
    ----------
    prefix
        What their names begin with.
    network
        First three octets of their addresses.
    hosts
        Last octet of each host's address.
    """

    def __init__(self, *, prefix: str, network: str, hosts: Mapping[str, int]) -> None:
        self._prefix = prefix
        self._network = network
        self._hosts = dict(hosts)

    def __enter__(self) -> Self:
        try:
            self._make()
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._remove()

    def address(self, host: str) -> str:
        """Return a host's address."""
        return f"{self._network}.{self._hosts[host]}"

    def command(self, host: str, arguments: Sequence[str]) -> list[str]:
        """Return the command that runs another one at a host."""
        return ["ip", "netns", "exec", self._name(host), *arguments]

    def pull(self, host: str) -> None:
        """Pull a host's cable: both ends see that there is no carrier."""
        self._set_cable(host, "down")

    def plug(self, host: str) -> None:
        """Put it in again."""
        self._set_cable(host, "up")

    def swallow(self, host: str) -> None:
        """Have all packets from and to a host vanish without a word; both ends keep their carrier."""
        self._set_cable(host, "nomaster")

    def pass_on(self, host: str) -> None:
        """Have them carried again."""
        self._set_cable(host, "master", "br0")

    def _set_cable(self, host: str, *state: str) -> None:
        _ip("-n", self._name("bridge"), "link", "set", _cable(host), *state)

    def _make(self) -> None:
        bridge = self._name("bridge")
        for host in ("bridge", *self._hosts):
            _ip("netns", "add", self._name(host))
        _ip("-n", bridge, "link", "add", "br0", "type", "bridge")
        _ip("-n", bridge, "link", "set", "br0", "up")
        for host in self._hosts:
            there = self._name(host)
            _ip("-n", bridge, "link", "add", _cable(host), "type", "veth", "peer", "name", "eth0", "netns", there)
            _ip("-n", bridge, "link", "set", _cable(host), "master", "br0", "up")
            _ip("-n", there, "address", "add", f"{self.address(host)}/24", "dev", "eth0")
            for device in ("lo", "eth0"):
                _ip("-n", there, "link", "set", device, "up")

    def _remove(self) -> None:
        for host in ("bridge", *self._hosts):
            subprocess.run(["ip", "netns", "delete", self._name(host)], check=False, capture_output=True)

    def _name(self, host: str) -> str:
        return f"{self._prefix}-{host}"


def _cable(host: str) -> str:
    return f"to-{host}"[:15]  # as long as the name of a device may be


def _ip(*arguments: str) -> None:
    result = subprocess.run(["ip", *arguments], check=False, capture_output=True, text=True)
    if result.returncode:
        raise RuntimeError(f"ip {' '.join(arguments)}: {result.stderr.strip() or 'failed'}")
