"""What moves a biobot during ``biobot-gateway steer``: keys of a terminal or a script in, commands and beats out, a picture of it all."""

import contextlib
import json
import os
import select
import signal
import sys
import termios
import threading
import time
import tty
import uuid
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from firmware_protocol.contract.commands import CommandStage, PulseRequest, StimulationAccount, StimulationAction, StimulationRequest
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.bus_commander import CommanderSession
from gateway.commands.outcome import complain
from gateway.steering import KEYS, Steering, Step, parse_keys

_TICK_S: Final = 0.05
_STOP_S: Final = 8.0
"""The end of a command is waited for so long; the gateway repeats a stop several times meanwhile."""

_SPARE_S: Final = 1.0
"""A hold lasts for so long after the end of its step, for commands take their time."""

_TTL_MS: Final = 2000
_HELP: Final = "arrows or w a d: start, left, right   down, s or space: stop   q: stop and leave"


class Helm:
    """Sends commands, beats, and keeps what is heard. ``interrupted`` is set by a signal, and ends keys and scripts."""

    def __init__(
        self, session: CommanderSession, *, node: NodeId, operator: str, hold_s: float, is_shown: bool, interrupted: threading.Event
    ) -> None:
        self._session = session
        self._node = node
        self._operator = operator
        self.hold_s = hold_s
        self._is_shown = is_shown
        self.interrupted = interrupted
        self.steering = Steering()

    def send(self, action: StimulationAction, *, pulse: PulseRequest | None = None) -> None:
        """Send a command; a motion has a hold."""
        is_stop = action is StimulationAction.STOP
        command_id = f"steer-{uuid.uuid4().hex}"
        self.steering.sent(command_id, action)
        self._session.send(
            StimulationRequest(
                command_id=command_id,
                node=self._node,
                action=action,
                operator=self._operator,
                issued_wall_ns=Nanoseconds(time.time_ns()),
                ttl_ms=_TTL_MS,
                hold_ms=0 if is_stop else int(self.hold_s * 1000),
                pulse=pulse,
                commander="" if is_stop else self._session.name,
            )
        )

    def pump(self) -> None:
        """Beat while the biobot may move, and take what was heard."""
        now_s = time.monotonic()
        if self.steering.is_moving:
            self._session.beat(now_s=now_s)
        for heard in self._session.take():
            match heard:
                case CommandStage():
                    self.steering.take_stage(heard)
                    if not self._is_shown:
                        print(json.dumps(msgspec.to_builtins(heard)), flush=True)
                case StimulationAccount():
                    self.steering.take_account(heard, now_s=now_s)
                case str():
                    self.steering.say(heard)
                    if not self._is_shown:
                        complain(heard)

    def wait(self, seconds: float, *, until: Callable[[], bool]) -> None:
        """Beat and hear for so long, or until something is so."""
        deadline_s = time.monotonic() + seconds
        while not until() and (rest_s := deadline_s - time.monotonic()) > 0:
            self.pump()
            time.sleep(min(_TICK_S, rest_s))
        self.pump()

    def stop_finally(self) -> None:
        """Stop the biobot, unless it never moved or confirmed a stop already."""
        if not self.steering.is_moving:
            return
        self.send(StimulationAction.STOP)
        with contextlib.suppress(OSError):  # where the terminal is gone, nothing can be printed
            self.wait(_STOP_S, until=lambda: self.steering.has_ended)


def follow_script(helm: Helm, steps: list[Step]) -> int:
    """Take one step after the other; each lasts as long as it says, and until it is known what became of it.

    Returns
    -------
    int
        How many steps the biobot did not confirm: refused, failed, or nobody knows. What an interruption cut short or left out is none.
    """
    is_interrupted = helm.interrupted.is_set
    n_undone = 0
    for step in steps:
        if is_interrupted():
            break
        begun_s = time.monotonic()
        is_done = _send_and_hear(helm, step.action)
        if step.action is not StimulationAction.STOP:
            is_done &= _go_on(helm, begun_s=begun_s, end_s=begun_s + step.wait_s)
        n_undone += not is_done
        helm.wait(begun_s + step.wait_s - time.monotonic(), until=is_interrupted)
    return n_undone


def _send_and_hear(helm: Helm, action: StimulationAction, *, pulse: PulseRequest | None = None) -> bool:
    """Send a command, and wait for its last stage; return whether it is done, or was cut short by an interruption."""
    is_interrupted = helm.interrupted.is_set
    helm.send(action, pulse=pulse)
    helm.wait(_STOP_S, until=lambda: helm.steering.has_ended or is_interrupted())
    return helm.steering.is_confirmed or (is_interrupted() and not helm.steering.has_ended)


def _go_on(helm: Helm, *, begun_s: float, end_s: float) -> bool:
    """Renew the hold of a motion that began until it is to end, by starts without a train; return whether all were confirmed.

    Not where somebody else stops the biobot: then it stands for the rest of the step.
    """
    hold_s, is_confirmed = helm.hold_s, True
    spare_s = min(_SPARE_S, hold_s / 2)
    while end_s + spare_s > begun_s + hold_s:
        helm.wait(begun_s + hold_s / 2 - time.monotonic(), until=lambda: helm.interrupted.is_set() or helm.steering.is_halted)
        if helm.interrupted.is_set():
            break
        if helm.steering.is_halted or not helm.steering.is_moving:
            return False
        begun_s = time.monotonic()
        is_confirmed &= _send_and_hear(helm, StimulationAction.START, pulse=PulseRequest(duration_ms=0))
    return is_confirmed


def follow_keys(helm: Helm) -> None:
    """Do what the keys ask for, and show how it stands, until the operator leaves."""
    with _raw_keys() as read_keys, Live(console=Console(highlight=False), auto_refresh=False) as live:
        while not helm.interrupted.is_set():
            for key in read_keys():
                if key in {"q", "escape", "\x03", "\x04"}:
                    return
                if key in KEYS:
                    helm.send(KEYS[key])
            helm.pump()
            live.update(_picture(helm.steering), refresh=True)


@contextlib.contextmanager
def signals_interrupt() -> Iterator[threading.Event]:
    """Yield what the end of the terminal or of the process, or Ctrl-C, sets; a second signal ends the process at once."""
    interrupted = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        interrupted.set()
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)

    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield interrupted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _picture(steering: Steering) -> Group:
    account = steering.account
    ready_s = steering.ready_in_s(now_s=time.monotonic())
    lines = [Text(_HELP, style="dim")]
    if account is not None and ready_s is not None:
        lines.append(Text(f"ready in {ready_s:.1f} s", style="yellow") if ready_s else Text("ready", style="green"))
        window = f"{account.n_trains_in_window} trains, {account.on_ms_in_window / 1000:.1f} s in {account.window_s:g} s"
        lines.append(Text(f"{window}; habituation {account.habituation:.0%}", style="dim"))
    lines += [Text(line) for line in steering.told]
    return Group(*lines)


@contextlib.contextmanager
def _raw_keys() -> Iterator[Callable[[], list[str]]]:
    """Yield what returns the keys typed within a moment; the terminal is as before in the end."""
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    rest = b""

    def read() -> list[str]:
        nonlocal rest
        if not select.select([descriptor], [], [], _TICK_S)[0]:
            lone, rest = rest, b""
            return ["escape"] if lone else []
        try:
            typed = os.read(descriptor, 64)
        except OSError:
            typed = b""
        if not typed:
            return ["q"]  # the terminal hung up
        keys, rest = parse_keys(rest + typed)
        return keys

    try:
        tty.setcbreak(descriptor)
        yield read
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
