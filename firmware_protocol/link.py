"""Reliable, ordered delivery of payloads over one serial line (WIRE_FORMAT.md §3).

Theory of operation
-------------------
Two ends, two roles. The *initiator* (the base station) opens a session with RESET and a session number; the *responder*
(the coordinator dongle) answers RESET_ACK. Within a session each end numbers its DATA frames modulo 256, keeps a window
of them unacknowledged, and repeats all of the window (go-back-N) when no acknowledgement comes in time, or when one comes
that says nothing new: then something is missing at the other end. Repetitions are answered so, too; hence it counts only
when something sent after the last repetition has been acknowledged, and each new payload brings about one repetition at most.

A receiver acknowledges a payload only when its owner says so (``confirm``): the base station confirms after the payload's
records are on disk. A repeated payload that still waits for its confirmation is answered with the old acknowledgement, so
a slow disk stalls the sender but does not break the link. An initiator, though, gives up a responder that talks but
acknowledges nothing, unless it is the initiator's own owner that stalls: then the responder may have no room for an answer.

What a responder has not seen acknowledged survives a new session and is sent again: nothing heard over the air is lost
because a cable was pulled. What an initiator has not seen acknowledged is dropped and reported: a command to a living
animal is never sent again behind its owner's back.

The engine does no I/O and owns no clock: every call takes ``now_ns`` (monotonic), ``next_deadline_ns`` says when to call
``handle_deadline``, and ``take_frames`` hands out what is to be sent. Frames with an unknown session or kind are counted
and ignored; no input raises.
"""

import struct
from collections import deque
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import TypeAlias

from msgspec import Struct

from firmware_protocol.errors import LinkFullError
from firmware_protocol.link_queue import LinkQueue

LINK_VERSION = 1
"""Newest version of the link that this code speaks (§3.5)."""

MAX_PAYLOAD = 240
"""Longest payload of a DATA frame [B]; with the 4-byte header it fits every framing's body."""

_HEADER = struct.Struct("<BHB")  # kind, session, sequence (§3.1)
_NS_PER_MS = 1_000_000


class _Kind(IntEnum):
    RESET = 1
    RESET_ACK = 2
    DATA = 3
    ACK = 4
    PING = 5
    NEED_RESET = 6


class Role(Enum):
    """Which end of the line this is."""

    INITIATOR = "initiator"
    RESPONDER = "responder"


class LinkState(Enum):
    """Where the link stands."""

    CLOSED = "closed"
    OPENING = "opening"
    OPEN = "open"


