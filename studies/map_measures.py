"""What the benchmark of maps measured, how that compares, and what was wanted of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from mapper.types import FloatArray, IntArray, KernelsKind

Arrays = Mapping[str, FloatArray | IntArray]
"""What a measured process left in its file, by name."""

DISTANCE_STAGES = ("metric", "subsample")
"""The stages of a map that do what `studies.plain_paths` does with a search for each point."""

# Issue 4, "Must show": encounters to seconds, for the paper's method on a quiet machine.
_TOTAL_S = {10_000: 0.03, 100_000: 0.2, 1_000_000: 2.0}
_PEAK_BYTES = {1_000_000: 1.5e9}
_START_S = 2.0
_DIJKSTRA_RATIO = {100_000: 50.0, 1_000_000: 100.0}
_ALL_PAIRS_RATIO = {10_000: 200.0}
_LEAST_TO_FIT = 3
_REL, _ABS = 1e-9, 1e-9  # sums in another order may differ in the last places; the second is a share of the diameter


@dataclass(frozen=True, slots=True, kw_only=True)
class MapTiming:
    """Maps of one table by one case of `studies.map_timing`.

    Parameters
    ----------
    total_s, core_s
        Medians of whole maps, by the wall's clock and of all cores [s].
    stages_s
        Medians of stages by the wall's clock [s].
    distances_s, distances_core_s
        Medians of ``DISTANCE_STAGES`` together, by the wall's clock and of all cores [s].
    peak_bytes
        Of the process.
    points
        Of the subsample.
    """

    case: str
    kernels: KernelsKind
    encounters: int
    repeats: int
    total_s: float
    core_s: float
    stages_s: dict[str, float]
    distances_s: float
    distances_core_s: float
    peak_bytes: int
    points: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerTiming:
    """One plain way to ``points`` points, ``searched`` of them measured and the rest reckoned in proportion [s]."""

    way: str
    encounters: int
    wall_s: float
    core_s: float
    points: int
    searched: int
    peak_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """How many times as fast as another way, and in what the results differ (nothing, if all is well).

    Parameters
    ----------
    ours_s, theirs_s
        By the wall's clock [s].
    ours_core_s, theirs_core_s
        Of all cores [s].
    """

    name: str
    encounters: int
    ours_s: float
    theirs_s: float
    ours_core_s: float
    theirs_core_s: float
    note: str
    differences: tuple[str, ...]
    target: float | None = None

    @property
    def ratio(self) -> float:
        """Their time of cores over ours: what others do on the machine costs it little, and second threads gain nothing."""
        return self.theirs_core_s / self.ours_core_s

    @property
    def wall_ratio(self) -> float:
        """Their time over ours by the wall's clock."""
        return self.theirs_s / self.ours_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One wanted figure: told as text with its limit; ``is_ratio`` marks those that hold on any machine."""

    name: str
    got: str
    wanted: str
    is_met: bool
    is_ratio: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """All that was measured in one run.

    ``machine`` says where and when, in words. ``start_s`` and ``start_core_s`` are seconds from the start of a process to the end
    of its first map, by the wall's clock and of all cores.
    ``load`` is the machine's load average over a minute before and after. ``left_out`` says what would have taken too long.
    """

    machine: dict[str, str]
    seed: int
    load: tuple[float, float]
    start_s: tuple[float, ...]
    start_core_s: tuple[float, ...]
    start_encounters: int
    maps: tuple[MapTiming, ...]
    peers: tuple[PeerTiming, ...]
    comparisons: tuple[Comparison, ...]
    left_out: tuple[str, ...]


def affordable_repeats(before: MapTiming, encounters: int, *, wanted: int, patience_s: float) -> int:
    """Say how many maps of a larger table, 0 to ``wanted``, take no longer than ``patience_s`` if their cost grows as N^2 at worst."""
    expected_s = before.total_s * (encounters / before.encounters) ** 2
    return 0 if expected_s > patience_s else max(1, int(min(wanted, patience_s / expected_s)))


def sum_distances(seconds: Mapping[str, float]) -> float:
    """Add the seconds of ``DISTANCE_STAGES``."""
    return sum(seconds.get(stage, 0.0) for stage in DISTANCE_STAGES)


def compare_with_dijkstra(paper: MapTiming, peer: PeerTiming, *, differences: tuple[str, ...]) -> Comparison:
    """Compare the distances of the subsample with a search per point."""
    note = f"{peer.points} searches" if peer.searched == peer.points else f"{peer.searched} of {peer.points} searches measured"
    return Comparison(
        name="paper, landmarks to distances, over scipy's Dijkstra per point",
        encounters=peer.encounters,
        ours_s=paper.distances_s,
        theirs_s=peer.wall_s,
        ours_core_s=paper.distances_core_s,
        theirs_core_s=peer.core_s,
        note=note,
        differences=differences,
        target=_DIJKSTRA_RATIO.get(peer.encounters),
    )


def compare_with_all_pairs(paper: MapTiming, peer: PeerTiming, *, differences: tuple[str, ...]) -> Comparison:
    """Compare a whole map with the literal way from encounters to the distances of the subsample, which is only a part of it."""
    return Comparison(
        name="paper, whole map, over the literal N x N way to its distances",
        encounters=peer.encounters,
        ours_s=paper.total_s,
        theirs_s=peer.wall_s,
        ours_core_s=paper.core_s,
        theirs_core_s=peer.core_s,
        note=f"{peer.peak_bytes / 1e9:.2f} GB",
        differences=differences,
        target=_ALL_PAIRS_RATIO.get(peer.encounters),
    )


def compare_with_plain(compiled: MapTiming, plain: MapTiming, *, differences: tuple[str, ...]) -> Comparison:
    """Compare whole maps by the compiled and by the plain kernels."""
    return Comparison(
        name=f"{compiled.case}, whole map, over the mapper's plain path",
        encounters=plain.encounters,
        ours_s=compiled.total_s,
        theirs_s=plain.total_s,
        ours_core_s=compiled.core_s,
        theirs_core_s=plain.core_s,
        note=f"{plain.peak_bytes / 1e9:.2f} GB",
        differences=differences,
    )


def find_differences(ours: Arrays, theirs: Arrays) -> tuple[str, ...]:
    """Say in what two results differ, of all that both hold.

    Notes
    -----
    Points must be the same, one by one; where there are fewer of theirs, the first ones. Distances and all that follows from them
    may differ by 1e-9 of the diameter. Coordinates are those of one map, so nothing is turned or mirrored.
    """
    m = len(theirs["encounter"])
    if len(ours["encounter"]) < m:
        return (f"{len(ours['encounter'])} points, not {m}",)
    scale = float(ours["distances"].max())
    found = []
    for name in sorted(ours.keys() & theirs.keys()):
        one, other = ours[name], theirs[name]
        if name == "encounter":
            one = one[:m]
        elif name == "distances":
            one = one[:m, :m]
        if one.shape != other.shape:
            found.append(f"{name}: shape {one.shape}, not {other.shape}")
        elif not np.allclose(one, other, rtol=0.0 if one.dtype.kind == "i" else _REL, atol=0.0 if one.dtype.kind == "i" else _ABS * scale):
            found.append(f"{name}: {int((one != other).sum())} of {one.size} values")
    return tuple(found)


def fit_exponent(sizes: Sequence[int], seconds: Sequence[float]) -> float:
    """Fit the exponent of a power law: the slope of logarithms by least squares."""
    return float(np.polyfit([log(size) for size in sizes], [log(value) for value in seconds], 1)[0])


def exponents(bench: Bench) -> dict[str, tuple[float, float]]:
    """Fit each case of compiled kernels: exponent of its cores' time, and that of N log N over the same sizes; too few sizes give none."""
    found = {}
    for case in dict.fromkeys(timing.case for timing in bench.maps):
        own = [timing for timing in bench.maps if timing.case == case and timing.kernels is KernelsKind.COMPILED]
        sizes = [timing.encounters for timing in own]
        if len(own) < _LEAST_TO_FIT:
            continue
        found[case] = (fit_exponent(sizes, [timing.core_s for timing in own]), fit_exponent(sizes, [size * log(size) for size in sizes]))
    return found


