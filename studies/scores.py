"""Scores of a map of a simulated run: how near its shape, its distances and its picture come to the truth.

``python -m studies.scores RUN_DIR MAP.json`` prints them. What each score means is written in ``Scores``.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from mapper.bottleneck import bottleneck_distance
from mapper.embedding import embed_in_plane
from mapper.errors import MapError
from mapper.types import MapResult
from simulator.errors import SimulationError
from studies.comparison import fit_similarity
from studies.errors import MapFileError, StudyError
from studies.located_map import LocatedMap, find_map
from studies.truth import Floats, Indices, Intervals, RunTruth, diagram_of, load_run, obstacle_points, true_distances


@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """How a map compares with the truth of its run. Lengths are in ``unit``, that of the run: time times the biobots' speed.

    Parameters
    ----------
    n_points, n_components
        Size of the subsample that all figures are of, and how many components it was mapped in.
    time_error_s
        Largest difference between a point's time and its encounter's true centre [s].
    betti_numbers, true_betti_numbers
        Components and holes: of the map, and of the arena.
    true_diameter
        Largest geodesic distance between two points of the subsample.
    bottleneck
        Bottleneck distance between the finite intervals of the map and of exact geodesics, in dimensions 0 and 1.
    snr
        Mean squared length of the signal intervals of dimension 1 over that of the others ([Dir16] VI). Signal are as many of the longest
        as there are true holes. None without a hole, or with nothing else.
    n_obstacles, n_obstacles_found
        Obstacles one can walk around, and how many of them some hole of the map goes around, each hole being counted for one.
    n_holes_false
        Holes of the map that count for no obstacle.
    metric_error_median, metric_error_rms
        Relative error of the map's distances between points: median over pairs of the absolute difference over the true distance;
        root of the sum of squared differences over that of squared distances. None where the map's distances are not known.
    placement_error
        Root mean square distance between a point of the map and its true position, after the best similarity of each component, mirror
        images allowed, over the arena's side: the square root of the area of its bounding box.
    placement_error_of_exact
        The same figure for classical MDS of the exact geodesics: no plane picture made that way does much better. None where the points
        of one component of the map are not in one component of the arena.
    """

    unit: str
    n_points: int
    n_components: int
    time_error_s: float
    betti_numbers: tuple[int, int]
    true_betti_numbers: tuple[int, int]
    true_diameter: float
    bottleneck: tuple[float, float]
    snr: float | None
    n_obstacles: int
    n_obstacles_found: int
    n_holes_false: int
    metric_error_median: float | None
    metric_error_rms: float | None
    placement_error: float
    placement_error_of_exact: float | None

    @property
    def betti_errors(self) -> tuple[int, int]:
        """Components and holes counted too many; negative: too few."""
        found, true = self.betti_numbers, self.true_betti_numbers
        return found[0] - true[0], found[1] - true[1]

    @property
    def bottleneck_share(self) -> tuple[float, float]:
        """``bottleneck`` over ``true_diameter``; 0 for a subsample at one place."""
        return self.bottleneck[0] / (self.true_diameter or 1.0), self.bottleneck[1] / (self.true_diameter or 1.0)

    @property
    def sensitivity(self) -> float | None:
        """TP / (TP + FN): the share of obstacles found; None without an obstacle."""
        return self.n_obstacles_found / self.n_obstacles if self.n_obstacles else None


def score_map(map_: MapResult | Mapping[str, object], run_directory: Path, *, speed: float | None = None) -> Scores:
    """Compare a map with the truth of the run it was made of.

    Parameters
    ----------
    map_
        A finished map, or its JSON object.
    run_directory
        What ``biobot-sim run`` or ``serve`` wrote.
    speed
        How far a biobot walks in a second of the map's time [unit of the run/s]; None takes it from ``run.json``.

    Raises
    ------
    StudyError
        The map is no map, or not of this run, or the directory is incomplete.
    MapError, SimulationError
        A file of the run is faulty, or no engine for persistence is installed.

    Notes
    -----
    Nothing is fitted to the truth but the similarity of the placement. Where the map has several components that are one in truth,
    the gap between them counts in ``bottleneck`` and ``betti_errors``; infinite intervals count in the Betti numbers alone.
    """
    truth = load_run(run_directory)
    located = find_map(map_, truth, speed=truth.speed if speed is None else speed)
    true_xy = truth.encounter_position[located.rows]
    exact = true_distances(truth, located.rows)
    true_intervals = diagram_of(exact)
    is_finite = np.isfinite(exact)
    obstacles = obstacle_points(truth.arena)
    n_found = count_enclosed([true_xy[outline] for outline in located.outlines], obstacles)
    median, rms = _metric_errors(located, exact)
    components = [np.flatnonzero(located.component == part) for part in np.unique(located.component)]
    is_whole = all(is_finite[np.ix_(rows, rows)].all() for rows in components)
    exact_xy = [embed_in_plane(exact[np.ix_(rows, rows)]).coordinates for rows in components] if is_whole else None
    return Scores(
        unit=truth.unit,
        n_points=len(located.rows),
        n_components=len(components),
        time_error_s=float(located.time_error_s.max()),
        betti_numbers=located.betti_numbers,
        true_betti_numbers=(truth.betti.components, truth.betti.holes),
        true_diameter=float(exact[is_finite].max()),
        bottleneck=(_bottleneck(located.intervals, true_intervals, 0), _bottleneck(located.intervals, true_intervals, 1)),
        snr=signal_to_noise(located.intervals[1], n_signals=truth.betti.holes),
        n_obstacles=len(obstacles),
        n_obstacles_found=n_found,
        n_holes_false=len(located.outlines) - n_found,
        metric_error_median=median,
        metric_error_rms=rms,
        placement_error=_placement_error([located.xy[rows] for rows in components], components, true_xy, truth),
        placement_error_of_exact=None if exact_xy is None else _placement_error(exact_xy, components, true_xy, truth),
    )


def describe(scores: Scores) -> list[str]:
    """Tell scores in lines for a person."""
    unit = scores.unit
    found, true, share = scores.betti_numbers, scores.true_betti_numbers, scores.bottleneck_share
    exact = scores.placement_error_of_exact
    return [
        f"subsample          {scores.n_points} points in {scores.n_components} components; times within {scores.time_error_s:.3g} s",
        f"true diameter      {scores.true_diameter:.4g} {unit}",
        f"components         {found[0]}, in truth {true[0]}",
        f"holes              {found[1]}, in truth {true[1]}",
        f"obstacles found    {scores.n_obstacles_found} of {scores.n_obstacles}, sensitivity {_percent(scores.sensitivity)}",
        f"false holes        {scores.n_holes_false}",
        *(
            f"bottleneck, H{dimension}     {scores.bottleneck[dimension]:.4g} {unit}, {share[dimension]:.1%} of the true diameter"
            for dimension in (0, 1)
        ),
        f"signal to noise    {'not defined' if scores.snr is None else f'{scores.snr:.4g}'}",
        f"metric error       median {_percent(scores.metric_error_median)}, rms {_percent(scores.metric_error_rms)}",
        f"placement error    {scores.placement_error:.1%} of the side; classical MDS of exact geodesics {_percent(exact)}",
    ]


def signal_to_noise(loops: Floats, *, n_signals: int) -> float | None:
    """Divide the mean squared length of the ``n_signals`` longest intervals, shape (m, 2), by that of the others; None without either."""
    lengths = np.sort(loops[:, 1] - loops[:, 0])[::-1]
    signal, noise = lengths[:n_signals], lengths[n_signals:]
    if not (signal.size and noise.size and noise[0] > 0):
        return None
    return float(np.mean(signal**2) / np.mean(noise**2))


def count_enclosed(outlines: Sequence[Floats], points: Floats) -> int:
    """Count the points that closed outlines go around, each outline for one point and each point once, as many as can be.

    Parameters
    ----------
    outlines
        Corners in order, not closed, shape (m, 2) each.
    points
        Shape (k, 2).
    """
    encloses = np.array([[winding_number(outline, point) != 0 for point in points] for outline in outlines], dtype=bool)
    if not encloses.size:
        return 0
    return int((maximum_bipartite_matching(csr_array(encloses), perm_type="column") >= 0).sum())


def winding_number(outline: Floats, point: Floats) -> int:
    """Count how often a closed outline, shape (m, 2), not closed, goes counter-clockwise around a point that is not on it."""
    x, y = (outline - point).T
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    turned = np.arctan2(x * next_y - y * next_x, x * next_x + y * next_y)
    return round(float(turned.sum()) / (2.0 * np.pi))


def main(arguments: Sequence[str] | None = None) -> int:
    """Score a map file; return the exit status: 0 done, 1 a file is faulty, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.scores", description="How near a map comes to the truth of its run.")
    parser.add_argument("run_directory", type=Path, metavar="RUN_DIR", help="what biobot-sim run or serve wrote")
    parser.add_argument("map_file", type=Path, metavar="MAP.json", help="what biobot-mapper run --json, or /api/v1/map, wrote")
    parser.add_argument("--speed", type=float, metavar="V", help="walking speed [unit of the run/s] (default: from run.json)")
    parser.add_argument("--json", action="store_true", help="print a JSON object instead of lines for a person")
    options = parser.parse_args(arguments)
    if options.speed is not None and not 0 < options.speed < float("inf"):
        parser.error(f"--speed is {options.speed}; wanted a finite number above 0")
    try:
        scores = score_map(_read_map(options.map_file), options.run_directory, speed=options.speed)
    except (StudyError, MapError, SimulationError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.json:
        derived = {"betti_errors": scores.betti_errors, "bottleneck_share": scores.bottleneck_share, "sensitivity": scores.sensitivity}
        print(json.dumps(asdict(scores) | derived, indent=2, allow_nan=False))
    else:
        print("\n".join(describe(scores)))
    return 0


def _read_map(path: Path) -> Mapping[str, object]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapFileError(source=str(path), problem=f"cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise MapFileError(source=str(path), problem=f"not JSON: {error}") from error
    if not isinstance(document, dict):
        raise MapFileError(source=str(path), problem=f"holds a JSON {type(document).__name__}")
    return document


def _bottleneck(found: Intervals, true: Intervals, dimension: int) -> float:
    finite = [intervals[np.isfinite(intervals[:, 1])] for intervals in (found[dimension], true[dimension])]
    return bottleneck_distance(finite[0], finite[1])


def _metric_errors(located: LocatedMap, exact: Floats) -> tuple[float | None, float | None]:
    if located.distances is None:
        return None, None
    found, true = [], []
    for part, distances in enumerate(located.distances):
        rows = np.flatnonzero(located.component == part)
        above = np.triu_indices(len(rows), 1)
        found.append(distances[above])
        true.append(exact[np.ix_(rows, rows)][above])
    measured, wanted = np.concatenate(found), np.concatenate(true)
    usable = np.isfinite(wanted) & (wanted > 0)
    if not usable.any():
        return None, None
    error = measured[usable] - wanted[usable]
    return float(np.median(np.abs(error) / wanted[usable])), float(np.sqrt((error**2).sum() / (wanted[usable] ** 2).sum()))


def _placement_error(placed: Sequence[Floats], components: Sequence[Indices], true_xy: Floats, truth: RunTruth) -> float:
    misses = [fit_similarity(xy, true_xy[rows])(xy) - true_xy[rows] for xy, rows in zip(placed, components, strict=True)]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(misses) ** 2, axis=1)))) / truth.side


def _percent(share: float | None) -> str:
    return "not known" if share is None else f"{share:.1%}"


if __name__ == "__main__":
    sys.exit(main())
