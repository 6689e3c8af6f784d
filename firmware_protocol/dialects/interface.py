"""What every dialect offers the base station: one end of a line to a coordinator dongle, without I/O and without a clock.

A *host* opens the dongle (session, reset, network), hands up every radio payload that the dongle hears, sends payloads down and tells what
became of each. It is driven as ``link.py`` is: every call takes ``now_ns`` (monotonic), ``next_deadline_ns`` says when ``handle_deadline``
is to be called, ``take_frames`` hands out what is to be written. No input raises; what was of no use is counted in ``faults``.
"""

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeAlias

from msgspec import Struct

from firmware_protocol.envelope import CoordinatorHello, RadioReceived
from firmware_protocol.units import ShortAddress


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkWish:
    """What network a dongle is to form that has none; a network that is there is kept. Of the dialects only Z-Stack forms one.

    Parameters
    ----------
    pan_id
        0x0000 to 0xFFFE; None: the dongle chooses.
    channel
        11 to 26; None: the dialect's own choice.
    permit_join_s
        How long nodes may join after each opening [s]; 0 never, 254 for as long as the base station runs.
    """

    pan_id: int | None = None
    channel: int | None = None
    permit_join_s: int = 254


class LostWhy(Enum):
    """Why a dongle was given up."""

    NO_ANSWER = "no_answer"
    RESTARTED = "restarted"
    """It says that it has just started: it is to be opened again, on the same port."""
    REFUSED = "refused"
    """It answers, and cannot do what is needed; ``detail`` says what."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostOpened:
    """The dongle answers and its network is up: payloads can be sent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoordinatorIdentified:
    """The dongle has said who it is; may come again. ``description`` is its firmware in its maker's words."""

    hello: CoordinatorHello
    description: str = ""


class PayloadHeard(Struct, frozen=True, kw_only=True, gc=False):
    """A radio payload came in; ``confirm(receipt)`` tells the dongle, where its dialect can, that it is safe."""

    received: RadioReceived
    receipt: int


class SendSettled(Struct, frozen=True, kw_only=True, gc=False):
    """What became of the payload that ``send`` gave this ticket: a ``RadioStatus`` value, or one of a newer firmware."""

    ticket: int
    status: int


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSeen:
    """A node has joined, or told both its addresses."""

    address: ShortAddress
    eui64: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CoordinatorSaid:
    """The dongle reports something worth a line in the log; ``level`` is 0 debug, 1 info, 2 warning, 3 error."""

    level: int
    name: str
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostLost:
    """The dongle is no longer open; ``dropped`` are the tickets whose outcome will never be known."""

    why: LostWhy
    detail: str = ""
    dropped: tuple[int, ...] = ()


HostEvent: TypeAlias = HostOpened | CoordinatorIdentified | PayloadHeard | SendSettled | NodeSeen | CoordinatorSaid | HostLost


class Host(Protocol):
    """The base station's end; see the module. A closed or lost host may be opened again."""

    faults: Counter[str]
    """What came in and was of no use, by name: ``frame.bad_crc``, ``envelope.unknown_envelope_type``, ``link.ignored``."""

    @property
    def is_open(self) -> bool:
        """Payloads can be sent now."""
        ...

    @property
    def has_frames(self) -> bool:
        """``take_frames`` has something to give now."""
        ...

    def open(self, *, session: int, now_ns: int) -> list[HostEvent]:
        """Begin with a dongle in an unknown state. ``session`` is a number the last opening did not have; not every dialect needs it."""
        ...

    def feed(self, chunk: bytes, *, now_ns: int) -> list[HostEvent]:
        """Take bytes from the line, cut anywhere; return what they brought about."""
        ...

    def send(self, *, destination: ShortAddress, payload: bytes, now_ns: int, is_urgent: bool = False) -> int:
        """Queue a radio payload and return its ticket.

        An urgent one goes ahead of all that has not been written, and an urgent broadcast of urgent ones too. Every ticket ends in one
        ``SendSettled`` or in the ``dropped`` of a ``HostLost``, or the dongle never says (the caller has its own patience, and calls
        ``forget``).

        Raises
        ------
        LinkFullError
            The queue is full. An urgent payload is taken all the same.
        EncodeError
            The payload is longer than ``MAX_RADIO_PAYLOAD``.
        """
        ...

    def forget(self, ticket: int) -> None:
        """Wait no more for what became of a payload; one that was not written yet is not sent."""
        ...

    def withdraw(self, ticket: int) -> bool:
        """Take back a payload that ``take_frames`` has not handed out: its ticket has no end then. False: it was, or nobody knows it."""
        ...

    def confirm(self, receipt: int) -> None:
        """Say that all payloads heard up to and including ``receipt`` are safe on disk."""
        ...

    def take_frames(self, *, at_most: int | None = None) -> list[bytes]:
        """Return what is to be written, all or so much, frame by frame as it goes on the line; each is handed out once."""
        ...

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None where nothing is awaited."""
        ...

    def handle_deadline(self, *, now_ns: int) -> list[HostEvent]:
        """Repeat what was not answered, or give the dongle up. Calling too early does nothing."""
        ...
