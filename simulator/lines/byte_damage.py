"""Damages a stream of bytes as a bad cable does. No I/O; any chunking of the stream is damaged alike."""

import heapq
from collections import Counter

from simulator.lines.faults import ByteFault, Damage, Direction, FaultDraws

_SHORTEST_RUN, _LONGEST_RUN = 2, 32
"""Bytes that a truncation takes at least and at most."""


class ByteDamage:
    """One direction of one line; ``counts`` tells what was done, by kind."""

    def __init__(self, draws: FaultDraws, direction: Direction) -> None:
        self.counts: Counter[ByteFault] = Counter()
        # Where two kinds meet at one byte, the order of ``ByteFault`` decides.
        order = {kind: index for index, kind in enumerate(ByteFault)}
        self._coming = heapq.merge(*(draws.damages(kind, direction) for kind in ByteFault), key=lambda one: (one.at, order[one.kind]))
        self._next: Damage | None = next(self._coming, None)
        self._n_passed = 0
        self._n_to_lose = 0

    def apply(self, data: bytes) -> bytes:
        """Return what is left of the next bytes."""
        if self._next is None:
            return data
        out = bytearray()
        done = 0
        while self._next is not None and self._next.at < self._n_passed + len(data):
            at = self._next.at - self._n_passed
            out += self._survivors(data[done:at])
            done = at
            byte = data[at : at + 1]
            while self._next is not None and self._next.at == self._n_passed + at:
                byte = self._harm(byte, self._next)
                self._next = next(self._coming, None)
            if self._n_to_lose:
                self._n_to_lose -= 1
            else:
                out += byte
            done = at + 1
        out += self._survivors(data[done:])
        self._n_passed += len(data)
        return bytes(out)

    def _harm(self, byte: bytes, damage: Damage) -> bytes:
        self.counts[damage.kind] += 1
        match damage.kind:
            case ByteFault.BIT_FLIP:
                return bytes([byte[0] ^ 1 << damage.value % 8])
            case ByteFault.DROP:
                return b""
            case ByteFault.INSERT:
                return bytes([damage.value % 256]) + byte
            case ByteFault.TRUNCATE:
                self._n_to_lose = max(self._n_to_lose, _SHORTEST_RUN + damage.value % (_LONGEST_RUN - _SHORTEST_RUN + 1))
                return byte

    def _survivors(self, data: bytes) -> bytes:
        n_lost = min(self._n_to_lose, len(data))
        self._n_to_lose -= n_lost
        return data[n_lost:]
