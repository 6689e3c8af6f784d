"""What can be seen of a component, of its loops and of its points that tells how far they can be trusted: numbers without a unit.

Nothing here looks at coordinates, names or clocks: scaling all times, renaming the biobots or shifting time 0 changes no number.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mapper.bottleneck import bottleneck_distance
from mapper.types import ComponentMap, FloatArray

N_LOOPS: Final = 10
"""So many of the longest loops of a component are judged, and all that are called real: what is shorter was never a hole in training."""

# Of the reach: keeps logarithms finite. About the length of the shortest loops that maps of training runs show.
_TINY = 0.005
_NOISE_QUANTILE = 0.7
_COMPARED = 40  # loops of a diagram: shorter ones decide nothing
_LEAST_SHARED = 3  # landmarks: distances to fewer fix no place

LOOP_FEATURES: Final = (
    "death over birth",
    "length",
    "length over noise",
    "birth",
    "birth over spacing",
    "death over spacing",
    "length over next",
    "longest over length",
    "rank",
    "called real",
    "length in replicas",
    "length at its place in replicas",
    "replicas that call as many",
    "length of its rank in replicas",
    "least length in replicas",
    "least length at its place in replicas",
)
RUN_FEATURES: Final = (
    "encounters a biobot",
    "landmarks",
    "encounters",
    "points",
    "spacing",
    "lost spectrum",
    "loops",
    "encounter's length",
    "doubt",
    "left out",
    "change in replicas",
)
POINT_FEATURES: Final = ("doubt here", "distance to all", "distance to nearest")


def reach_of(part: ComponentMap) -> float:
    """Return what lengths are measured by: how far the swarm saw at one time [unit of lengths]; 1 for a map of one place."""
    return part.reach or part.diameter or 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """What the encounters of one component are, beside its map.

    ``n_biobots`` are in them, of which ``n_walkers`` do not stand by command all the time; ``median_duration`` of an encounter is in the
    map's unit of length; ``left_out`` is the share of all encounters that lie in no mapped component.
    """

    n_biobots: int
    n_walkers: int
    median_duration: float
    left_out: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """The map of a component, or of a part of its time, and where its longest loops are.

    ``centres`` [unit of lengths], shape (k, l), says how far the middle of each of the k longest loops is from l landmarks, in the order of
    the intervals; ``landmarks`` are the ids of those, 0 of them where places cannot be compared.
    """

    part: ComponentMap
    centres: FloatArray
    landmarks: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """One component's map, the maps of parts of its time (None where a part has no map), how doubtful each point is, and its encounters.

    ``change``: bottleneck distance from the loops of the map to those of a replica, each over its reach, on average. ``doubt`` [unit of
    lengths], shape (n_points,): half the gap between the bounds of a point's distances; 0 where there are no bounds.
    """

    sighting: Sighting
    replicas: tuple[Sighting | None, ...]
    change: float
    doubt: FloatArray
    track: Track

    @property
    def part(self) -> ComponentMap:
        """The component's map."""
        return self.sighting.part

    @property
    def n_judged(self) -> int:
        """How many of the longest loops are judged."""
        return min(len(self.part.intervals[1]), max(N_LOOPS, self.part.betti_numbers[1]))

    def loop_columns(self) -> dict[str, FloatArray]:
        """Describe the longest loops and the run beside each, shape (n_judged,) each."""
        run = {name: np.full(self.n_judged, value) for name, value in zip(RUN_FEATURES, self.describe_run().tolist(), strict=True)}
        return run | dict(zip(LOOP_FEATURES, self.describe_loops().T, strict=True))

    def run_columns(self) -> dict[str, FloatArray]:
        """Describe the component as a whole, shape () each."""
        return {name: np.asarray(value) for name, value in zip(RUN_FEATURES, self.describe_run().tolist(), strict=True)}

    def point_columns(self) -> dict[str, FloatArray]:
        """Describe the points and the run beside each, shape (n_points,) each."""
        run = {name: np.full(self.part.n_points, value) for name, value in zip(RUN_FEATURES, self.describe_run().tolist(), strict=True)}
        return run | dict(zip(POINT_FEATURES, self.describe_points().T, strict=True))

    def describe_loops(self) -> FloatArray:
        """Describe the longest loops, shape (n_judged, LOOP_FEATURES)."""
        part, n = self.part, self.n_judged
        if n == 0:
            return np.zeros((0, len(LOOP_FEATURES)))
        reach = reach_of(part)
        births, deaths = part.intervals[1].T / reach
        lengths, spacing = deaths - births, part.cover_radius / reach + _TINY
        following = np.append(lengths, 0.0)[1 : n + 1]
        own, rank = slice(n), np.arange(n)
        columns = [
            np.log((deaths[own] + _TINY) / (births[own] + _TINY)),
            np.log(lengths[own] + _TINY),
            np.log((lengths[own] + _TINY) / (_noise(lengths) + _TINY)),
            np.log(births[own] + _TINY),
            np.log((births[own] + _TINY) / spacing),
            np.log(deaths[own] / spacing),
            np.log((lengths[own] + _TINY) / (following + _TINY)),
            np.log((lengths[0] + _TINY) / (lengths[own] + _TINY)),
            np.log1p(rank),
            (rank < part.betti_numbers[1]).astype(float),
        ]
        return np.column_stack([*columns, self._find_again(n)])

    def describe_run(self) -> FloatArray:
        """Describe the component as a whole, shape (RUN_FEATURES,)."""
        part, track, reach = self.part, self.track, reach_of(self.part)
        return np.array(
            [
                np.log(part.n_encounters / track.n_biobots),
                np.log1p(part.n_landmarks),
                np.log(part.n_encounters),
                np.log(part.n_points),
                np.log(part.cover_radius / reach + _TINY),
                part.lost_spectrum,
                np.log1p(len(part.intervals[1])),
                np.log(track.median_duration / reach + _TINY),
                np.log(float(np.median(self.doubt)) / reach + _TINY),
                track.left_out,
                np.log(self.change + _TINY),
            ]
        )

    def describe_points(self) -> FloatArray:
        """Describe the points, shape (n_points, POINT_FEATURES)."""
        part, reach = self.part, reach_of(self.part)
        shares = part.distances / reach
        nearest = np.sort(shares, axis=1)[:, 1:6]
        return np.column_stack(
            [
                np.log(self.doubt / reach + _TINY),
                shares.mean(axis=1),
                np.log((nearest.mean(axis=1) if nearest.size else np.zeros(len(shares))) + _TINY),
            ]
        )

    def _find_again(self, n: int) -> FloatArray:
        """Say how the n longest loops fare in the replicas, shape (n, 6): with no replica as in one without loops."""
        reach = reach_of(self.part)
        lengths = np.diff(self.part.intervals[1], axis=1)[:n, 0] / reach
        found, near, called, ranked = [], [], [], []
        for one in self.replicas:
            loops = np.zeros((0, 2)) if one is None else one.part.intervals[1] / (reach_of(one.part))
            partners = match_loops(self.part.intervals[1][:n] / reach, loops)
            found.append(np.log((partners + _TINY) / (lengths + _TINY)))
            longest_near = np.zeros(n) if one is None else find_near(self.sighting, one, n=n)
            near.append(np.log((longest_near + _TINY) / (lengths + _TINY)))
            called.append((np.arange(n) < (0 if one is None else one.part.betti_numbers[1])).astype(float))
            others = np.diff(loops, axis=1)[:, 0]
            same_rank = np.zeros(n)
            same_rank[: len(others)] = others[:n]
            ranked.append(np.log((same_rank + _TINY) / (_noise(others) + _TINY)))
        means = [np.mean(values, axis=0) for values in (found, near, called, ranked)]
        return np.column_stack([*means, np.min(found, axis=0), np.min(near, axis=0)])


