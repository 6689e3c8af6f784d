"""What an operator who steers a biobot asks for, and what is known of it: pure. Keys, scripts and the state that is shown.

Every motion has a hold: nothing walks on for longer than that without a further key, whatever becomes of operator, network and gateway.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Final

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAccount, StimulationAction
from firmware_protocol.errors import ConfigurationError

_SHOWN: Final = 8
_REMEMBERED: Final = 256

KEYS: Final[dict[str, StimulationAction]] = {
    "up": StimulationAction.START,
    "down": StimulationAction.STOP,
    "left": StimulationAction.TURN_LEFT,
    "right": StimulationAction.TURN_RIGHT,
    "w": StimulationAction.START,
    "s": StimulationAction.STOP,
    "a": StimulationAction.TURN_LEFT,
    "d": StimulationAction.TURN_RIGHT,
    " ": StimulationAction.STOP,
}
"""What a key asks for."""

_WORDS: Final[dict[str, StimulationAction]] = {
    "start": StimulationAction.START,
    "stop": StimulationAction.STOP,
    "left": StimulationAction.TURN_LEFT,
    "right": StimulationAction.TURN_RIGHT,
}
_ARROWS: Final = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}
_MAX_WAIT_S: Final = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of a script: what is asked, and how long it is waited after that [s]."""

    action: StimulationAction
    wait_s: float


def parse_script(text: str) -> list[Step]:
    """Return the steps of a script such as ``left 4; start 5; stop``: each an action and, but for the last, seconds until the next.

    Raises
    ------
    ConfigurationError
        It is none.
    """
    steps, problems = [], []
    for number, part in enumerate((part.split() for part in text.split(";") if part.strip()), start=1):
        word, *rest = part
        try:
            wait_s = float(rest[0]) if rest else 0.0
        except ValueError:
            wait_s = -1.0
        if word not in _WORDS or len(rest) > 1 or not 0.0 <= wait_s <= _MAX_WAIT_S:
            wanted = f"{', '.join(_WORDS)} and seconds from 0 to {_MAX_WAIT_S:g}"
            problems.append(f"--script step {number} is {' '.join(part)!r}; wanted: one of {wanted}, such as 'left 4; start 5; stop'")
        else:
            steps.append(Step(action=_WORDS[word], wait_s=wait_s))
    if not steps and not problems:
        problems.append("--script has no step; give some, such as 'left 4; start 5; stop'")
    if problems:
        raise ConfigurationError(problems)
    return steps


def parse_keys(typed: bytes) -> tuple[list[str], bytes]:
    """Return the names of the keys in what a terminal sent, and what begins a sequence that is not complete (ECMA-48 cursor keys)."""
    keys: list[str] = []
    at = 0
    while at < len(typed):
        if typed[at : at + 1] != b"\x1b":
            keys.append(chr(typed[at]).lower())
            at += 1
        elif len(typed) - at < 3 and typed[at + 1 : at + 2] in {b"", b"[", b"O"}:
            return keys, typed[at:]
        elif typed[at + 1 : at + 2] in {b"[", b"O"}:
            name = _ARROWS.get(typed[at + 2 : at + 3])
            keys += [name] if name is not None else []
            at += 3
        else:
            keys.append("escape")
            at += 1
    return keys, b""


@dataclass(slots=True)
class Steering:
    """What is known of the biobot that is steered; fed with all that is heard."""

    is_moving: bool = False
    """It may be in motion by a command of ours: the commander has to beat."""
    is_stopped: bool = False
    """It confirmed the newest command, a stop."""
    is_halted: bool = False
    """Somebody else has stopped it since our newest command went out."""
    newest: str = ""
    """Id of the command that was sent last."""
    account: StimulationAccount | None = None
    account_s: float = 0.0
    """When the account came, on the clock of whoever told."""
    told: list[str] = field(default_factory=list)
    """Lines to show, the newest last."""
    has_ended: bool = False
    """The newest command has its last stage."""
    is_confirmed: bool = False
    """The biobot has confirmed the newest command."""
    _ours: deque[str] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def sent(self, command_id: str, action: StimulationAction) -> None:
        """Take that a command goes out."""
        self.newest, self.has_ended, self.is_stopped, self.is_confirmed = command_id, False, False, False
        self.is_halted = False
        self._ours.append(command_id)
        self.is_moving = self.is_moving or action is not StimulationAction.STOP

    def take_stage(self, stage: CommandStage) -> None:
        """Take what a command has come to: one of ours, or a stop that somebody else gave, such as the gateway's dead-man."""
        who = f"{stage.operator}: " if stage.operator and stage.command_id not in self._ours else ""
        self.say(f"{who}{stage.action.value}: {stage.stage.value}" + (f": {stage.reason}" if stage.reason else ""))
        is_stopped = stage.action is StimulationAction.STOP and stage.stage is Stage.BIOBOT_CONFIRMED
        self.is_halted |= stage.action is StimulationAction.STOP and stage.stage is Stage.ACCEPTED and stage.command_id not in self._ours
        if is_stopped and self.has_ended and stage.command_id not in self._ours:
            self.is_stopped, self.is_moving = True, False
        if stage.command_id != self.newest or not stage.is_final:
            return
        self.has_ended, self.is_confirmed = True, stage.stage is Stage.BIOBOT_CONFIRMED
        if is_stopped:
            self.is_stopped, self.is_moving = True, False

    def take_account(self, account: StimulationAccount, *, now_s: float) -> None:
        """Take how it was stimulated."""
        self.account, self.account_s = account, now_s

    def say(self, line: str) -> None:
        """Add a line to what is shown."""
        self.told = [*self.told, line][-_SHOWN:]

    def ready_in_s(self, *, now_s: float) -> float | None:
        """Return for how long no train is admitted [s]; None where it is not known."""
        return None if self.account is None else max(0.0, self.account.ready_in_ms / 1000 - (now_s - self.account_s))
