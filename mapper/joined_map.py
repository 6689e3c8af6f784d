"""One map of several finished maps: the same landmarks and encounters found in them, the pieces glued, and holes counted in the union."""

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from mapper.betti import judge_intervals
from mapper.component_map import PlacedComponent, draw_component
from mapper.embedding import embed_in_plane
from mapper.errors import UnlikeMapsError
from mapper.gluing import Sheet, find_flat_joints, glue, group_sheets
from mapper.kernels import Kernels
from mapper.map_file import LocalMap, MapFile
from mapper.persistence import rips_persistence
from mapper.skeleton import NO_SKELETON
from mapper.types import BettiRule, ComponentMap, IntArray, Recipe, read_only

# Points of a joined map: more take long, fewer lose small holes.
_MAX_POINTS = 2000


def check_alike(maps: Sequence[MapFile]) -> None:
    """See that maps were made in one way.

    Raises
    ------
    UnlikeMapsError
        Methods, metrics or speeds differ.
    """
    for what in ("method", "metric", "speed_mps"):
        values = {str(getattr(one, what)) for one in maps}
        if len(values) > 1:
            raise UnlikeMapsError(what=what, values=sorted(values))


def join_maps(
    maps: Sequence[MapFile], recipe: Recipe, rules: tuple[BettiRule, BettiRule], *, kernels: Kernels
) -> tuple[list[PlacedComponent], IntArray, list[str]]:
    """Join maps.

    Parameters
    ----------
    maps
        At least one; their order does not matter.

    Returns
    -------
    placed
        One for each group of components that share something, those with most encounters first; ``encounters`` are rows of ``points``.
    points
        Time [ns] and biobots of every encounter that is a point, shape (n, 3), in canonical order.
    warnings
        What could not be joined, or not for sure.

    Notes
    -----
    A point is the same in two maps if it is of the same pair and time; a place is, if the same landmark stood there at one time, or without
    a break. Of too many points each map gives those that were picked first, in proportion. Lengths of intervals are judged by the median
    reach of the maps. Encounters that two maps share are counted twice, for maps do not list them.
    """
    parts = sorted((part for one in maps for part in one.components), key=_order)
    points = np.unique(np.concatenate([part.points for part in parts]), axis=0)
    share = min(1.0, _MAX_POINTS / len(points))
    numbers = {tuple(point): number for number, point in enumerate(points.tolist())}
    stand_numbers = number_stands([part.stands for part in parts], first=len(points))
    sheets = [_make_sheet(part, numbers, stands, share=share) for part, stands in zip(parts, stand_numbers, strict=True)]
    groups = group_sheets(sheets)
    groups.sort(key=lambda group: (-sum(parts[index].n_encounters for index in group), group))
    warnings = []
    if len(groups) > 1:
        warnings.append(
            f"the maps fall into {len(groups)} groups that share neither a landmark that stood in both nor an encounter; they are kept "
            "apart, betti_numbers are summed; merge the encounters themselves where biobots occur in both"
        )
    placed = []
    for number, group in enumerate(groups):
        flat = find_flat_joints([sheets[index] for index in group])
        only_flat = _needed(len(group), flat, [sheets[index] for index in group])
        if only_flat:
            named = sorted({parts[group[index]].name for pair in only_flat for index in pair})
            warnings.append(
                f"{', '.join(named)} share fewer than three places, or places on a line: one may lie on the wrong side of it; "
                "let more landmarks stand in both"
            )
        placed.append(
            _map_group([parts[index] for index in group], [sheets[index] for index in group], recipe, rules, index=number, kernels=kernels)
        )
    return placed, points, warnings


