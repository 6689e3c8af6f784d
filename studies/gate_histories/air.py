"""Radios of the histories: dongles that take, lose, delay, repeat and overtake frames, and bring the biobots' answers or do not.

What is taken for granted of them, and no more: a frame that a dongle was given reaches a biobot within ``flight_s`` or never; one that the
dongle says it did not send never does, and one of which it says that the biobot's radio has acknowledged it came before; the copies of one
frame come to one start of a backpack; a frame that was withdrawn, or was not given to the dongle within ``radio_timeout_s``, or whose
gateway was killed before, never leaves. Frames pass each other freely.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from firmware_protocol.messages import Action, Stimulate
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from gateway.errors import RadioUnavailableError
from gateway.nodes import NodeBook
from gateway.radio import Fate, RadioOutcome
from studies.gate_histories.calls import CURRENT_CALL, STOPS, Call, Life
from studies.gate_histories.electrode import Answer, Biobots
from studies.gate_histories.virtual_time import TrueTime

_COPY_AFTER_NS = 40 * NS_PER_MS
_URGENT_QUEUED_MS = 15
_FIRST_REPEAT_NS, _MAX_REPEAT_NS = NS_PER_S, 30 * NS_PER_S  # WIRE_FORMAT.md §5.1
_MAX_REPEATS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFate:
    """What becomes of a frame and of its answer; the default is a good radio's.

    Parameters
    ----------
    queued_ms
        How long it waits in the gateway for the dongle; an urgent one at most 15 ms.
    flight
        Share of ``flight_s`` that then passes until the biobot has it, 0 to 1.
    n_copies
        0: it is lost.
    confirm
        What the dongle says of it, after ``confirm_ms``; that it was sent, so long after the biobot's radio has acknowledged it.
    answer_ms, n_lost_answers
        How long the answer takes, and how many of its repetitions are lost before.
    """

    queued_ms: int = 1
    flight: float = 0.001
    n_copies: int = 1
    confirm: Fate = Fate.SENT
    confirm_ms: int = 10
    answer_ms: int = 10
    n_lost_answers: int = 0


GOOD = FrameFate()


@dataclass(slots=True, eq=False, kw_only=True)
class Frame:
    """A frame that the gate gave to a radio; ``node`` None: to all; ``call`` None: a stop by the gate itself."""

    node: NodeId | None
    radio: str
    message: Stimulate
    call: Call | None
    life: Life
    sent_ns: int
    written_ns: int | None = None
    landed_ns: list[int] = field(default_factory=list)
    is_withdrawn: bool = False
    future: "asyncio.Future[RadioOutcome]"

    def settle(self, fate: Fate, reason: str = "") -> None:
        """Tell the gate what became of it, where it is still there to be told."""
        if not self.future.done() and not self.life.is_over:
            self.future.set_result(RadioOutcome(fate=fate, reason=reason))


@dataclass(slots=True, kw_only=True)
class Radio:
    """A dongle. Its frames have the fates of ``fates``, one after the other, round and round."""

    name: str
    hears: frozenset[NodeId]
    is_up: bool = True
    fates: tuple[FrameFate, ...] = (GOOD,)
    n_frames: int = 0

    def next_fate(self) -> FrameFate:
        """Return what becomes of the next frame."""
        self.n_frames += 1
        return self.fates[(self.n_frames - 1) % len(self.fates)]


class Air:
    """All radios and biobots; outlives the gateway's processes."""

    def __init__(self, *, true_time: TrueTime, radios: Mapping[str, Radio], flight_s: float, radio_timeout_s: float) -> None:
        self.radios = radios
        self.biobots: Biobots = {}
        self.frames: list[Frame] = []
        self.hear: Callable[[Answer, str], bool] = _nobody_hears
        """Takes an answer that came over a radio; False where no gateway is there to take it."""
        self._true_time = true_time
        self._flight_ns = int(flight_s * NS_PER_S)
        self._timeout_ns = int(radio_timeout_s * NS_PER_S)
        self._fates: dict[NodeId, FrameFate] = {}

    def send(self, message: Stimulate, *, life: Life, node: NodeId | None, radio: str, is_urgent: bool) -> "asyncio.Future[RadioOutcome]":
        """Take a frame for a radio that is up."""
        call = CURRENT_CALL.get()
        if call is not None and message.action is Action.STOP and call.request.action not in STOPS:
            call = None  # the gate stops by itself whom an older command has moved after a stop
        frame = Frame(
            node=node,
            radio=radio,
            message=message,
            call=call,
            life=life,
            sent_ns=self._true_time.now_ns,
            future=asyncio.get_running_loop().create_future(),
        )
        if life.is_over:
            return frame.future  # a process that was killed sends nothing
        self.frames.append(frame)
        fate = self.radios[radio].next_fate()
        queued_ms = min(fate.queued_ms, _URGENT_QUEUED_MS) if is_urgent else fate.queued_ms
        if queued_ms * NS_PER_MS < self._timeout_ns:
            self._true_time.after(queued_ms * NS_PER_MS, lambda: self._write(frame, fate))
        self._true_time.after(self._timeout_ns, lambda: frame.settle(Fate.UNKNOWN, "the radio did not tell"))
        return frame.future

    def withdraw(self, future: "asyncio.Future[RadioOutcome]") -> bool:
        """Take back a frame that was not written."""
        frame = next((one for one in reversed(self.frames) if one.future is future), None)
        if frame is None or frame.written_ns is not None or future.done():
            return False
        frame.is_withdrawn = True
        frame.settle(Fate.NOT_SENT, "withdrawn")
        return True

    def lose_port(self, name: str) -> None:
        """Let a radio be gone: frames that were not given to it are not sent; of those that it has nothing more is told."""
        self.radios[name].is_up = False
        for frame in [one for one in self.frames if one.radio == name and not one.future.done()]:
            if frame.written_ns is None:
                frame.is_withdrawn = True
                frame.settle(Fate.NOT_SENT, "the port is lost")
            else:
                frame.settle(Fate.UNKNOWN, "the port is lost")

    def answer(self, answer: Answer) -> None:
        """Let a biobot's answer begin its way."""
        fate = self._fates[answer.node]
        lost_ns = sum(_repeat_ns(repeat) for repeat in range(fate.n_lost_answers))
        self._true_time.after(fate.answer_ms * NS_PER_MS + lost_ns, lambda: self._carry(answer, repeat=fate.n_lost_answers))

    def way_from(self, node: NodeId) -> str | None:
        """Return a radio that hears a biobot now."""
        return next((radio.name for radio in self.radios.values() if radio.is_up and node in radio.hears), None)

    def _write(self, frame: Frame, fate: FrameFate) -> None:
        if frame.is_withdrawn or frame.life.is_over or not self.radios[frame.radio].is_up:
            return
        frame.written_ns = self._true_time.now_ns
        flight_ns = int(fate.flight * self._flight_ns)
        confirm_ns = fate.confirm_ms * NS_PER_MS + (flight_ns if fate.confirm is Fate.SENT else 0)
        self._true_time.after(confirm_ns, lambda: frame.settle(fate.confirm, "as the dongle says"))
        if fate.confirm is Fate.NOT_SENT:
            return
        hears = self.radios[frame.radio].hears
        for node in [one for one in self.biobots if one in hears and frame.node in {None, one}]:
            boots: list[int] = []
            for copy in range(fate.n_copies):
                delay_ns = min(flight_ns + copy * _COPY_AFTER_NS, self._flight_ns)
                self._true_time.after(delay_ns, lambda node=node, boots=boots: self._land(frame, fate, node=node, boots=boots))  # type: ignore[misc]

    def _land(self, frame: Frame, fate: FrameFate, *, node: NodeId, boots: list[int]) -> None:
        biobot = self.biobots[node]
        boots.append(biobot.boot)
        if boots[0] != biobot.boot:
            return
        frame.landed_ns.append(self._true_time.now_ns)
        self._fates[node] = fate
        biobot.receive(frame.message, is_broadcast=frame.node is None)

    def _carry(self, answer: Answer, *, repeat: int) -> None:
        """Bring an answer to the gateway, or try again as a backpack does until it restarts."""
        if self.biobots[answer.node].boot != answer.boot or repeat >= _MAX_REPEATS:
            return
        radio = self.way_from(answer.node)
        if radio is None or not self.hear(answer, radio):
            self._true_time.after(_repeat_ns(repeat), lambda: self._carry(answer, repeat=repeat + 1))