def judge(bench: Bench) -> tuple[Verdict, ...]:
    """Hold what was measured against what is wanted, as far as it was measured."""
    verdicts = []
    for timing in bench.maps:
        if timing.case != "paper" or timing.kernels is not KernelsKind.COMPILED:
            continue
        if (limit_s := _TOTAL_S.get(timing.encounters)) is not None:
            name = f"map of {timing.encounters:,} encounters (of cores {timing.core_s:.3g} s)"
            verdicts.append(_at_most(name, timing.total_s, limit_s, text=lambda value: f"{value:.3g} s"))
        if (limit := _PEAK_BYTES.get(timing.encounters)) is not None:
            name = f"memory at {timing.encounters:,} encounters"
            verdicts.append(_at_most(name, timing.peak_bytes, limit, text=lambda value: f"{value / 1e9:.2f} GB"))
    verdicts += [
        Verdict(
            name=f"{one.name}, {one.encounters:,} encounters",
            got=f"{one.ratio:,.0f} x",
            wanted=f"at least {one.target:g} x",
            is_met=one.ratio >= one.target,
            is_ratio=True,
        )
        for one in bench.comparisons
        if one.target is not None
    ]
    start_s = float(np.median(bench.start_s))
    verdicts.append(_at_most(f"start to first map ({bench.start_encounters:,} encounters)", start_s, _START_S, text=lambda s: f"{s:.2f} s"))
    for case, (exponent, reference) in exponents(bench).items():
        verdicts.append(
            _at_most(
                f"exponent of cores' time over all sizes, by least squares (N log N), {case}",
                exponent,
                reference,
                text=lambda value: f"{value:.2f}",
            )
        )
    return tuple(verdicts)


def _at_most(name: str, got: float, limit: float, *, text: Callable[[float], str]) -> Verdict:
    return Verdict(name=name, got=text(got), wanted=f"at most {text(limit)}", is_met=got <= limit, is_ratio=False)
