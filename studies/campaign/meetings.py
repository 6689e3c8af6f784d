"""Which biobots meet, when and for how long: a schedule that is a pure function of the seed. No I/O, no clock.

Pairs come in the order of a round-robin tournament (the circle method), so every pair meets once before any meets again. Two
meetings of a pair are kept so far apart, and the two sides of a meeting overlap by so much, that no error of a fitted clock leaves a
doubt about what is one encounter.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from firmware_protocol.units import NodeId, RssiDbm
from simulator import chance

_KIND, _START, _LENGTH, _SIDE, _RSSI, _GAP = range(700, 706)
_RECURRENCE_S = 70.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How long meetings last [s], each drawn evenly between two limits.

    Parameters
    ----------
    usual_s, brief_s, long_s
        Meetings that both sides report; those that one side reports, and that may be shorter; those that are reported while they go on.
    gap_s
        Pause of a pair that meets twice in a row.
    provisional_s
        A meeting that lasts longer is reported while it goes on.
    """

    usual_s: tuple[float, float] = (4.0, 14.0)
    brief_s: tuple[float, float] = (0.05, 5.0)
    long_s: tuple[float, float] = (17.0, 36.0)
    gap_s: tuple[float, float] = (8.0, 12.0)
    provisional_s: float = 8.0

    @property
    def longest_s(self) -> float:
        """How long after its beginning the last meeting may still go on [s]."""
        return max(self.long_s[1], 2 * self.usual_s[1] + self.gap_s[1]) + 1.0


QUICK_PACE = Pace(usual_s=(3.0, 4.0), brief_s=(0.05, 3.0), long_s=(5.0, 6.0), gap_s=(5.0, 5.5), provisional_s=2.0)
"""For a run of some seconds: it need not outlast long outages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeetingSide:
    """What one biobot is to sense of a meeting; times are seconds of the run."""

    node: NodeId
    peer: NodeId
    start_s: float
    end_s: float
    rssi_dbm: RssiDbm
    is_first: bool
    """True for one side of each meeting: those sides count the meetings."""


def count_biobots(rate: float) -> int:
    """Return how many biobots it takes, so that at ``rate`` meetings/s no pair meets again within `_RECURRENCE_S`; an even number."""
    n = 2
    while n * (n - 1) / 2 < rate * _RECURRENCE_S:
        n += 2
    return n


@dataclass(frozen=True, slots=True, kw_only=True)
class Meetings:
    """The schedule. Biobots are numbered from 1 to ``n_biobots``, an even number; ``rate`` meetings begin each second."""

    seed: int
    n_biobots: int
    rate: float
    pace: Pace

    def due(self, first: int, *, until_s: float) -> Iterator[tuple[int, tuple[MeetingSide, ...]]]:
        """Yield the meetings from number ``first`` on that begin before ``until_s``, with the number that follows each."""
        number = first
        while number / self.rate < until_s:
            yield number + 1, self.sides(number)
            number += 1

    def sides(self, number: int) -> tuple[MeetingSide, ...]:
        """Return all that is sensed of meeting ``number``; of a pair that meets twice in a row, of both."""
        pair, pace = self._pair(number), self.pace
        begin_s = number / self.rate
        kind = self._draw(_KIND, number, 0)
        if kind < 0.60:
            return self._meet(number, pair, begin_s=begin_s, lasts_s=self._between(pace.usual_s, number), n_sides=2)
        if kind < 0.75:
            return self._meet(number, pair, begin_s=begin_s, lasts_s=self._between(pace.brief_s, number), n_sides=1)
        if kind < 0.90:
            n_sides = 1 if kind < 0.80 else 2
            return self._meet(number, pair, begin_s=begin_s, lasts_s=self._between(pace.long_s, number), n_sides=n_sides)
        lasts_s = self._between(pace.usual_s, number)
        again_s = begin_s + lasts_s + pace.gap_s[0] + (pace.gap_s[1] - pace.gap_s[0]) * self._draw(_GAP, number, 0)
        return (
            *self._meet(number, pair, begin_s=begin_s, lasts_s=lasts_s, n_sides=2),
            *self._meet(number, pair, begin_s=again_s, lasts_s=pace.usual_s[0], n_sides=2, turn=1),
        )

    def _meet(
        self, number: int, pair: tuple[NodeId, NodeId], *, begin_s: float, lasts_s: float, n_sides: int, turn: int = 0
    ) -> tuple[MeetingSide, ...]:
        """Let both sides sense a meeting a little differently, as radios do: each begins up to 0.3 s late and ends up to 0.3 s early."""
        offset = self._draw(_SIDE, number, turn) < 0.5
        sides = []
        for at in range(n_sides):
            node, peer = pair[at ^ offset], pair[1 ^ at ^ offset]
            slack_s = min(0.3, lasts_s / 4)
            late_s, early_s = (slack_s * self._draw(_START + 10 * turn, number, 2 * at + end) for end in (0, 1))
            rssi_dbm = RssiDbm(-90 + int(50 * self._draw(_RSSI, number, 2 * turn + at)))
            sides.append(
                MeetingSide(
                    node=node, peer=peer, start_s=begin_s + late_s, end_s=begin_s + lasts_s - early_s, rssi_dbm=rssi_dbm, is_first=at == 0
                )
            )
        return tuple(sides)

    def _pair(self, number: int) -> tuple[NodeId, NodeId]:
        n = self.n_biobots
        turn, place = number // (n // 2) % (n - 1), number % (n // 2)
        one = turn if place == 0 else (turn + place) % (n - 1)
        other = n - 1 if place == 0 else (turn - place) % (n - 1)
        return NodeId(1 + one), NodeId(1 + other)

    def _between(self, limits: tuple[float, float], number: int) -> float:
        return limits[0] + (limits[1] - limits[0]) * self._draw(_LENGTH, number, 0)

    def _draw(self, stream: int, number: int, index: int) -> float:
        return chance.uniform(seed=self.seed, biobot=number, stream=stream, index=index)
