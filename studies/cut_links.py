"""How soon everything is there again after a link, a router or a cable comes back: ``python -m studies.cut_links`` (root; a minute).

Three network namespaces, joined by veth pairs to a bridge: a publisher as a gateway publishes, a subscriber as the mapper subscribes, and a
router between them. A fault is made, lasts for a while, and heals; what is printed is the time from the healing until the subscriber has
all that was published before it: its watermark, below which nothing is missing.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

_PREFIX = "biobotcut"
_NET = "10.213.77"
_HOSTS = {"router": 1, "publisher": 2, "subscriber": 3}
_ENDPOINT = f"tcp/{_NET}.1:7447"
_PERIOD_S = 0.005
_LIMIT_S = 15.0
GOAL_S = 1.0


@dataclass(frozen=True, slots=True)
class Fault:
    """What is done to the network, and how it heals."""

    name: str
    begin: Callable[["Network"], None]
    heal: Callable[["Network"], None]


class Network:
    """Three namespaces on a bridge in a fourth, and a program in each."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._programs: dict[str, subprocess.Popen[str]] = {}

    def start(self, role: str) -> None:
        """Start a program in its namespace and wait until it says that it is up."""
        ends = [sys.executable, "-m", "studies.cut_link_ends", role, _ENDPOINT, str(self.path(role)), str(_PERIOD_S)]
        router = [sys.executable, "-m", "gateway", "router", "--listen", _ENDPOINT]
        command = ["ip", "netns", "exec", _name(role), *(router if role == "router" else ends)]
        program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE if role == "router" else None, text=True)
        self._programs[role] = program
        told = program.stderr if role == "router" else program.stdout
        assert told is not None
        if not told.readline():
            raise RuntimeError(f"the {role} did not start")
        if role == "router":
            threading.Thread(target=told.read, daemon=True).start()

    def kill(self, role: str) -> None:
        """End a program as a power cut would."""
        program = self._programs.pop(role)
        program.send_signal(signal.SIGKILL)
        program.wait()

    def path(self, role: str) -> Path:
        """Return where a program writes what it published or heard."""
        return self._directory / f"{role}.log"

    def close(self) -> None:
        """End all programs."""
        for role in list(self._programs):
            self.kill(role)


def main() -> int:
    """Cut links and print how soon all is there again."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--lasting-s", type=float, nargs="+", default=[0.5, 1.9, 3.0, 6.0], help="how long a fault lasts")
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    if os.geteuid() != 0:
        print("skipped: network namespaces need root; run it with sudo", file=sys.stderr)
        return 0
    worst_s = 0.0
    print(f"{'fault':<34} {'lasting':>8} {'complete after':>15} {'published':>10}")
    with TemporaryDirectory() as directory, _namespaces():
        network = Network(Path(directory))
        try:
            for role in ("publisher", "subscriber", "router"):
                network.start(role)
            _wait_until_complete(network)
            for fault in FAULTS:
                for lasting_s in options.lasting_s:
                    for _ in range(options.rounds):
                        time.sleep(1.0)
                        worst_s = max(worst_s, _try(network, fault, lasting_s=lasting_s))
        finally:
            network.close()
    print(f"worst {worst_s:.2f} s; goal {GOAL_S:g} s")
    return 0 if worst_s <= GOAL_S else 1


def _try(network: Network, fault: Fault, *, lasting_s: float) -> float:
    fault.begin(network)
    time.sleep(lasting_s)
    fault.heal(network)
    healed_s = time.monotonic()
    complete_s = _wait_until_complete(network)
    published = _read(network.path("publisher"))
    took_s = max(0.0, complete_s - healed_s)
    print(f"{fault.name:<34} {lasting_s:>6.1f} s {took_s:>13.2f} s {len(published):>10}", flush=True)
    return took_s


def _wait_until_complete(network: Network) -> float:
    """Return when the subscriber had heard all that had been published before now, on the monotonic clock [s]."""
    now_s = time.monotonic()
    deadline_s = now_s + _LIMIT_S
    while time.monotonic() < deadline_s:
        wanted = max((number for number, at_s in _read(network.path("publisher")) if at_s <= now_s), default=None)
        reached_s = [at_s for number, at_s in _read(network.path("subscriber")) if wanted is not None and number >= wanted]
        if reached_s:
            return reached_s[0]
        time.sleep(0.05)
    return deadline_s


def _read(path: Path) -> list[tuple[int, float]]:
    if not path.exists():
        return []
    return [
        (int(number), float(at_s)) for number, at_s in (json.loads(line) for line in path.read_text().splitlines() if line.endswith("]"))
    ]


def _set_link(role: str, state: str) -> Callable[[Network], None]:
    return lambda _network: _ip("-n", _name("bridge"), "link", "set", f"to-{role}"[:15], state)


def _set_port(role: str, *state: str) -> Callable[[Network], None]:
    """Take a port off the bridge, or put it back: both ends keep their carrier, and packets vanish without a word."""
    return lambda _network: _ip("-n", _name("bridge"), "link", "set", f"to-{role}"[:15], *state)


FAULTS: Sequence[Fault] = (
    Fault("router killed, started again", lambda network: network.kill("router"), lambda network: network.start("router")),
    Fault("publisher's cable pulled", _set_link("publisher", "down"), _set_link("publisher", "up")),
    Fault("subscriber's cable pulled", _set_link("subscriber", "down"), _set_link("subscriber", "up")),
    Fault("router's cable pulled", _set_link("router", "down"), _set_link("router", "up")),
    Fault("publisher's packets vanish", _set_port("publisher", "nomaster"), _set_port("publisher", "master", "br0")),
    Fault("router's packets vanish", _set_port("router", "nomaster"), _set_port("router", "master", "br0")),
)


@contextmanager
def _namespaces() -> Iterator[None]:
    names = [_name("bridge"), *(_name(role) for role in _HOSTS)]
    try:
        for name in names:
            _ip("netns", "add", name)
        _ip("-n", _name("bridge"), "link", "add", "br0", "type", "bridge")
        _ip("-n", _name("bridge"), "link", "set", "br0", "up")
        for role, number in _HOSTS.items():
            here = f"to-{role}"[:15]
            _ip("-n", _name("bridge"), "link", "add", here, "type", "veth", "peer", "name", "eth0", "netns", _name(role))
            _ip("-n", _name("bridge"), "link", "set", here, "master", "br0", "up")
            _ip("-n", _name(role), "address", "add", f"{_NET}.{number}/24", "dev", "eth0")
            for device in ("lo", "eth0"):
                _ip("-n", _name(role), "link", "set", device, "up")
        yield
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "delete", name], check=False, capture_output=True)


def _name(role: str) -> str:
    return f"{_PREFIX}-{role}"


def _ip(*arguments: str) -> None:
    _run("ip", *arguments)


def _run(*command: str) -> None:
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    if result.returncode:
        raise RuntimeError(f"{' '.join(command)}: {result.stderr.strip() or 'failed'}")


if __name__ == "__main__":
    sys.exit(main())
