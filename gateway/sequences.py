"""Which of a backpack's numbered messages have come (WIRE_FORMAT.md §5.1, §6.3)."""

from dataclasses import dataclass, field

ACKNOWLEDGE_SPAN = 32
"""A backpack has at most this many sequence numbers outstanding besides its oldest one (WIRE_FORMAT.md §5.1)."""

_MODULUS = 1 << 16


@dataclass(slots=True, kw_only=True)
class SequenceWindow:
    """Remembers which sequence numbers of one life of a backpack were taken.

    Numbers are unwrapped: they count on where the 16 bits of the wire begin again. All below ``next`` are done; since a
    backpack never has more than 33 numbers outstanding, a number tells that those more than 32 below it were acknowledged.
    """

    next: int = 0
    n_skipped: int = 0
    """Numbers from 0 to ``next`` that never came here: an earlier journal, or another gateway, acknowledged them."""
    is_fresh: bool = True
    _above: set[int] = field(default_factory=set)

    def unwrap(self, sequence: int) -> int:
        """Return the full number behind the 16 bits of ``sequence``; it is negative for one from before the first."""
        if self.is_fresh:
            return sequence
        ahead = (sequence - self.next) % _MODULUS
        return self.next + (ahead if ahead < _MODULUS // 2 else ahead - _MODULUS)

    def has(self, number: int) -> bool:
        """Whether ``number`` was taken or needs not be."""
        return number < self.next or number in self._above

    def add(self, number: int) -> None:
        """Take ``number``."""
        if number == self.next and not self._above and not self.is_fresh:
            self.next = number + 1
            return
        if self.is_fresh:
            # Those up to 32 below may yet come, also from before a wrap of the 16 bits: then their full numbers are negative.
            self.is_fresh, self.next = False, number - ACKNOWLEDGE_SPAN
            self.n_skipped = max(0, self.next)
        if self.has(number):
            return
        self._above.add(number)
        lowest = number - ACKNOWLEDGE_SPAN
        while self.next < lowest or self.next in self._above:
            if self.next in self._above:
                self._above.remove(self.next)
                self.next += 1
            else:  # go straight to the next number that is known, or to the lowest one outstanding
                target = min((known for known in self._above if known > self.next), default=lowest)
                target = min(target, lowest)
                self.n_skipped += max(0, target) - max(0, self.next)
                self.next = target

    def acknowledgement(self) -> tuple[int, int]:
        """Return ``next_sequence`` and ``bitmap`` of an Acknowledge that says what was taken."""
        bitmap = 0
        for number in self._above:
            bit = number - self.next - 1
            if 0 <= bit < ACKNOWLEDGE_SPAN:
                bitmap |= 1 << bit
        return self.next % _MODULUS, bitmap
