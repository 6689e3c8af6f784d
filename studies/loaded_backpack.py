"""A backpack that has a lot to say, and the timetable by which it meets others: the cheap side of a load on a gateway.

Its payloads are packed from the layouts' own sizes without objects in between, for the load must cost less than what it loads.
"""

import struct
from binascii import crc_hqx
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from firmware_protocol.crc import CRC_INITIAL
from firmware_protocol.message_codec import decode_downlink, encode_uplink
from firmware_protocol.messages import (
    Acknowledge,
    Action,
    Capability,
    Hello,
    HelloRequest,
    Status,
    Stimulate,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    TimeSyncRequest,
    Uplink,
    UplinkHeader,
    WireCause,
    WireMode,
)
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Milliseconds, NodeId

DURATION_MS: Final = 200
_AGO_MS: Final = 600
"""A meeting began so long before its report, and was over well before it."""

_APART_MS: Final = 5
_AGAIN_NS: Final = 700 * NS_PER_MS
"""From the beginning of a pair's meeting to that of its next one, at least: more than its duration and all that a gateway bridges."""

_LEAD: Final = 16
"""Messages that the fastest biobot may be ahead of the slowest one: both sides of a meeting come close to each other."""

OUTSTANDING: Final = 12
"""Newest sequence number minus the oldest that is not acknowledged. The protocol allows 30 (WIRE_FORMAT.md §5.1); with that many from each
of 32 biobots a dongle's queue alone lasts for longer than the second after which they repeat, and what is measured is repetitions."""

_FOR_REPLIES: Final = 2
"""Further numbers, for StimulateReply alone: a base station whose disk is full acknowledges nothing, and hears it all the same."""

_BOOT: Final = BootId(1)
_BOOTED_NS: Final = 1_000 * NS_PER_S
"""Every backpack was started so long before the load, and each some milliseconds later than the one before."""

_REPEAT_NS: Final = NS_PER_S
_SPREAD_NS: Final = NS_PER_S
"""Within which a broadcast is answered (WIRE_FORMAT.md §6.5); here in the order of numbers."""
_MAX_REPEAT_NS: Final = 30 * NS_PER_S
_BATCH: Final = 0x02
_HEADER: Final = struct.Struct("<BBHHHI")  # WIRE_FORMAT.md §5.1
_ENTRY: Final = struct.Struct("<HIBHb")  # WIRE_FORMAT.md §5.3


