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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from studies.namespaces import Namespaces

_HOSTS = {"router": 1, "publisher": 2, "subscriber": 3}
_NETWORK = "10.213.77"
_ENDPOINT = f"tcp/{_NETWORK}.1:7447"
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

    def __init__(self, directory: Path, spaces: Namespaces) -> None:
        self.spaces = spaces
        self._directory = directory
        self._programs: dict[str, subprocess.Popen[str]] = {}

    def start(self, role: str) -> None:
        """Start a program in its namespace and wait until it says that it is up."""
        ends = [sys.executable, "-m", "studies.cut_link_ends", role, _ENDPOINT, str(self.path(role)), str(_PERIOD_S)]
        router = [sys.executable, "-m", "gateway", "router", "--listen", _ENDPOINT]
        command = self.spaces.command(role, router if role == "router" else ends)
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
    with TemporaryDirectory() as directory, Namespaces(prefix="biobotcut", network=_NETWORK, hosts=_HOSTS) as spaces:
        network = Network(Path(directory), spaces)
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


def _pulled(host: str) -> Fault:
    return Fault(f"{host}'s cable pulled", lambda network: network.spaces.pull(host), lambda network: network.spaces.plug(host))


def _swallowed(host: str) -> Fault:
    return Fault(f"{host}'s packets vanish", lambda network: network.spaces.swallow(host), lambda network: network.spaces.pass_on(host))


FAULTS: Sequence[Fault] = (
    Fault("router killed, started again", lambda network: network.kill("router"), lambda network: network.start("router")),
    *map(_pulled, ("publisher", "subscriber", "router")),
    *map(_swallowed, ("publisher", "router")),
)


if __name__ == "__main__":
    sys.exit(main())
