"""How soon whoever is steered is stopped when nobody steers any more: ``python -m studies.dead_man`` (links are cut as root; minutes).

A simulated swarm, three dongles, a gateway and a commander that moves some of the biobots, each a process of its own; with a router
between gateway and commander or without. The commander is killed, or packets vanish without a word: its own, or those between gateway and
router. What is printed is the time until the last stop's frame has left for its dongle, and until the last biobot's answer that it stands
has come back; *early*: how often a commander was taken for silent before its trial began, on a machine short of time.
"""

import argparse
import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from firmware_protocol.messages import Action
from studies.namespaces import Namespaces
from studies.ports import free_port
from studies.stimulus_tap import StimulusTap
from studies.system import PartFailedError

_HOSTS: Final = {"gateway": 1, "router": 2, "commander": 3}
_PORT: Final = 7447
_START_S: Final = 60.0
_LIMIT_S: Final = 20.0
_POLL_S: Final = 0.005
_STOP_S: Final = 15.0
_HOLD_S: Final = 600.0
# Trains would have to wait for one another: the way of a stop is the same without.
_CONFIGURATION: Final = "[stimulation]\nduration_ms = 0\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is done; ``cut`` is the host whose packets vanish, None: the commander is killed."""

    name: str
    has_router: bool
    cut: str | None
    goal_s: float