def number_stands(stands: Sequence[IntArray], *, first: int) -> list[list[int]]:
    """Number places, the same for stands of one landmark that meet in time, directly or over others; counted from ``first``."""
    by_node: defaultdict[int, list[tuple[int, int, int, int]]] = defaultdict(list)
    for index, rows in enumerate(stands):
        for row, (node, begin, end) in enumerate(rows.tolist()):
            by_node[node].append((begin, end, index, row))
    numbers = [[0] * len(rows) for rows in stands]
    number = first - 1
    for node in sorted(by_node):
        last_end: int | None = None
        for begin, end, index, row in sorted(by_node[node]):
            if last_end is None or begin > last_end:
                number += 1
                last_end = end
            last_end = max(last_end, end)
            numbers[index][row] = number
    return numbers


def _order(part: LocalMap) -> tuple[int, int, bytes]:
    """Order pieces by what they hold, so that the order of files does not matter."""
    return int(part.points[:, 0].min()), len(part.points), part.points.tobytes() + part.distances.tobytes()


def _make_sheet(part: LocalMap, numbers: dict[tuple[int, ...], int], stands: Sequence[int], *, share: float) -> Sheet:
    n_points = int(np.ceil(share * len(part.points)))
    objects = np.array([*(numbers[tuple(point)] for point in part.points[:n_points].tolist()), *stands], dtype=np.int64)
    rows = np.concatenate([np.arange(n_points), np.arange(len(part.points), len(part.distances))])
    objects, first = np.unique(objects, return_index=True)
    rows = rows[first]
    return Sheet(objects=objects, is_landmark=rows >= len(part.points), distances=part.distances[np.ix_(rows, rows)])


def _needed(n: int, flat: Sequence[tuple[int, int]], sheets: Sequence[Sheet]) -> list[tuple[int, int]]:
    """Return the flat joints of sheets that firm ones do not hold together, directly or through others."""
    label = list(range(n))
    for later in range(n):
        for earlier in range(later):
            if (earlier, later) not in flat and np.isin(sheets[later].objects, sheets[earlier].objects).any():
                label = [label[earlier] if group == label[later] else group for group in label]
    return [pair for pair in flat if label[pair[0]] != label[pair[1]]]


def _map_group(
    parts: Sequence[LocalMap], sheets: Sequence[Sheet], recipe: Recipe, rules: tuple[BettiRule, BettiRule], *, index: int, kernels: Kernels
) -> PlacedComponent:
    glued = glue(sheets, kernels=kernels)
    lengths = glued.distances
    diagram = rips_persistence(lengths)
    diameter, reach = float(lengths.max()), float(np.median([part.reach for part in parts]))
    n_seen = int(np.median([part.n_seen for part in parts]))
    real = [judge_intervals(part, rule, diameter=reach, n_encounters=n_seen) for part, rule in zip(diagram.intervals, rules, strict=True)]
    merges, loops = diagram.intervals
    embedding = embed_in_plane(lengths)
    whole = PlacedComponent(
        summary=ComponentMap(
            n_encounters=sum(part.n_encounters for part in parts),
            n_used=sum(part.n_used for part in parts),
            n_points=len(lengths),
            n_landmarks=len(_all_landmarks(sheets)),
            diameter=diameter,
            cover_radius=max(part.cover_radius for part in parts),
            epsilon=0.0,
            lost_spectrum=embedding.lost_spectrum,
            distances=read_only(lengths),
            intervals=(read_only(merges), read_only(loops)),
            betti_numbers=(int(real[0].sum()), int(real[1].sum())),
            reach=reach,
        ),
        is_real=real[1],
        n_views=float(len(parts)),
        encounters=glued.objects,
        coordinates=embedding.coordinates,
        others=np.zeros((0, 2)),
        holes=(),
        skeleton=NO_SKELETON,
        diagram=diagram,
        doubt=np.zeros(len(lengths)),
        to_landmarks=np.zeros((len(lengths), 0)),
        landmark_encounters=np.zeros(0, dtype=np.int64),
        n_anchors=0,
        warnings=(),
    )
    return draw_component(whole, recipe, index=index, is_hole=real[1])


def _all_landmarks(sheets: Iterable[Sheet]) -> set[int]:
    return {number for sheet in sheets for number in sheet.objects[sheet.is_landmark].tolist()}
