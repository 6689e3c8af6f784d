"""A dongle with faults: its firmware starts anew, its buffers are full, and it tells untrue outcomes. No I/O."""

from collections import Counter, deque
from collections.abc import Iterator

from firmware_protocol.envelope import RadioReceived, RadioSend, RadioStatus
from firmware_protocol.units import ShortAddress
from simulator.dongles.interface import Dongle
from simulator.lines.faults import FaultConfig, FaultDraws, Spell, SpellKind
from simulator.log import EventLog

log = EventLog(__name__)

_WRONG_STATUS = "wrong_status"


class FaultyDongle:
    """A ``Dongle`` around another one, of whatever dialect; spells are counted from ``start``."""

    def __init__(self, dongle: Dongle, draws: FaultDraws) -> None:
        self.requests: deque[RadioSend] = deque()
        self.faults = dongle.faults
        self.counts: Counter[str] = Counter()
        """What was done to the dongle so far, by kind."""
        self._dongle = dongle
        self._draws = draws
        self._coming: dict[SpellKind, Iterator[Spell]] = {kind: draws.spells(kind) for kind in (SpellKind.RESET, SpellKind.FULL)}
        self._spells = {kind: spell for kind, coming in self._coming.items() if (spell := next(coming, None)) is not None}
        self._under_way: set[SpellKind] = set()
        self._zero_ns = 0
        self._n_confirmed = 0
        self._in_radio: Counter[int] = Counter()
        self._forgotten: Counter[int] = Counter()
        """Handles of requests from before a reset, of which the radio's answer is still to come."""

    @property
    def is_open(self) -> bool:
        """See ``Dongle``."""
        return self._dongle.is_open and not self._is_dead

    @property
    def _is_dead(self) -> bool:
        return SpellKind.RESET in self._under_way

    def start(self, *, now_ns: int) -> None:
        """See ``Dongle``."""
        self._zero_ns = now_ns
        self._dongle.start(now_ns=now_ns)

    def feed(self, chunk: bytes, *, now_ns: int) -> None:
        """See ``Dongle``; a dead dongle hears nothing."""
        if not self._is_dead:
            self._dongle.feed(chunk, now_ns=now_ns)
            self._take_requests(now_ns)

    def take_bytes(self) -> bytes:
        """See ``Dongle``."""
        return b"" if self._is_dead else self._dongle.take_bytes()

    def next_deadline_ns(self) -> int | None:
        """See ``Dongle``."""
        dues = [self._zero_ns + self._turn_ns(spell) for spell in self._spells.values()]
        own = None if self._is_dead else self._dongle.next_deadline_ns()
        return min(dues if own is None else [*dues, own], default=None)

    def handle_deadline(self, *, now_ns: int) -> None:
        """See ``Dongle``; begin and end what is due of the spells."""
        for kind, spell in self._spells.items():
            if self._zero_ns + self._turn_ns(spell) <= now_ns:
                if kind in self._under_way:
                    self._end(kind, now_ns=now_ns)
                else:
                    self._begin(kind)
        deadline_ns = self._dongle.next_deadline_ns()
        if not self._is_dead and deadline_ns is not None and deadline_ns <= now_ns:
            self._dongle.handle_deadline(now_ns=now_ns)
            self._take_requests(now_ns)

    def take_from_radio(self, received: RadioReceived, *, eui64: int, now_ns: int) -> bool:
        """See ``Dongle``; one that is full or dead takes nothing."""
        if self._under_way:
            self.counts["not_taken"] += 1
            return False
        return self._dongle.take_from_radio(received, eui64=eui64, now_ns=now_ns)

    def confirm(self, handle: int, status: RadioStatus, *, now_ns: int) -> None:
        """See ``Dongle``; what a reset made the dongle forget is not told, and some of the rest is told wrong."""
        if self._forgotten[handle]:
            self._forgotten[handle] -= 1
            return
        self._in_radio[handle] -= 1
        others = [one for one in RadioStatus if one is not status]
        other = self._draws.other_status(self._n_confirmed, n_others=len(others))
        self._n_confirmed += 1
        if other is not None:
            self.counts[_WRONG_STATUS] += 1
        self._dongle.confirm(handle, status if other is None else others[other], now_ns=now_ns)

    def node_joined(self, address: ShortAddress, *, eui64: int, now_ns: int) -> None:
        """See ``Dongle``; the network goes on while the dongle is dead."""
        self._dongle.node_joined(address, eui64=eui64, now_ns=now_ns)

    def _take_requests(self, now_ns: int) -> None:
        while self._dongle.requests:
            request = self._dongle.requests.popleft()
            if SpellKind.FULL in self._under_way:
                self.counts["refused"] += 1
                self._dongle.confirm(request.handle, RadioStatus.QUEUE_FULL, now_ns=now_ns)
            else:
                self._in_radio[request.handle] += 1
                self.requests.append(request)

    def _turn_ns(self, spell: Spell) -> int:
        return spell.end_ns if spell.kind in self._under_way else spell.begin_ns

    def _begin(self, kind: SpellKind) -> None:
        log.warning("fault.begins", fault=kind.value, coordinator=self._draws.line + 1)
        self.counts[kind.value] += 1
        self._under_way.add(kind)
        if kind is SpellKind.RESET:
            self._in_radio.subtract(request.handle for request in self.requests)  # these the radio never saw
            self.requests.clear()
            self._forgotten += self._in_radio
            self._in_radio.clear()

    def _end(self, kind: SpellKind, *, now_ns: int) -> None:
        log.info("fault.ended", fault=kind.value, coordinator=self._draws.line + 1)
        self._under_way.remove(kind)
        self._spells[kind] = next(self._coming[kind])
        if kind is SpellKind.RESET:
            self._dongle.take_bytes()  # what it had to say is gone with its memory
            self._dongle.start(now_ns=now_ns)


def with_faults(dongle: Dongle, config: FaultConfig, *, seed: int, line: int) -> Dongle:
    """Return a dongle that has the faults of its line, counted from 0; the dongle itself where there are none."""
    faults = config.of_line(line)
    return dongle if faults is None else FaultyDongle(dongle, FaultDraws(config=faults, seed=seed, line=line))