class Sender:
    """The downlink sender of one life of the gateway, as the gate knows it."""

    def __init__(self, *, air: Air, life: Life, nodes: NodeBook, now_ns: Callable[[], int]) -> None:
        self._air = air
        self._life = life
        self._nodes = nodes
        self._now_ns = now_ns

    def can_send(self, node: NodeId) -> bool:
        """Return whether the radio that heard a biobot last takes a frame for it now."""
        known = self._nodes.find(node)
        return known is not None and known.address is not None and self._air.radios[known.radio].is_up

    def send(self, node: NodeId, message: Stimulate, *, is_urgent: bool = False) -> "asyncio.Future[RadioOutcome]":
        """Send over the radio that heard the biobot last."""
        known = self._nodes.find(node)
        if known is None or not self.can_send(node):
            raise RadioUnavailableError(radio=f"of biobot {node}", reason="it is down")
        return self._air.send(message, life=self._life, node=node, radio=known.radio, is_urgent=is_urgent)

    def send_elsewhere(self, node: NodeId, message: Stimulate) -> "list[asyncio.Future[RadioOutcome]]":
        """Send, urgently, over each other radio that heard the biobot of late."""
        known = self._nodes.find(node)
        places = self._nodes.places_of(node, now_ns=self._now_ns())
        ways = [place.radio for place in places if known is not None and place.radio != known.radio]
        return [
            self._air.send(message, life=self._life, node=node, radio=way, is_urgent=True) for way in ways if self._air.radios[way].is_up
        ]

    def ways_to(self, node: NodeId) -> list[str]:
        """Return the radios that may reach the biobot, the one that heard it last first."""
        known = self._nodes.find(node)
        last = [] if known is None else [known.radio]
        return list(dict.fromkeys([*last, *(place.radio for place in self._nodes.places_of(node, now_ns=self._now_ns()))]))

    def send_over(self, radio: str, node: NodeId, message: Stimulate) -> "asyncio.Future[RadioOutcome]":
        """Send, urgently, over one of them."""
        if not self._air.radios[radio].is_up:
            raise RadioUnavailableError(radio=f"of biobot {node}", reason="it is down")
        return self._air.send(message, life=self._life, node=node, radio=radio, is_urgent=True)

    def send_to_all(self, message: Stimulate) -> "dict[str, asyncio.Future[RadioOutcome]]":
        """Send one urgent broadcast over each radio that is up."""
        up = [radio.name for radio in self._air.radios.values() if radio.is_up]
        return {name: self._air.send(message, life=self._life, node=None, radio=name, is_urgent=True) for name in up}

    def withdraw(self, sending: "asyncio.Future[RadioOutcome]") -> bool:
        """Take back a frame that was not written; True where it now never will be."""
        return self._air.withdraw(sending)


def _repeat_ns(repeat: int) -> int:
    return min(_FIRST_REPEAT_NS << repeat, _MAX_REPEAT_NS)


def _nobody_hears(_answer: Answer, _radio: str) -> bool:
    return False