@dataclass(slots=True, kw_only=True)
class Timetable:
    """Who meets whom when. In round ``r`` biobot ``a`` meets the one ``shift(r)`` places after it; a message tells of some rounds."""

    n_biobots: int
    n_entries: int
    n_sides: int
    n_encounters: int
    rate: float
    slowest: int = 0
    """Messages that the biobot that has begun the fewest has begun."""
    round_ns: list[int] = field(default_factory=list)
    """Beginning of each round's meetings, on the monotonic clock, in whole milliseconds."""
    sent_ns: dict[int, list[int]] = field(default_factory=dict)
    """When each message of each biobot was first handed to the line."""
    _begun_ns: int | None = None

    @property
    def n_rounds_each(self) -> int:
        """Rounds that a message tells of."""
        return max(1, self.n_entries // self.n_sides)

    @property
    def n_messages(self) -> int:
        """Of each biobot."""
        per_round = self.n_biobots * self.n_entries
        return -(-self.n_encounters // per_round)

    def begin(self, now_ns: int) -> None:
        """Let the first round begin."""
        self._begun_ns = now_ns

    def is_due(self, message: int, node: int, now_ns: int) -> bool:
        """Whether a biobot may say its next message."""
        if self._begun_ns is None or message >= self.n_messages or message > self.slowest + _LEAD:
            return False
        last, cycle = (message + 1) * self.n_rounds_each - 1, self.n_biobots // 2 - 1
        if last >= max(len(self.round_ns), cycle) and now_ns - _AGO_MS * NS_PER_MS < self.round_ns[last - cycle] + _AGAIN_NS:
            return False
        if not self.rate:
            return True
        period_ns = self.n_biobots * self.n_entries * NS_PER_S / self.rate
        return now_ns >= self._begun_ns + (message + node / self.n_biobots) * period_ns

    def shift(self, at: int) -> int:
        """Return how many places apart those are that meet in a round: no pair meets again before all have met."""
        return at % (self.n_biobots // 2 - 1) + 1

    def entries(self, message: int, node: int, boot_ns: int, now_ns: int) -> bytes:
        """Return the entries of a biobot's message, as they stand in it."""
        parts: list[bytes] = []
        n_biobots = self.n_biobots
        for at in range(message * self.n_rounds_each, (message + 1) * self.n_rounds_each):
            if at >= len(self.round_ns):
                self.round_ns.append((now_ns // NS_PER_MS - _AGO_MS + _APART_MS * (at % self.n_rounds_each)) * NS_PER_MS)
            start_ms = (self.round_ns[at] - boot_ns) // NS_PER_MS
            shift = self.shift(at)
            parts.append(_ENTRY.pack((node - 1 + shift) % n_biobots + 1, start_ms, 0, DURATION_MS, -60))
            if self.n_sides == 2:
                parts.append(_ENTRY.pack((node - 1 - shift) % n_biobots + 1, start_ms, 0, DURATION_MS, -60))
        return b"".join(parts)

    def note_sent(self, node: int, now_ns: int) -> None:
        """Remember when a biobot's next message was first sent."""
        self.sent_ns.setdefault(node, []).append(now_ns)

    def arrays(self) -> dict[str, npt.NDArray[np.int64]]:
        """Return what a check needs: the shape of the timetable, when its rounds were, and when each message was sent."""
        shape = (self.n_biobots, self.n_entries, self.n_sides, self.n_rounds_each, self.n_messages, DURATION_MS)
        sent = [self.sent_ns[node] for node in range(1, self.n_biobots + 1)]
        return {"shape": np.array(shape), "round_ns": np.array(self.round_ns), "sent_ns": np.array(sent)}


@dataclass(slots=True, kw_only=True)
class LoadedBackpack:
    """See the module; WIRE_FORMAT.md §5.12 is what it does with a message."""

    node: int
    eui64: int
    timetable: Timetable
    n_outstanding: int = OUTSTANDING
    n_begun: int = 0
    """Messages of the timetable that it has sent."""
    n_repeats: int = 0
    n_acknowledgements: int = 0
    is_synchronised: bool = False
    _boot_ns: int = 0
    _sequence: int = 0
    _outstanding: dict[int, tuple[int, bytes]] = field(default_factory=dict)
    """Type and body of each message that was not acknowledged, by its number, the oldest first."""
    _repeats: deque[tuple[int, int, int]] = field(default_factory=deque)
    """When what is to be said again, and how long it waited."""
    _answers: deque[bytes] = field(default_factory=deque)
    _first_words: deque[Uplink] = field(default_factory=deque)
    _late_words: deque[tuple[int, Uplink]] = field(default_factory=deque)
    """Answers to a broadcast, and when each is said."""
    _offer: "tuple[int, int | None] | None" = None
    """Number and wait of the message that the dongle was offered; no number: an answer."""

    def __post_init__(self) -> None:
        self._boot_ns = -_BOOTED_NS
        self._first_words.append(self._hello())
        self._first_words.append(
            Status(mode=WireMode.CRW, cause=WireCause.NATURAL, mode_since_ms=Milliseconds(1), battery_mv=3000, buffered=0, dropped=0)
        )

    @property
    def is_settled(self) -> bool:
        """The gateway has it in its journal, and knows its clock."""
        return self.is_synchronised and not self._first_words and not self._outstanding

    @property
    def is_done(self) -> bool:
        """All of its timetable is acknowledged."""
        return self.n_begun >= self.timetable.n_messages and not self._outstanding

    def next_payload(self, now_ns: int) -> bytes | None:
        """Return what the radio is offered now; ``was_taken`` or ``was_refused`` says what became of it."""
        while self._late_words and self._late_words[0][0] <= now_ns:
            self._first_words.append(self._late_words.popleft()[1])
        if self._answers:
            self._offer = (-1, None)
            return self._answers[0]
        oldest = next(iter(self._outstanding), self._sequence)
        is_reply = bool(self._first_words) and isinstance(self._first_words[0], StimulateReply)
        has_room = self._sequence - oldest < self.n_outstanding + is_reply * _FOR_REPLIES
        while not (is_reply and has_room) and self._repeats and self._repeats[0][0] <= now_ns:
            _, number, wait_ns = self._repeats[0]
            if number in self._outstanding:
                self._offer = (number, wait_ns)
                return self._payload(number, now_ns)
            self._repeats.popleft()
        if not has_room:
            return None
        if self._first_words:
            whole = encode_uplink(self._header(0, now_ns), self._first_words[0])
            self._outstanding[self._sequence] = (whole[0], whole[_HEADER.size : -2])
        elif self.timetable.is_due(self.n_begun, self.node, now_ns):
            self._outstanding[self._sequence] = (_BATCH, self.timetable.entries(self.n_begun, self.node, self._boot(now_ns), now_ns))
        else:
            return None
        self._offer = (self._sequence, None)
        return self._payload(self._sequence, now_ns)

    def was_taken(self, now_ns: int) -> None:
        """The dongle has what it was offered."""
        assert self._offer is not None
        number, wait_ns = self._offer
        if number < 0:
            self._answers.popleft()
        elif wait_ns is not None:
            self._repeats.popleft()
            self.n_repeats += 1
            self._repeats.append((now_ns + min(2 * wait_ns, _MAX_REPEAT_NS), number, min(2 * wait_ns, _MAX_REPEAT_NS)))
        else:
            self._sequence += 1
            self._repeats.append((now_ns + _REPEAT_NS, number, _REPEAT_NS))
            if self._first_words:
                self._first_words.popleft()
            else:
                self.n_begun += 1
                self.timetable.note_sent(self.node, now_ns)

    def was_refused(self, now_ns: int) -> None:  # noqa: ARG002  # as was_taken
        """The dongle has no room."""
        assert self._offer is not None
        number, wait_ns = self._offer
        if number >= 0 and wait_ns is None:
            del self._outstanding[number]

    def hear(self, payload: bytes, *, now_ns: int, is_broadcast: bool = False) -> None:
        """Take a payload from the base station; every command is answered *done*, and that is all that it does."""
        decoded = decode_downlink(payload)
        if not isinstance(decoded, tuple):
            return
        match decoded[1]:
            case Acknowledge() as known if known.boot == _BOOT:
                self.n_acknowledgements += 1
                for number in list(self._outstanding):
                    ahead = (number - known.next_sequence) % 65536
                    if ahead >= 32768 or (1 <= ahead <= 32 and known.bitmap >> (ahead - 1) & 1):
                        del self._outstanding[number]
            case TimeSyncRequest(token=token):
                message = TimeSyncReply(token=token, received_ms=Milliseconds(self._tick(now_ns)))
                self._answers.append(encode_uplink(self._header(0, now_ns), message))
                self.is_synchronised = True
            case Stimulate(command=command, action=action) if not is_broadcast or action is Action.STOP:
                mode = WireMode.S if action is Action.STOP else WireMode.CRW
                executed_ms = Milliseconds(self._tick(now_ns))
                reply = StimulateReply(command=command, result=StimulationResult.DONE, executed_ms=executed_ms, mode=mode)
                wait_ns = self.node * _SPREAD_NS // self.timetable.n_biobots if is_broadcast else 0
                self._late_words.append((now_ns + wait_ns, reply))
            case HelloRequest() if not self._first_words:
                self._first_words.append(self._hello())
            case _:
                pass

    def _hello(self) -> Hello:
        return Hello(eui64=self.eui64, firmware=0x0102, beacon_period_ms=0, capabilities=Capability.STIMULATION)

    def _boot(self, now_ns: int) -> int:
        if self._boot_ns < 0:
            self._boot_ns += now_ns + self.node * NS_PER_MS
            self._boot_ns -= self._boot_ns % NS_PER_MS
        return self._boot_ns

    def _tick(self, now_ns: int) -> int:
        return (now_ns - self._boot(now_ns)) // NS_PER_MS

    def _header(self, sequence: int, now_ns: int) -> UplinkHeader:
        return UplinkHeader(node=NodeId(self.node), boot=_BOOT, sequence=sequence, sent_ms=Milliseconds(self._tick(now_ns)))

    def _payload(self, number: int, now_ns: int) -> bytes:
        kind, body = self._outstanding[number]
        whole = _HEADER.pack(kind, 1, self.node, _BOOT, number % 65536, self._tick(now_ns)) + body
        return whole + crc_hqx(whole, CRC_INITIAL).to_bytes(2, "big")
