"""How an XBee in an unknown state is made to speak API frames, and who it says it is (WIRE_FORMAT.md §8.6).

The stages, each with a deadline:

1. *mode*: ask for ``AP``. No byte of the question is escaped, so a module in mode 1 or 2 understands it, and its answer tells which.
2. *guard*, *knock*, *script*: a module from the factory is in transparent mode and answers nothing. A silence, ``+++``, another silence,
   and it answers ``OK``; then ``ATAP2``, ``ATCN``. Nothing is written into its memory unless that was asked for. If it does not answer
   either, filler bytes end a frame that an earlier owner of the line may have left half said, and all begins again.
3. *questions*: one at a time. A module that stops answering is reset (``FR``) once.
4. *network*: ``AI`` until it says that there is one, for ``patience_ns``.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from firmware_protocol.dialects.interface import CoordinatorSaid, HostEvent
from firmware_protocol.dialects.xbee_frames import AT_OK, AtCommand, AtResponse, ModemStatus, encode_xbee
from firmware_protocol.dialects.xbee_meanings import ASSOCIATED, HARDWARE_RESET, WATCHDOG_RESET, describe_association
from firmware_protocol.framing.xbee import MAX_BODY_SIZE, encode_frame
from firmware_protocol.units import NS_PER_MS, NS_PER_S

AT_FRAME_ID = 1
"""Of all AT commands: answers are told apart by the command that they name."""

_ANSWER_NS = 500 * NS_PER_MS
_EVENT_NS = 50 * NS_PER_MS
_GUARD_NS = 1_100 * NS_PER_MS
"""The silence around ``+++``: ``GT`` is 1 s at the factory."""
_KNOCK_NS = 1_600 * NS_PER_MS
_SCRIPT_NS = 1_000 * NS_PER_MS
_RESET_NS = 3_000 * NS_PER_MS
_POLL_NS = 1_000 * NS_PER_MS
_MODE_TRIES = 2
_QUESTION_TRIES = 3
_LINE_TRIES = 3
_MAX_TEXT = 64
_KNOCK = b"+++"
_OK = b"OK\r"
_ANSWER = re.compile(rb"OK\r|ERROR\r")

_QUESTIONS = ("VR", "HV", "SH", "SL", "MY", "OI", "ID", "CH", "NP", "NI", "AO")
"""Asked when the network is up, because ``OI`` and ``CH`` say nothing before. A module need not know each: DigiMesh has no ``OI``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """What the module has said of itself; a parameter that it does not know is missing."""

    is_escaped: bool
    values: Mapping[str, bytes]

    def number(self, command: str, *, default: int) -> int:
        """Return a parameter's value."""
        value = self.values.get(command, b"")
        return int.from_bytes(value, "big") if value else default


class Stage(Enum):
    """Where an opening stands."""

    MODE = "mode"
    GUARD = "guard"
    KNOCK = "knock"
    SCRIPT = "script"
    RESET = "reset"
    QUESTIONS = "questions"
    NETWORK = "network"
    DONE = "done"
    REFUSED = "refused"


