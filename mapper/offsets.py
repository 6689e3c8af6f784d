"""Which offsets of a journal have arrived: all up to a watermark, and ranges beyond it."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator


class OffsetSet:
    """A set of offsets, counted from 1, held as a watermark and disjoint ranges beyond it.

    The law: `watermark` is the highest offset up to which nothing is missing, and what is in the set depends only on
    what was added, never on the order.
    """

    __slots__ = ("_firsts", "_lasts", "watermark")

    def __init__(self, *, watermark: int = 0, spans: Iterable[tuple[int, int]] = ()) -> None:
        self.watermark = watermark
        self._firsts: list[int] = []
        self._lasts: list[int] = []
        for first, last in spans:
            self.add(first, last)

    def add(self, first: int, last: int | None = None) -> None:
        """Add one offset, or all from ``first`` to ``last``, both included; what is there already stays."""
        last = first if last is None else last
        first = max(first, self.watermark + 1)
        if last < first:
            return
        # Ranges that touch or overlap [first - 1, last + 1] become one with it.
        low = bisect_right(self._lasts, first - 2)
        high = bisect_right(self._firsts, last + 1)
        if low < high:
            first = min(first, self._firsts[low])
            last = max(last, self._lasts[high - 1])
        self._firsts[low:high] = [first]
        self._lasts[low:high] = [last]
        if self._firsts[0] == self.watermark + 1:
            self.watermark = self._lasts[0]
            del self._firsts[0], self._lasts[0]

    def __contains__(self, offset: int) -> bool:
        if offset <= self.watermark:
            return offset >= 1
        place = bisect_right(self._firsts, offset) - 1
        return place >= 0 and offset <= self._lasts[place]

    @property
    def spans(self) -> tuple[tuple[int, int], ...]:
        """The ranges beyond the watermark, ascending, none touching another."""
        return tuple(zip(self._firsts, self._lasts, strict=True))

    @property
    def last(self) -> int:
        """The highest offset of all, 0 where the set is empty."""
        return self._lasts[-1] if self._lasts else self.watermark

    def first_hole(self, *, up_to: int) -> tuple[int, int] | None:
        """Name the first run of missing offsets not beyond ``up_to``, both ends included; None where nothing is missing."""
        first = self.watermark + 1
        if first > up_to:
            return None
        return first, min(up_to, self._firsts[0] - 1) if self._firsts else up_to


def runs(offsets: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield first and last of the offsets that follow each other: a batch is most often one run."""
    first = last = None
    for offset in offsets:
        if first is None or last is None:
            first = last = offset
        elif offset == last + 1:
            last = offset
        elif offset != last:
            yield first, last
            first = last = offset
    if first is not None and last is not None:
        yield first, last
