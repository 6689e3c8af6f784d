"""One clock for a site of several gateways: which start of a gateway is wrong by how much, through the backpacks that they share. Pure.

A *source* is one start of a gateway: its records share a wall-clock anchor, so all are wrong alike, but for the drift of two hosts'
monotonic clocks. Two sources of different gateways that heard of the same encounters know how far they are apart (`mapper.clock_votes`);
those connected so, directly or over others, have one clock: that of their *reference*. The others stay at their own wall clock.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from mapper.clock_samples import MAX_SAMPLE, SampledRows, SourceSample, make_sample
from mapper.clock_votes import ClockDifference, compare_clocks
from mapper.types import BoolArray, IntArray

_AGREE_NS: Final = 2_000_000_000
"""Clocks that differ by less agree: those set by NTP differ by less than a second (RFC 5905, 1)."""


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Source:
    """One start of a gateway."""

    gateway: str
    anchor_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceClock:
    """How one source's wall clock stands to the site's.

    ``offset_ns`` is what to add at its newest shared encounters; None where it shares too few with any other gateway. ``is_corrected``:
    it is added; where it is not more than ``bound_ns``, it may as well be zero, and nothing is added. ``n_votes`` shared encounters say
    so, since ``since_ns`` [site's clock]. ``reference`` is whose clock is the site's.
    """

    source: Source
    reference: Source
    offset_ns: int | None
    bound_ns: int
    n_votes: int
    since_ns: int | None
    is_corrected: bool
    last_row: int = field(compare=False)
    """Newest row of the store that is of this source: equal records come in other orders too."""


@dataclass(slots=True)
class GatewayClocks:
    """The sources of a site, and the clock that they are on; ``settle`` brings the answer up to date with what was noted."""

    sources: list[Source] = field(default_factory=list)
    _numbers: dict[Source, int] = field(default_factory=dict)
    _samples: list[SourceSample] = field(default_factory=list)
    _last_rows: list[int] = field(default_factory=list)
    _compared: dict[tuple[int, int], tuple[int, int, ClockDifference | None]] = field(default_factory=dict)
    _pairs: dict[int, tuple[int, IntArray]] = field(default_factory=dict)
    """Of each source: the version of its sample, and the pairs in it, ascending."""
    _differences: dict[int, ClockDifference] = field(default_factory=dict)
    """Of each source that is not a reference and shares enough, to its reference."""
    _references: dict[int, int] = field(default_factory=dict)

    def number(self, source: Source) -> int:
        """Return the number of a source, a new one for a new one: 0, 1, 2, ..."""
        known = self._numbers.get(source)
        if known is None:
            known = self._numbers[source] = len(self.sources)
            self.sources.append(source)
            self._samples.append(SourceSample())
            self._last_rows.append(0)
        return known

    @property
    def is_overfull(self) -> bool:
        """Say that so much was noted that it is time to `settle`, whether anybody asks for the answer or not."""
        return any(len(sample) > 4 * MAX_SAMPLE for sample in self._samples)

    @property
    def n_gateways(self) -> int:
        """Count the gateways that any record came from."""
        return len({source.gateway for source in self.sources})

    def note(self, rows: IntArray, *, sources: IntArray, pairs: IntArray) -> None:
        """Take note of rows that are new or have changed, with the numbers of their sources and pairs; all of shape (m,)."""
        for source in np.unique(sources).tolist():
            chosen = sources == source
            self._samples[source].add(rows[chosen], pairs[chosen])
            self._last_rows[source] = max(self._last_rows[source], int(rows[chosen].max()))

    def settle(self, read: Callable[[IntArray], SampledRows]) -> frozenset[int]:
        """Judge all clocks anew; return the numbers of the sources whose shift is another one now.

        Parameters
        ----------
        read
            Gives what is to be known of rows.
        """
        if self.n_gateways < 2 or not self._compare(read):
            return frozenset()
        before = {number: self.shift(number) for number in range(len(self.sources))}
        self._references, self._differences = _connect(
            self.sources, {pair: found for pair, (_, _, found) in self._compared.items() if found is not None}
        )
        return frozenset(number for number, shift in before.items() if not _has_same_knots(shift, self.shift(number)))

    def shift(self, number: int) -> ClockDifference | None:
        """Return what to add to a source's wall clock; None for nothing."""
        found = self._differences.get(number)
        return found if found is not None and _is_off(found) else None

    def report(self) -> tuple[SourceClock, ...]:
        """Say of every source how its clock stands, by gateway and anchor."""
        return tuple(self._describe(number) for _, number in sorted(self._numbers.items()))

    def _describe(self, number: int) -> SourceClock:
        found = self._differences.get(number)
        reference = self._references.get(number, number)
        return SourceClock(
            source=self.sources[number],
            reference=self.sources[reference],
            offset_ns=int(found.offset_ns[-1]) if found else 0 if number in self._references else None,
            bound_ns=found.bound_ns if found else 0,
            n_votes=found.n_votes if found else 0,
            since_ns=int(found.t_ns[0] + found.offset_ns[0]) if found else None,
            is_corrected=self.shift(number) is not None,
            last_row=self._last_rows[number],
        )

    def _compare(self, read: Callable[[IntArray], SampledRows]) -> bool:
        """Compare every two sources of different gateways of which one has changed; say whether there were any."""
        facts: dict[int, SampledRows] = {}

        def facts_of(number: int) -> SampledRows:
            if number not in facts:
                rows = self._samples[number].rows
                _, facts[number] = self._samples[number].thin(rows, read(rows), source=number)
            return facts[number]

        has_changed = False
        has_met = self._meet(facts_of)
        for one in range(len(self.sources)):
            for other in range(one):
                if self.sources[one].gateway == self.sources[other].gateway:
                    continue
                versions = self._samples[one].version, self._samples[other].version
                known = self._compared.get((one, other))
                if known is not None and known[:2] == versions:
                    continue
                if not has_met[one, other]:
                    self._compared[one, other] = (*versions, None)
                    has_changed = True
                    continue
                # The order of comparing is that of the names, so that equal records give equal knots, whichever came first.
                first, second = sorted((one, other), key=lambda number: self.sources[number])
                facts_of(first), facts_of(second)
                level = max(self._samples[first].level, self._samples[second].level)
                found = compare_clocks(make_sample(facts[first], level=level), make_sample(facts[second], level=level))
                found = found.reversed() if found is not None and first != one else found
                self._compared[one, other] = (*versions, found)
                has_changed = True
        return has_changed

    def _meet(self, facts_of: Callable[[int], SampledRows]) -> BoolArray:
        """Say of every two sources whether both told of any one pair of biobots, shape (sources, sources); else nothing can be compared."""
        for number, sample in enumerate(self._samples):
            known = self._pairs.get(number)
            if known is None or known[0] != sample.version:
                self._pairs[number] = sample.version, np.unique(facts_of(number).pair)
        pairs = [self._pairs[number][1] for number in range(len(self.sources))]
        pair, source = np.concatenate(pairs), np.repeat(np.arange(len(pairs)), [len(one) for one in pairs])
        order = np.argsort(pair, kind="stable")
        pair, source = pair[order], source[order]
        has_met = np.zeros((len(pairs), len(pairs)), dtype=np.bool_)
        for apart in range(1, len(pairs)):
            is_one = pair[apart:] == pair[:-apart]
            if not is_one.any():
                break
            has_met[source[apart:][is_one], source[:-apart][is_one]] = True  # the later source comes second: the sort is stable
        return has_met


def _is_off(found: ClockDifference) -> bool:
    return bool((np.abs(found.offset_ns) > found.bound_ns).any())


def _has_same_knots(one: ClockDifference | None, other: ClockDifference | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one.t_ns, other.t_ns) and np.array_equal(one.offset_ns, other.offset_ns)


def _connect(
    sources: Sequence[Source], differences: Mapping[tuple[int, int], ClockDifference]
) -> tuple[dict[int, int], dict[int, ClockDifference]]:
    """Choose the best ways between sources, and the reference of each connected part; return reference and difference by source.

    Ways with more votes are taken first, then those between lower names. A part's reference is the source that the clocks of most
    gateways agree with, its own among them; of several that of the gateway with the lowest name; of its starts the highest anchor: a
    machine that has lost its clock starts in the past.
    """
    ways: dict[int, list[tuple[int, ClockDifference]]] = {}
    roots = list(range(len(sources)))

    def root_of(number: int) -> int:
        while roots[number] != number:
            number = roots[number]
        return number

    def rank(item: tuple[tuple[int, int], ClockDifference]) -> tuple[int, list[Source]]:
        return -item[1].n_votes, sorted(sources[number] for number in item[0])

    for (one, other), found in sorted(differences.items(), key=rank):
        first, second = root_of(one), root_of(other)
        if first != second:
            roots[second] = first
            ways.setdefault(one, []).append((other, found))
            ways.setdefault(other, []).append((one, found.reversed()))
    parts: dict[int, list[int]] = {}
    for number in sorted(ways, key=sources.__getitem__):
        parts.setdefault(root_of(number), []).append(number)
    references: dict[int, int] = {}
    settled: dict[int, ClockDifference] = {}
    for members in parts.values():
        reference = _choose_reference(sources, members, ways)
        references |= dict.fromkeys(members, reference)
        settled |= _walk(reference, ways)
    return references, settled


def _choose_reference(sources: Sequence[Source], members: Sequence[int], ways: Mapping[int, list[tuple[int, ClockDifference]]]) -> int:
    ahead = {members[0]: 0} | {number: int(found.offset_ns[-1]) for number, found in _walk(members[0], ways).items()}

    def rank(number: int) -> tuple[int, str, int]:
        agreeing = {sources[other].gateway for other in members if abs(ahead[other] - ahead[number]) <= _AGREE_NS}
        return -len(agreeing), sources[number].gateway, -sources[number].anchor_ns

    return min(members, key=rank)


def _walk(start: int, ways: Mapping[int, list[tuple[int, ClockDifference]]]) -> dict[int, ClockDifference]:
    """Return the difference of every source that can be reached to ``start``'s clock."""
    found: dict[int, ClockDifference] = {}
    reached, waiting = {start}, [start]
    while waiting:
        place = waiting.pop()
        for further, difference in ways[place]:
            if further not in reached:
                reached.add(further)
                waiting.append(further)
                back = difference.reversed()
                found[further] = back if place == start else back.then(found[place])
    return found