class Opening:
    """See the module. ``outgoing`` is what is to be written; the caller empties it.

    Parameters
    ----------
    patience_ns
        How long a module may be without a network.
    keeps_mode
        Write the switch to API mode into the module's memory.
    """

    def __init__(self, *, now_ns: int, patience_ns: int, keeps_mode: bool) -> None:
        self.outgoing: list[bytes] = []
        self.stage = Stage.MODE
        self.is_escaped: bool | None = None
        self.refusal = ""
        """Why it cannot be used, where ``stage`` is REFUSED."""
        self._patience_ns = patience_ns
        self._script = ("ATAP2", "ATWR", "ATCN") if keeps_mode else ("ATAP2", "ATCN")
        self._values: dict[str, bytes] = {}
        self._missing: set[str] = set()
        self._n_tries = 0
        self._at_line = 0
        self._text = b""
        self._has_reset = False
        self._in_no_network_since_ns: int | None = None
        self._association = -1
        self._deadline_ns = self._asked_ns = now_ns
        self._ask("AP", now_ns)

    @property
    def is_textual(self) -> bool:
        """What comes now may be text, not frames."""
        return self.stage in {Stage.KNOCK, Stage.SCRIPT}

    @property
    def deadline_ns(self) -> int:
        """When ``handle_deadline`` is to be called."""
        return self._deadline_ns

    @property
    def answers(self) -> Answers:
        """What the module has said so far."""
        return Answers(is_escaped=bool(self.is_escaped), values=self._values)

    def take_text(self, chunk: bytes, *, now_ns: int) -> list[HostEvent]:
        """Take bytes from the line while ``is_textual``."""
        self._text = (self._text + chunk)[-_MAX_TEXT:]
        events: list[HostEvent] = []
        while self.is_textual and (answer := _ANSWER.search(self._text)):
            self._text = self._text[answer.end() :]
            if answer[0] == _OK:
                events += self._take_ok(now_ns)
            elif self.stage is Stage.SCRIPT:
                events += self._try_line_again(now_ns)
        return events

    def take_answer(self, answer: AtResponse, *, now_ns: int) -> list[HostEvent]:
        """Take the answer to an AT command."""
        match self.stage:
            case Stage.MODE | Stage.GUARD | Stage.KNOCK if (
                answer.command == "AP" and answer.status == AT_OK and answer.value in {b"\1", b"\2"}
            ):
                self.is_escaped = answer.value == b"\2"
                self.stage, self._n_tries = Stage.QUESTIONS, 0
                self._ask_next(now_ns)
            case Stage.QUESTIONS | Stage.NETWORK if answer.command == self._question():
                self._n_tries = 0
                return self._take_value(answer, now_ns=now_ns)
        return []

    def take_event(self, event: ModemStatus, *, now_ns: int) -> None:
        """Take what happened to the module. However often it is told, it is not asked more often than every ``_EVENT_NS``."""
        soon_ns = self._asked_ns + _EVENT_NS
        if self.stage in {Stage.MODE, Stage.NETWORK} and now_ns < soon_ns:
            self._deadline_ns = min(self._deadline_ns, soon_ns)
            return
        if event.status in {HARDWARE_RESET, WATCHDOG_RESET}:
            self._begin(now_ns)
        elif self.stage is Stage.NETWORK:
            self._ask("AI", now_ns)

    def handle_deadline(self, *, now_ns: int) -> list[HostEvent]:
        """Ask again, or try another way."""
        if now_ns < self._deadline_ns:
            return []
        match self.stage:
            case Stage.MODE:
                self._n_tries += 1
                if self._n_tries < _MODE_TRIES:
                    self._ask("AP", now_ns)
                else:
                    self._enter(Stage.GUARD, until_ns=now_ns + _GUARD_NS)
            case Stage.GUARD:
                self._text = b""
                self.outgoing.append(_KNOCK)
                self._enter(Stage.KNOCK, until_ns=now_ns + _KNOCK_NS)
            case Stage.KNOCK:
                self.outgoing.append(bytes(MAX_BODY_SIZE))
                self._begin(now_ns)
            case Stage.SCRIPT:
                return self._try_line_again(now_ns)
            case Stage.QUESTIONS | Stage.NETWORK:
                return self._try_question_again(now_ns)
            case _:  # it has had time to start again; an opening that has ended is not asked any more
                self._begin(now_ns)
        return []

    def _try_question_again(self, now_ns: int) -> list[HostEvent]:
        """Ask what was not answered, or poll ``AI``; reset a module that has stopped answering, once."""
        self._n_tries += 1
        if self._n_tries < _QUESTION_TRIES:
            self._ask(self._question(), now_ns)
            return []
        if self._has_reset:
            self._begin(now_ns)
            return []
        self._has_reset = True
        self._ask("FR", now_ns)
        self._enter(Stage.RESET, until_ns=now_ns + _RESET_NS)
        return [CoordinatorSaid(level=2, name="reset", text="the module stopped answering; it is reset")]

    def _enter(self, stage: Stage, *, until_ns: int) -> None:
        self.stage = stage
        self._n_tries = 0
        self._deadline_ns = until_ns

    def _begin(self, now_ns: int) -> None:
        """Ask for the mode anew; what was learnt may be no longer true."""
        self.is_escaped = None
        self._values.clear()
        self._missing.clear()
        self._enter(Stage.MODE, until_ns=now_ns)
        self._ask("AP", now_ns)

    def _ask(self, command: str, now_ns: int) -> None:
        body = encode_xbee(AtCommand(frame_id=AT_FRAME_ID, command=command))
        self.outgoing.append(encode_frame(body, is_escaped=bool(self.is_escaped)))
        self._asked_ns = now_ns
        self._deadline_ns = now_ns + _ANSWER_NS

    def _take_ok(self, now_ns: int) -> list[HostEvent]:
        if self.stage is Stage.KNOCK:
            self._enter(Stage.SCRIPT, until_ns=now_ns)
            self._at_line = 0
            self._say_line(now_ns)
            return [CoordinatorSaid(level=1, name="command_mode", text="the module is in transparent mode; it is switched to API mode 2")]
        self._at_line += 1
        self._n_tries = 0
        if self._at_line < len(self._script):
            self._say_line(now_ns)
        else:
            self._begin(now_ns)
        return []

    def _try_line_again(self, now_ns: int) -> list[HostEvent]:
        """Say a line of text anew that was damaged on its way, or give the module time to leave command mode by itself."""
        self._n_tries += 1
        if self._n_tries < _LINE_TRIES:
            self.outgoing.append(b"\r")  # ends what it may hold of the last one
            self._say_line(now_ns)
            return []
        text = f"the module does not take {self._script[self._at_line]}"
        self._begin(now_ns)
        return [CoordinatorSaid(level=2, name="command_mode", text=text)]

    def _say_line(self, now_ns: int) -> None:
        self.outgoing.append(self._script[self._at_line].encode() + b"\r")
        self._deadline_ns = now_ns + _SCRIPT_NS

    def _question(self) -> str:
        """Return what is to be asked next, or empty."""
        asked = self._values.keys() | self._missing
        return next((command for command in ("CE", "AI", *_QUESTIONS) if command not in asked), "")

    def _ask_next(self, now_ns: int) -> None:
        question = self._question()
        if question:
            self._ask(question, now_ns)
        else:
            self.stage = Stage.DONE

    def _take_value(self, answer: AtResponse, *, now_ns: int) -> list[HostEvent]:
        if answer.status != AT_OK:
            self._missing.add(answer.command)  # this kind of module has no such parameter, and goes without
        elif answer.command == "AI" and (state := int.from_bytes(answer.value[:1], "big")) != ASSOCIATED:
            return self._wait_for_network(state, now_ns)
        else:
            self._values[answer.command] = answer.value
        self.stage = Stage.QUESTIONS
        self._ask_next(now_ns)
        return []

    def _wait_for_network(self, state: int, now_ns: int) -> list[HostEvent]:
        if self._in_no_network_since_ns is None:
            self._in_no_network_since_ns = now_ns
        text = describe_association(state)
        if now_ns - self._in_no_network_since_ns >= self._patience_ns:
            self.stage = Stage.REFUSED
            self.refusal = (
                f"the XBee is in no network after {self._patience_ns / NS_PER_S:g} s: AI = 0x{state:02X}, {text}; {self._advice()}"
            )
            return []
        is_news, self._association = state != self._association, state
        self._enter(Stage.NETWORK, until_ns=now_ns + _POLL_NS)
        return [CoordinatorSaid(level=1 if is_news else 0, name="no_network", text=f"AI = 0x{state:02X}, {text}")]

    def _advice(self) -> str:
        if self._values.get("CE", b"").strip(b"\0"):
            return "it is a coordinator: see that SC allows a channel, or reset its network with ATNR"
        return (
            "it looks for the network of another coordinator: set CE to 1 to make it the coordinator, or ID and SC to those of the network"
        )
