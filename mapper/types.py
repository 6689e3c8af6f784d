"""What the stages of the mapper hand to each other: encounters, mode spells, the recipe, and the finished map.

Every class is frozen; arrays in them are read-only. Kernels count time in *ticks* of half a nanosecond, because the centre
``(t_start + t_end) / 2`` of an encounter is then a whole number; finished results are in seconds, or in metres where a speed is given.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ArrayT = TypeVar("ArrayT", IntArray, FloatArray, BoolArray)

TICKS_PER_S = 2_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncounterTable:
    """Encounters in canonical order: by start, end, then ids.

    All arrays have shape (n,). ``t_start_ns <= t_end_ns`` [ns, any one clock] and ``id1 < id2`` hold in every row;
    ``source_row`` is the place of the row in the data it was made from, counted from 0. Build one with
    ``mapper.window.make_encounter_table``.
    """

    t_start_ns: IntArray
    t_end_ns: IntArray
    id1: IntArray
    id2: IntArray
    source_row: IntArray

    def __len__(self) -> int:
        return len(self.t_start_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeSpell:
    """A time in which one biobot kept one mode; ``t_end_ns`` is None while it lasts. Both ends belong to it."""

    node: NodeId
    t_start_ns: int
    t_end_ns: int | None
    mode: Mode
    cause: Cause


class Method(StrEnum):
    """A whole recipe: the project's best, or [Dir16] to the letter."""

    DEFAULT = "default"
    PAPER = "paper"


class MetricKind(StrEnum):
    """How two encounters are compared."""

    ENCOUNTER = "encounter"
    LANDMARK_PROFILE = "landmark_profile"


class ProfileNorm(StrEnum):
    """How the differences of two landmark profiles become one number: the largest, or the root mean square."""

    MAX = "max"
    RMS = "rms"


class KernelsKind(StrEnum):
    """Which implementation of the kernels runs; "auto" takes the compiled ones where they are."""

    AUTO = "auto"
    COMPILED = "compiled"
    PLAIN = "plain"


class BettiRuleKind(StrEnum):
    """How an interval is judged.

    Against a quantile of all lengths (eq. 15 of [Dir16]); by death over birth; or, in dimension 0, not at all: biobots walked
    between all parts of a connected encounter graph, so those parts are one component, however far apart.
    """

    QUANTILE = "quantile"
    RATIO = "ratio"
    CONNECTED = "connected"