CASES: Final = (
    Case(name="commander killed", has_router=False, cut=None, goal_s=0.1),
    Case(name="commander killed, router between", has_router=True, cut=None, goal_s=0.1),
    Case(name="commander's packets vanish", has_router=False, cut="commander", goal_s=2.0),
    Case(name="commander's packets vanish, router between", has_router=True, cut="commander", goal_s=2.0),
    Case(name="gateway's packets to the router vanish", has_router=True, cut="gateway", goal_s=2.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """Times from the fault until the last stop's frame left, and until the last biobot's answer was here [s]; inf: not all within 20 s."""

    left_s: float
    stands_s: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and report; 0 where the 99th percentile of all cases is within their goals."""
    parser = argparse.ArgumentParser(prog="python -m studies.dead_man", description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--trials", type=int, default=30, help="of each case (default: %(default)s)")
    parser.add_argument("--biobots", type=int, default=30, help="in the swarm (default: %(default)s)")
    parser.add_argument("--controlled", type=int, default=10, help="that the commander moves (default: %(default)s)")
    parser.add_argument("--out", type=Path, help="keep the logs of all processes here")
    parser.add_argument("--case", type=int, choices=range(1, len(CASES) + 1), help="this fault alone, by its place in the table")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    spaces = Namespaces(prefix="biobotdm", network="10.213.78", hosts=_HOSTS)
    can_cut = os.geteuid() == 0 and shutil.which("ip") is not None
    if can_cut and not options.inside:
        with spaces:
            again = [sys.executable, "-m", "studies.dead_man", *(arguments if arguments is not None else sys.argv[1:]), "--inside"]
            return subprocess.run(spaces.command("gateway", again), check=False).returncode
    if not can_cut:
        print("links are not cut: network namespaces need root and ip", file=sys.stderr)
    return _measure(options, spaces if can_cut else None)


def _measure(options: argparse.Namespace, spaces: Namespaces | None) -> int:
    print(f"{options.controlled} of {options.biobots} biobots are moved; times from the fault [ms]")
    left, stands = (f"{name:>10} {'p99':>6} {'max':>6}" for name in ("frame p50", "stands p50"))
    print(f"{'fault':<44} {'n':>4} {left}  {stands}  {'goal':>5} {'early':>6}")
    is_good = True
    for number, case in enumerate(CASES, start=1):
        if options.case not in {None, number}:
            continue
        if case.cut is not None and spaces is None:
            continue
        with ExitStack() as stack:
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="dead-man-")))
            if options.out is not None:
                directory = options.out / str(number)
                directory.mkdir(parents=True)
            try:
                setting = _Setting(directory, stack, case=case, spaces=spaces, options=options)
                trials = [setting.run_trial() for _ in range(options.trials)]
            except PartFailedError as error:
                print(f"error: {error}", file=sys.stderr)
                return 1
        is_good &= _report(case, trials, n_early=setting.n_early)
    return 0 if is_good else 1


def _report(case: Case, trials: Sequence[Trial], *, n_early: int) -> bool:
    left, stands = ([getattr(trial, name) * 1e3 for trial in trials] for name in ("left_s", "stands_s"))
    numbers = [np.percentile(values, (50, 99, 100), method="higher") for values in (left, stands)]
    frame, standing = numbers
    print(
        f"{case.name:<44} {len(trials):>4}  {frame[0]:>9.0f} {frame[1]:>6.0f} {frame[2]:>6.0f}  "
        f"{standing[0]:>10.0f} {standing[1]:>6.0f} {standing[2]:>6.0f}  {case.goal_s * 1e3:>5.0f} {n_early:>6}",
        flush=True,
    )
    return bool(standing[1] <= case.goal_s * 1e3)


class _Setting:
    """A swarm, a gateway and perhaps a router, running; a commander for each trial."""

    def __init__(self, out: Path, stack: ExitStack, *, case: Case, spaces: Namespaces | None, options: argparse.Namespace) -> None:
        self._out = out
        self._stack = stack
        self._case = case
        self._spaces = spaces
        self._n_commanders = 0
        self.n_early = 0
        """Commanders that were thought silent before their trial began, on a machine short of time."""
        self._nodes = [str(node) for node in range(1, options.controlled + 1)]
        ready = out / "ready"
        swarm = ["simulator", "serve", "--scenario", "no-obstacle", "--biobots", str(options.biobots), "--seed", "1"]
        swarm += ["--ready-file", str(ready), "--out", str(out / "truth")]
        self._start("simulator", [*swarm, *["--link", "tcp:127.0.0.1:0"] * 3])
        self._wait(ready.exists, what="the simulator is ready")
        dongles = [(host, int(port)) for _, host, port in (line.split(":") for line in ready.read_text().split())]
        self._tap = stack.enter_context(StimulusTap(dongles))
        (out / "gateway.toml").write_text(_CONFIGURATION)
        gateway = ["gateway", "--config", str(out / "gateway.toml"), "run", "--journal", str(out / "journal.sqlite")]
        gateway += [part for port in self._tap.ports for part in ("--port", f"tcp:127.0.0.1:{port}")]
        if case.has_router:
            self._endpoint = self._end("router")
            self._start("router", ["gateway", "router", "--listen", self._endpoint], host="router")
            self._start("gateway", [*gateway, "--connect", self._endpoint])
        else:
            self._endpoint = self._end("gateway")
            self._start("gateway", [*gateway, "--listen", self._endpoint])

    def run_trial(self) -> Trial:
        """Move the biobots, make the fault, and see how soon all of them stand."""
        commander = self._moving_commander()
        n_before = len(self._tap.passed)
        begun_s = time.monotonic()
        with self._fault(commander):
            deadline_s = begun_s + _LIMIT_S
            while (trial := self._judge(n_before, begun_s)) is None and time.monotonic() < deadline_s:
                time.sleep(_POLL_S)
        return trial or Trial(left_s=float("inf"), stands_s=float("inf"))

    @contextlib.contextmanager
    def _fault(self, commander: "subprocess.Popen[str]") -> Iterator[None]:
        if self._case.cut is None:
            commander.kill()
        else:
            assert self._spaces is not None
            self._spaces.swallow(self._case.cut)
        try:
            yield
        finally:
            commander.kill()
            commander.wait()
            if self._case.cut is not None and self._spaces is not None:
                self._spaces.pass_on(self._case.cut)

    def _judge(self, n_before: int, begun_s: float) -> Trial | None:
        """Return how long it took, or None where not all stand yet."""
        passed = self._tap.passed[n_before:]
        left: dict[int, float] = {}
        for one in passed:
            if one.action is Action.STOP:
                left.setdefault(one.command, one.at_s)
        stood: dict[int, tuple[float, float]] = {}
        for one in passed:
            if one.node is not None and one.command in left:
                stood.setdefault(one.node, (left[one.command], one.at_s))
        if not {int(node) for node in self._nodes} <= stood.keys():
            return None
        return Trial(left_s=max(one for one, _ in stood.values()) - begun_s, stands_s=max(one for _, one in stood.values()) - begun_s)

    def _moving_commander(self) -> "subprocess.Popen[str]":
        """Return a commander that moves all biobots; one that finds no gateway yet, or was thought silent meanwhile, is started again."""
        deadline_s = time.monotonic() + _START_S
        while time.monotonic() < deadline_s:
            self._n_commanders += 1
            n_before = len(self._tap.passed)
            name = f"study{self._n_commanders}"
            commander = self._start(
                "commander", ["studies.commander", "local", self._endpoint, name, str(_HOLD_S), *self._nodes], host="commander"
            )
            assert commander.stdout is not None
            if commander.stdout.readline().strip() == "moving":
                if all(one.action is not Action.STOP for one in self._tap.passed[n_before:]):
                    return commander
                self.n_early += 1
                commander.kill()
            commander.wait()
        raise PartFailedError(f"no commander moved its biobots within {_START_S:g} s; the ends of the logs:\n{self._logs()}")

    def _logs(self) -> str:
        return "\n".join(f"{log.name}: {log.read_text()[-1000:]}" for log in sorted(self._out.glob("*.log")))

    def _end(self, host: str) -> str:
        return f"tcp/127.0.0.1:{free_port()}" if self._spaces is None else f"tcp/{self._spaces.address(host)}:{_PORT}"

    def _start(self, name: str, arguments: Sequence[str], *, host: str = "gateway") -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", *arguments]
        if self._spaces is not None and host != "gateway":  # this process is at the gateway's host itself
            command = self._spaces.command(host, command)
        with (self._out / f"{name}.log").open("a") as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True)
        self._stack.callback(_end_process, process)
        return process

    def _wait(self, is_so: Callable[[], bool], *, what: str) -> None:
        deadline_s = time.monotonic() + _START_S
        while not is_so():
            if time.monotonic() > deadline_s:
                raise PartFailedError(f"not within {_START_S:g} s: {what}; the ends of the logs:\n{self._logs()}")
            time.sleep(_POLL_S)


def _end_process(process: "subprocess.Popen[str]") -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if process.stdout is not None:
        process.stdout.close()


if __name__ == "__main__":
    sys.exit(main())