class LostReason(Enum):
    """Why a link was given up."""

    NO_ANSWER = "no_answer"
    PEER_RESTARTED = "peer_restarted"
    PEER_RESET = "peer_reset"
    NO_PROGRESS = "no_progress"
    """It talks, and acknowledges nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig:
    """Timers and bounds; the defaults are those of WIRE_FORMAT.md §3.4."""

    window: int = 16
    urgent_window: int = 16
    """Up to how many in flight an urgent payload is sent, where ``window`` is less."""
    max_queue: int = 512
    retransmit_ns: int = 300 * _NS_PER_MS
    max_retransmit_ns: int = 2_000 * _NS_PER_MS
    max_silent_retries: int = 5
    max_fruitless_retries: int = 10
    keepalive_ns: int = 3_000 * _NS_PER_MS
    reset_retry_ns: int = 500 * _NS_PER_MS


class LinkOpened(Struct, frozen=True, kw_only=True, gc=False):
    """A session began; sequence numbers start anew."""


class PayloadReceived(Struct, frozen=True, kw_only=True, gc=False):
    """A payload arrived, once and in order; ``confirm(receipt)`` lets the peer forget it."""

    payload: bytes
    receipt: int


class PayloadConfirmed(Struct, frozen=True, kw_only=True, gc=False):
    """The peer has confirmed the payload that ``send`` gave this ticket."""

    ticket: int


class LinkLost(Struct, frozen=True, kw_only=True, gc=False):
    """The session ended; ``dropped`` are the tickets whose outcome is not known."""

    reason: LostReason
    dropped: tuple[int, ...] = ()


LinkEvent: TypeAlias = LinkOpened | PayloadReceived | PayloadConfirmed | LinkLost


@dataclass(slots=True, kw_only=True)
class Link:
    """One end of a link. See the module's theory of operation.

    Parameters
    ----------
    role
        INITIATOR at the base station, RESPONDER in a coordinator.
    config
        Timers and bounds.
    """

    role: Role
    config: LinkConfig = field(default_factory=LinkConfig)
    state: LinkState = LinkState.CLOSED
    version: int = LINK_VERSION
    """Of the session: the newest that both ends speak (§3.5)."""
    n_ignored: int = 0
    """Frames not of this session or not understood."""
    outgoing: LinkQueue = field(init=False)
    _session: int = 0
    _frames: list[bytes] = field(default_factory=list)
    _next_ticket: int = 1
    _first_unacknowledged: int = 0
    _next_expected: int = 0
    _n_confirmed: int = 0
    _receipts: deque[int] = field(default_factory=deque)
    _next_receipt: int = 1
    _retransmit_at_ns: int | None = None
    _retransmit_ns: int = 0
    _reset_at_ns: int | None = None
    _ping_at_ns: int | None = None
    _n_silent: int = 0
    _n_fruitless: int = 0
    """Repetitions since an acknowledgement made progress, not counting those while this end's owner stalled."""
    _newest_at_repetition: int = 0
    """Receipt of the newest payload that had come when the window was last repeated."""
    _n_repeating: int = 0
    """How many payloads must be acknowledged before an acknowledgement that says nothing new says that something was lost."""

    def __post_init__(self) -> None:
        self.outgoing = LinkQueue(window=self.config.window, urgent_window=self.config.urgent_window)

    def open(self, *, session: int, now_ns: int) -> list[LinkEvent]:
        """Begin a session under a number the last one did not have (initiator only); RESET is repeated until answered."""
        dropped = self.outgoing.drop_all()
        was_up = self.state is not LinkState.CLOSED
        self._begin(session)
        self.state = LinkState.OPENING
        self._push(_Kind.RESET, 0, bytes([LINK_VERSION]))
        self._reset_at_ns = now_ns + self.config.reset_retry_ns
        return [LinkLost(reason=LostReason.PEER_RESET, dropped=dropped)] if was_up and dropped else []

    @property
    def n_free(self) -> int:
        """How many more payloads ``send`` takes now."""
        return self.config.max_queue - len(self.outgoing)

    @property
    def has_frames(self) -> bool:
        """Whether ``take_frames`` gives one."""
        return bool(self._frames) or (self.state is LinkState.OPEN and self.outgoing.has_next)

    def send(self, payload: bytes, *, now_ns: int, is_urgent: bool = False, is_first: bool = False) -> int:
        """Queue a payload and return its ticket; an urgent one goes ahead of all that was not sent, a first one of urgent ones too.

        Raises
        ------
        LinkFullError
            The queue holds ``config.max_queue`` payloads. An urgent payload is taken all the same.
        ValueError
            The payload is longer than ``MAX_PAYLOAD``.
        """
        if len(payload) > MAX_PAYLOAD:
            msg = f"payload has {len(payload)} bytes, but a link payload has at most {MAX_PAYLOAD}"
            raise ValueError(msg)
        if self.n_free <= 0 and not (is_urgent or is_first):
            raise LinkFullError(limit=self.config.max_queue)
        ticket = self._next_ticket
        self._next_ticket += 1
        self.outgoing.add((ticket, payload), is_urgent=is_urgent, is_first=is_first)
        self._fill_window(now_ns)
        return ticket

    def cancel(self, ticket: int) -> bool:
        """Take back a payload that was not handed out yet; return whether it was not."""
        if not self.outgoing.cancel(ticket):
            return False
        if self.state is LinkState.OPEN:
            self.outgoing.fill_window()
        if not self.outgoing.n_in_window:
            self._retransmit_at_ns = None
        return True

    def confirm(self, receipt: int) -> None:
        """Acknowledge to the peer all payloads up to and including ``receipt``. Receipts of past sessions are ignored."""
        confirmed = 0
        while self._receipts and self._receipts[0] <= receipt:
            self._receipts.popleft()
            confirmed += 1
        if confirmed:
            self._n_confirmed = (self._n_confirmed + confirmed) % 256
            self._push(_Kind.ACK, self._n_confirmed)

    def receive(self, body: bytes, *, now_ns: int) -> list[LinkEvent]:
        """Take one frame body from the line; return what it brought about."""
        if len(body) < _HEADER.size:
            self.n_ignored += 1
            return []
        kind, session, sequence = _HEADER.unpack_from(body)
        payload = body[_HEADER.size :]
        if kind == _Kind.RESET and self.role is Role.RESPONDER:
            return self._accept_reset(session, payload, now_ns)
        if kind == _Kind.NEED_RESET and self.role is Role.INITIATOR and self.state is LinkState.OPEN:
            return self._lose(LostReason.PEER_RESTARTED)
        if session != self._session or self.state is LinkState.CLOSED:
            self.n_ignored += 1
            if self.role is Role.RESPONDER and kind in {_Kind.DATA, _Kind.PING}:
                self._push(_Kind.NEED_RESET, 0)
            return []
        if self.state is LinkState.OPENING:
            return self._take_reset_ack(payload, now_ns) if kind == _Kind.RESET_ACK else []
        self._heard(now_ns)
        if kind == _Kind.DATA:
            return self._take_data(sequence, payload)
        if kind == _Kind.ACK:
            return self._take_ack(sequence, now_ns)
        if kind == _Kind.PING:
            self._push(_Kind.ACK, self._n_confirmed)
        elif kind != _Kind.RESET_ACK:
            self.n_ignored += 1
        return []

    def take_frames(self, *, at_most: int | None = None) -> list[bytes]:
        """Return the frame bodies to put on the line, in order, all or so many; payloads get their numbers here."""
        limit = len(self._frames) + self.outgoing.n_in_window if at_most is None else at_most
        frames, self._frames = self._frames[:limit], self._frames[limit:]
        while self.state is LinkState.OPEN and len(frames) < limit and (taken := self.outgoing.take()) is not None:
            index, payload = taken
            frames.append(_HEADER.pack(_Kind.DATA, self._session, (self._first_unacknowledged + index) % 256) + payload)
        return frames

    def next_deadline_ns(self) -> int | None:
        """Return when ``handle_deadline`` must be called, or None where nothing is awaited."""
        return min((at for at in (self._retransmit_at_ns, self._reset_at_ns, self._ping_at_ns) if at is not None), default=None)

    def handle_deadline(self, *, now_ns: int) -> list[LinkEvent]:
        """Repeat what was not answered, or give the link up. Calling too early does nothing."""
        if self._reset_at_ns is not None and now_ns >= self._reset_at_ns:
            self._push(_Kind.RESET, 0, bytes([LINK_VERSION]))
            self._reset_at_ns = now_ns + self.config.reset_retry_ns
        if self._retransmit_at_ns is not None and now_ns >= self._retransmit_at_ns:
            if self._n_silent >= self.config.max_silent_retries:
                return self._lose(LostReason.NO_ANSWER)
            if self.role is Role.INITIATOR and self._is_fruitless():
                return self._lose(LostReason.NO_PROGRESS)
            self._n_silent += 1
            self._retransmit_ns = min(2 * self._retransmit_ns, self.config.max_retransmit_ns)
            self._repeat_window(now_ns)
        if self._ping_at_ns is not None and now_ns >= self._ping_at_ns:
            if self._n_silent >= self.config.max_silent_retries:
                return self._lose(LostReason.NO_ANSWER)
            self._n_silent += 1
            self._push(_Kind.PING, 0)
            self._ping_at_ns = now_ns + self.config.retransmit_ns
        return []

    def announce_restart(self) -> None:
        """Tell the initiator that this responder has just started and knows no session."""
        self._push(_Kind.NEED_RESET, 0)

    def _push(self, kind: _Kind, sequence: int, payload: bytes = b"") -> None:
        frame = _HEADER.pack(kind, self._session, sequence) + payload
        if payload or self._frames[-1:] != [frame]:  # what is about to be said is not said twice, however often it was asked
            self._frames.append(frame)

    def _begin(self, session: int) -> None:
        self._session = session & 0xFFFF
        self._frames.clear()
        self._receipts.clear()
        self._first_unacknowledged = self._next_expected = self._n_confirmed = self._n_silent = 0
        self._n_fruitless = self._n_repeating = 0
        self._retransmit_at_ns = self._reset_at_ns = self._ping_at_ns = None

    def _accept_reset(self, session: int, payload: bytes, now_ns: int) -> list[LinkEvent]:
        newest = _version_in(payload)
        if newest == 0:
            self.n_ignored += 1
            return []
        if self.state is LinkState.OPEN and session == self._session:
            self._push(_Kind.RESET_ACK, 0, bytes([self.version]))  # our answer was lost; the session has begun and goes on
            return []
        self.outgoing.start_anew()
        self._begin(session)
        self.version = min(newest, LINK_VERSION)
        self._push(_Kind.RESET_ACK, 0, bytes([self.version]))
        return self._opened(now_ns)

    def _take_reset_ack(self, payload: bytes, now_ns: int) -> list[LinkEvent]:
        version = _version_in(payload)
        if not 1 <= version <= LINK_VERSION:
            self.n_ignored += 1  # it chose what was not offered; RESET is sent again, and the base station reports that nothing answers
            return []
        self.version = version
        return self._opened(now_ns)

    def _opened(self, now_ns: int) -> list[LinkEvent]:
        self.state = LinkState.OPEN
        self._reset_at_ns = None
        self._retransmit_ns = self.config.retransmit_ns
        self._heard(now_ns)
        self._fill_window(now_ns)
        return [LinkOpened()]

    def _heard(self, now_ns: int) -> None:
        self._n_silent = 0
        if self.role is Role.INITIATOR:
            self._ping_at_ns = now_ns + self.config.keepalive_ns

    def _take_data(self, sequence: int, payload: bytes) -> list[LinkEvent]:
        if sequence != self._next_expected:
            self._push(_Kind.ACK, self._n_confirmed)
            return []
        self._next_expected = (sequence + 1) % 256
        receipt = self._next_receipt
        self._next_receipt += 1
        self._receipts.append(receipt)
        return [PayloadReceived(payload=payload, receipt=receipt)]

    def _take_ack(self, sequence: int, now_ns: int) -> list[LinkEvent]:
        n_acknowledged = (sequence - self._first_unacknowledged) % 256
        if n_acknowledged > self.outgoing.n_numbered:
            self.n_ignored += 1
            return []
        events: list[LinkEvent] = [PayloadConfirmed(ticket=ticket) for ticket in self.outgoing.acknowledge(n_acknowledged)]
        if n_acknowledged:
            self._n_fruitless = 0
            self._n_repeating = max(0, self._n_repeating - n_acknowledged)
            self._first_unacknowledged = sequence
            self._retransmit_ns = self.config.retransmit_ns
            self._retransmit_at_ns = now_ns + self._retransmit_ns if self.outgoing.n_in_window else None
            self._fill_window(now_ns)
        elif self.outgoing.n_numbered and not self._n_repeating:
            self._repeat_window(now_ns)
        return events

    def _fill_window(self, now_ns: int) -> None:
        if self.state is not LinkState.OPEN:
            return
        self.outgoing.fill_window()
        if self.outgoing.n_in_window and self._retransmit_at_ns is None:
            self._retransmit_at_ns = now_ns + self._retransmit_ns

    def _repeat_window(self, now_ns: int) -> None:
        self.outgoing.repeat()
        self._n_repeating = self.outgoing.n_numbered + 1  # and one that was not sent before
        self._retransmit_at_ns = now_ns + self._retransmit_ns

    def _is_fruitless(self) -> bool:
        """Count a repetition; return whether there were too many of them."""
        is_stalling = bool(self._receipts) and self._receipts[0] <= self._newest_at_repetition
        self._n_fruitless = 0 if is_stalling else self._n_fruitless + 1
        self._newest_at_repetition = self._next_receipt - 1
        return self._n_fruitless > self.config.max_fruitless_retries

    def _lose(self, reason: LostReason) -> list[LinkEvent]:
        self.state = LinkState.CLOSED
        self._frames.clear()
        self._receipts.clear()
        self._retransmit_at_ns = self._reset_at_ns = self._ping_at_ns = None
        dropped = self.outgoing.drop_all() if self.role is Role.INITIATOR else ()
        return [LinkLost(reason=reason, dropped=dropped)]


def _version_in(payload: bytes) -> int:
    """Return the link version that RESET and RESET_ACK carry; those of the first firmware carry none, which means 1."""
    return payload[0] if payload else 1