@dataclass(frozen=True, slots=True, kw_only=True)
class BettiRule:
    """Which intervals of one dimension are real; lengths are shares of the metric's diameter.

    ``QUANTILE``: ``length / (r_q + delta) > tau * (1000 / n)**power`` for n encounters that are no outliers. ``RATIO``:
    ``death / birth > tau`` and ``length > delta``; ``q`` is not used.
    ``CONNECTED``: no finite interval is real; no number is used.
    """

    kind: BettiRuleKind
    q: float
    delta: float
    tau: float
    power: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """The parameters of the method; ``mapper.config.make_recipe`` builds the two named ones.

    ``bracketed`` profiles are the middle of their bounds, and badly bounded encounters count as outliers; otherwise ``outlier_k`` finds
    those far from their neighbours. ``outlier_q`` 1 keeps every encounter. Bracketed profiles are averaged over ``smoothing_share`` of the
    vertices around each, ``smoothing_passes`` times. ``placed``: they are placed in the plane along the tracks of biobots first, if there
    are landmarks enough and the norm is the largest, and what is averaged then is what stands behind a point beyond
    ``encounters_per_point``. Where profiles are compared, no more than ``max_candidates`` of the vertices that are no outliers are
    smoothed and may become points, taken evenly in the order of time; 0 sets no limit. The subsample has ``n_points``, or fewer where
    ``encounters_per_point`` encounters do not stand behind each; 0 asks for none. ``betti_rules`` are for dimensions 0 and 1; None takes
    those trained for this method and metric. ``epsilon_share`` is the scale of the drawn complex as a share of the diameter; None lets
    the holes found decide. ``speed_mps`` None gives lengths in seconds. So many ``replicates``, each of a part of the time, are mapped
    too, to say how sure the map is; 0 says nothing of that.
    """

    method: Method
    metric: MetricKind
    profile_norm: ProfileNorm
    moving_time: bool
    bracketed: bool
    placed: bool
    smoothing_share: float
    max_candidates: int
    outlier_k: int
    outlier_q: float
    n_points: int
    encounters_per_point: int
    n_anchors: int
    betti_rules: tuple[BettiRule, BettiRule] | None
    epsilon_share: float | None
    speed_mps: float | None
    smoothing_passes: int = 1
    replicates: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """The encounters of the subsample, placed in the plane.

    All arrays have shape (p,). ``x`` and ``y`` are map coordinates [unit of lengths]; ``t_ns`` is the centre of the encounter [ns, rounded
    down]; ``component`` says which of ``MapResult.components`` it is in, and the points of one component stand together;
    ``encounter`` is the row in the encounter table. ``is_well_seen``: its distances are most likely right (docs/confidence.md); None where
    nobody knows.
    """

    x: FloatArray
    y: FloatArray
    t_ns: IntArray
    id1: IntArray
    id2: IntArray
    component: IntArray
    encounter: IntArray
    is_well_seen: BoolArray | None = None

    def __len__(self) -> int:
        return len(self.x)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What a component says of its scale.

    ``straightness``: sum of squared lengths of links in the plane over that of their squared times, of the longer half of the links.
    ``n_encounters``: of one view of the swarm. ``disc_share``: time spent at landmarks over the time walked.
    """

    straightness: float
    n_encounters: float
    disc_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """By what a component's lengths were multiplied, so that they are distances and not walks.

    ``error`` is the relative error of ``factor``, which follows from ``evidence``: two thirds of simulated runs were nearer.
    """

    factor: float
    error: float
    evidence: Evidence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LandmarkPlaces:
    """The l places of a component where landmarks stood, by which it can be joined to other maps.

    ``node``, ``t_start_ns`` and ``t_end_ns``, shape (l,): who stood there, and from when to when [ns, the clock of the encounters], as far
    as the record goes. ``to_points``, shape (l, n_points), and ``between``, shape (l, l): distances [unit of the map]. ``n_seen``: how
    many of the encounters used one view of the swarm saw (`mapper.views`).
    """

    node: IntArray
    t_start_ns: IntArray
    t_end_ns: IntArray
    to_points: FloatArray
    between: FloatArray
    n_seen: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComponentMap:
    """One connected component of the encounter graph, mapped. Lengths are in the unit of the map.

    ``intervals[k]`` has shape (m, 2): birth and death in dimension k, longest first; a death that never comes is inf.
    ``n_used`` encounters were left after the outliers were dropped. ``cover_radius``: none of those that could have become points is
    further than this from a point of the subsample. ``epsilon`` is the scale at which the complex is drawn. ``n_landmarks`` counts places
    where a landmark stood.
    ``distances`` between the points, shape (n_points, n_points), in the order of ``MapResult.points``. ``reach``: how far the swarm saw at
    one time, which is the diameter where it did not move on; None in maps of earlier versions. ``scale``: None where lengths are times
    walked, times the speed. The loops of the true diagram are within ``stability_band`` of ``intervals[1]`` (bottleneck distance) in 95 of
    100 maps; None where nobody knows. ``places`` is None in maps that were stored, and in joined ones.
    """

    n_encounters: int
    n_used: int
    n_points: int
    n_landmarks: int
    diameter: float
    cover_radius: float
    epsilon: float
    lost_spectrum: float
    distances: FloatArray
    intervals: tuple[FloatArray, FloatArray]
    betti_numbers: tuple[int, int]
    reach: float | None = None
    scale: Scale | None = None
    stability_band: float | None = None
    places: LandmarkPlaces | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hole:
    """A hole called real, or one that may be there.

    ``outline`` has the indices of its points in ``MapResult.points``, in order, not closed; shape (m,). ``outline_xy`` is the polygon of
    what stands in it, as `mapper.hole_shapes` draws it: shape (k, 2), not closed, counter-clockwise; (0, 2) where there is none.
    ``centre``, shape (2,), is inside it. ``area`` [unit^2] and ``perimeter`` [unit] are those of the obstacle, with their standard errors;
    None where nothing is known of them. ``probability``: that it goes around an obstacle one can walk around, and no longer interval goes
    around the same; None where nobody knows.
    """

    component: int
    birth: float
    death: float
    outline: IntArray
    outline_xy: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    centre: FloatArray | None = None
    area: float | None = None
    area_error: float | None = None
    perimeter: float | None = None
    perimeter_error: float | None = None
    probability: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HoleCount:
    """How many holes the map shows, how likely that is right, and how likely there are 0, 1, 2, ... in truth.

    ``is_known`` is False where the encounters tell nothing of it: then the probabilities are those of the runs of training.
    """

    value: int
    probability: float
    probabilities: tuple[float, ...]
    is_known: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class DataVerdict:
    """Whether the encounters are enough for what the map says; if not, why, and what would help."""

    is_enough: bool
    reasons: tuple[str, ...]
    remedies: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Landmark:
    """Where a biobot stood by command from ``t_start_ns`` to ``t_end_ns`` (None: it still does), in map coordinates [unit of the map]."""

    node: NodeId
    t_start_ns: int
    t_end_ns: int | None
    x: float
    y: float
    component: int


class StandingSource(StrEnum):
    """Who said which nodes stand still: a person, their modes, the name of their column, the encounters; or nobody."""

    GIVEN = "given"
    MODES = "modes"
    COLUMN = "column"
    FOUND = "found"
    NONE = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """The nodes taken to stand still all the time, ascending, and why; those of ``MODES`` stand in their spells and are not listed."""

    nodes: tuple[int, ...]
    source: StandingSource
    reason: str


GAP_SHARE = 0.1
"""Of the largest diameter: between components drawn side by side."""

KNOWN_PLACES = "known_places"
"""Name of the assumption that places are known, which pins make true."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumption:
    """Something that a map rests on: whether it holds, None where that cannot be seen, and what follows, for a person."""

    name: str
    holds: bool | None
    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapResult:
    """A finished map.

    ``components`` are those that were mapped, the largest first; ``n_components`` counts all there are. ``edges`` (e, 2) and ``triangles``
    (t, 3) are indices of points: the Rips complex of each component at its ``epsilon``. ``diameter`` is the largest of
    any component, and so is ``lost_spectrum``. ``length_unit`` is "s" or "m". ``node_names`` are what the log calls its nodes, empty where
    they are numbers. ``standing`` and ``assumptions`` are of maps of a file. ``landmarks`` are places where somebody stood by command and
    met somebody. ``others`` are encounters that were asked for and are no points of the map. ``possible_holes`` are loops that are not
    called real and may be holes all the same, the likeliest first. ``hole_count`` and ``data`` are None where nobody knows how sure the map
    is.
    """

    betti_numbers: tuple[int, int]
    points: Points
    components: tuple[ComponentMap, ...]
    holes: tuple[Hole, ...]
    edges: IntArray
    triangles: IntArray
    diameter: float
    lost_spectrum: float
    n_encounters: int
    n_used: int
    n_components: int
    length_unit: str
    recipe: Recipe
    warnings: tuple[str, ...]
    node_names: Mapping[int, str] = field(default_factory=dict)
    standing: Standing | None = None
    assumptions: tuple[Assumption, ...] = ()
    landmarks: tuple[Landmark, ...] = ()
    others: Points | None = None
    hole_count: HoleCount | None = None
    possible_holes: tuple[Hole, ...] = ()
    data: DataVerdict | None = None


def read_only(array: ArrayT) -> ArrayT:
    """Forbid writing to an array, and return it."""
    array.setflags(write=False)
    return array