def find_near(sighting: Sighting, other: Sighting, *, n: int) -> FloatArray:
    """Look for each of the n longest loops where another map has loops, and say how long the longest there is.

    Returns
    -------
    FloatArray
        Shape (n,), as a share of the other map's reach: of every loop its length, times ``exp(-2 (x / r)^2)`` for one whose middle is x
        from this one's; the greatest. r is half of the death of the loop looked for; x is the root mean square difference of their
        distances to the landmarks that both maps have. 0 with fewer than three such.
    """
    shared = sorted(set(sighting.landmarks) & set(other.landmarks))
    if len(shared) < _LEAST_SHARED or not len(other.centres):
        return np.zeros(n)
    own_reach, other_reach = reach_of(sighting.part), reach_of(other.part)
    here = sighting.centres[:n][:, [sighting.landmarks.index(one) for one in shared]] / own_reach
    there = other.centres[:, [other.landmarks.index(one) for one in shared]] / other_reach
    gaps = np.sqrt(((here[:, None] - there[None]) ** 2).mean(axis=2))
    radii = sighting.part.intervals[1][:n, 1] / (2.0 * own_reach)
    lengths = np.diff(other.part.intervals[1], axis=1)[: len(there), 0] / other_reach
    return np.asarray((lengths * np.exp(-2.0 * (gaps / radii[:, None]) ** 2)).max(axis=1))


def mean_change(part: ComponentMap, replicas: Sequence[Sighting | None]) -> float:
    """Average the bottleneck distances from the longest loops of a map to those of its replicas, over the reach; half without any."""
    own = part.intervals[1][:_COMPARED] / reach_of(part)
    changes = [bottleneck_distance(own, one.part.intervals[1][:_COMPARED] / reach_of(one.part)) for one in replicas if one is not None]
    return float(np.mean(changes)) if changes else 0.5


def match_loops(loops: FloatArray, others: FloatArray) -> FloatArray:
    """Find the loops of one diagram in another, and say how long each is there.

    Parameters
    ----------
    loops, others
        Births and deaths, shapes (n, 2) and (m, 2), in one unit of length.

    Returns
    -------
    FloatArray
        Shape (n,): the length of each loop's partner, 0 for a loop without.

    Notes
    -----
    Pairs are chosen so that the sum of all moves is least: of two partners the larger change of birth or death, of a loop without one half
    its length. It is the matching of the 1-Wasserstein distance of diagrams, over the largest norm.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  # a quarter of a second that a map without replicas does without

    n, m = len(loops), len(others)
    moves = np.zeros((n + m, n + m))
    moves[:n, :m] = np.abs(loops[:, None] - others[None]).max(axis=2)
    moves[:n, m:] = np.diff(loops, axis=1) / 2.0
    moves[n:, :m] = np.diff(others, axis=1).T / 2.0
    rows, columns = linear_sum_assignment(moves)
    partner = columns[np.argsort(rows)][:n]
    found = np.zeros(n)
    is_paired = partner < m
    found[is_paired] = np.diff(others, axis=1)[partner[is_paired], 0]
    return found


def _noise(lengths: FloatArray) -> float:
    """Take the length that most loops stay below, shape (m,), as that of noise; 0 without loops."""
    return float(np.quantile(lengths, _NOISE_QUANTILE, method="lower")) if len(lengths) else 0.0
