"""Map one connected component of the encounter graph: metric, outliers, subsample, persistence, holes, embedding."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isqrt

import numpy as np

from mapper.betti import judge_intervals
from mapper.embedding import embed_in_plane, turn_to_axes
from mapper.encounter_graph import EncounterGraph
from mapper.hole_shapes import shape_hole
from mapper.hole_sizes import load_size_model
from mapper.metric import EncounterMetric, Metric, ProfileMetric, distances_to, profile_metric, times_to
from mapper.outliers import keep_inliers
from mapper.outlines import outline_holes
from mapper.persistence import Diagram, rips_persistence
from mapper.placement import Placement, place_in_plane, placed_profiles
from mapper.placing import place_among
from mapper.profiles import ProfileBracket, bracket_profiles, keep_well_bracketed, smooth_profiles, thin_out
from mapper.scale import estimate_scale, gather_evidence, load_scale_law
from mapper.skeleton import NO_SKELETON, Skeleton, build_skeleton, choose_epsilon, limit_epsilon
from mapper.subsampling import Subsample, stand_for, subsample_maxmin
from mapper.types import (
    BettiRule,
    BoolArray,
    ComponentMap,
    FloatArray,
    Hole,
    IntArray,
    LandmarkPlaces,
    MetricKind,
    ProfileNorm,
    Recipe,
    read_only,
)
from mapper.views import ONE_VIEW, Views, count_views

MIN_LANDMARKS = 3
"""Landmarks that profiles need: distances to one or two places cannot tell the two sides of a line apart."""
# Of times from vertices to landmarks [numbers: half a gigabyte], and of detours over a third place that brackets try [some seconds of a
# core]. 32 landmarks are used whatever it costs.
_MAX_PROFILE_NUMBERS = 2**26
_MAX_DETOURS = 2**34
_LEAST_MOST = 32
# Of a map that many views were put together to: more points take long.
_MAX_POINTS_OF_VIEWS = 1500
_FEWEST_VIEWS = 2.0
# Of the encounters that stand behind a point beyond those it needs, the share that is averaged with it (own choice, on training runs).
_SPREAD_SHARE = 0.5
_LEAST_AVERAGED = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Compared:
    """The metric, which vertices are good enough, which may be picked, in how many views seen, where they are, and how doubtful [ticks]."""

    metric: Metric
    kept: BoolArray
    candidates: BoolArray
    views: Views = ONE_VIEW
    placement: Placement | None = None
    doubt: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedComponent:
    """A component's map before it is put beside the others; point indices count from 0 within it.

    ``is_real`` says which loops of ``summary.intervals[1]`` the rule calls holes. ``holes`` and ``skeleton`` are empty, and
    ``summary.epsilon`` is 0, until `draw_component` has drawn it. ``n_views`` are as of `Views`.
    ``encounters``, shape (m,), are rows of the encounter table; ``coordinates`` has shape (m, 2), and
    ``others``, shape (k, 2), are the places of the further vertices asked for. ``n_anchors`` encounters served as
    references because landmarks were too few. ``doubt`` [unit of lengths], shape (m,), is half the gap between the bounds of each point's
    distances to the references; 0 where there are no bounds. ``to_landmarks`` [unit of lengths], shape (m, l), says how far each point is
    from l places where a landmark stood, and ``landmark_encounters``, shape (l,), names an encounter of each; l is 0 where fewer than three
    are compared with.
    """

    summary: ComponentMap
    is_real: BoolArray
    n_views: float
    encounters: IntArray
    coordinates: FloatArray
    others: FloatArray
    holes: tuple[Hole, ...]
    skeleton: Skeleton
    diagram: Diagram
    doubt: FloatArray
    to_landmarks: FloatArray
    landmark_encounters: IntArray
    n_anchors: int
    warnings: tuple[str, ...]


def map_component(
    graph: EncounterGraph,
    recipe: Recipe,
    rules: tuple[BettiRule, BettiRule],
    *,
    index: int,
    n_points: int,
    others: IntArray,
    ticks_per_length: float,
    origin_ns: int,
    contact: float,
    begin: Callable[[str], None],
) -> PlacedComponent:
    """Run the stages on one connected graph; what is only looked at is not drawn yet.

    Parameters
    ----------
    index
        Which component this is, for its warnings.
    n_points
        Size of the subsample.
    others
        Vertices to be placed besides, shape (k,); they change nothing else.
    ticks_per_length
        Ticks in one unit of length of the map.
    origin_ns
        When the first encounter of all began [ns].
    contact
        How long encounters last, their median [ticks].
    begin
        Told the name of each stage before it begins.

    Raises
    ------
    EngineMissingError
        The persistence engine is not installed.
    """
    begin("metric")
    references, n_anchors, warnings = _choose_references(graph, recipe, index=index)
    compared = _compare_and_filter(graph, references, recipe, n_points=n_points, contact=contact, begin=begin)
    begin("subsample")
    sample = subsample_maxmin(compared.metric, compared.candidates, n_points=count_points_of_views(n_points, compared.views))
    doubt = np.zeros(len(sample.vertices)) if compared.doubt is None else compared.doubt[sample.vertices]
    to_landmarks, landmark_encounters = np.zeros((len(sample.vertices), 0)), np.zeros(0, dtype=np.int64)
    if isinstance(compared.metric, ProfileMetric) and n_anchors == 0:
        to_landmarks = compared.metric.profiles[sample.vertices]
        landmark_encounters = graph.first_encounter[references].astype(np.int64)
    scale = None
    if compared.placement is not None:
        evidence = gather_evidence(graph, compared.placement, contact=contact, n_views=compared.views.number)
        scale = estimate_scale(evidence, load_scale_law())
        ticks_per_length /= scale.factor
    begin("persistence")
    lengths = sample.distances / ticks_per_length
    diagram = rips_persistence(lengths)
    diameter = float(lengths.max())
    reach = compared.views.reach * diameter
    n_used = int(graph.multiplicity[compared.kept].sum())
    # Of several views, each sees a part of the encounters.
    n_seen = int(n_used / compared.views.number)
    real = [judge_intervals(part, rule, diameter=reach, n_encounters=n_seen) for part, rule in zip(diagram.intervals, rules, strict=True)]
    begin("embedding")
    embedding = embed_in_plane(lengths)
    vertices, coordinates = sample.vertices, embedding.coordinates
    if compared.placement is not None and isinstance(compared.metric, ProfileMetric):
        places = compared.placement
        vertices = stand_for(sample, compared.metric, compared.candidates, doubt=places.doubt, xy=places.xy)
        coordinates = turn_to_axes(places.xy[vertices] / ticks_per_length)
    merges, loops = diagram.intervals
    return PlacedComponent(
        summary=ComponentMap(
            n_encounters=graph.n_encounters,
            n_used=n_used,
            n_points=len(sample.vertices),
            n_landmarks=len(graph.landmarks),
            diameter=diameter,
            cover_radius=sample.cover_radius / ticks_per_length,
            epsilon=0.0,
            lost_spectrum=embedding.lost_spectrum,
            distances=read_only(lengths),
            intervals=(read_only(merges), read_only(loops)),
            betti_numbers=(int(real[0].sum()), int(real[1].sum())),
            reach=reach,
            places=_locate_landmarks(
                graph, compared.metric, sample.vertices, origin_ns=origin_ns, ticks_per_length=ticks_per_length, n_seen=n_seen
            ),
            scale=scale,
        ),
        is_real=real[1],
        n_views=compared.views.number,
        encounters=graph.first_encounter[vertices].astype(np.int64),
        coordinates=coordinates,
        others=_place_others(compared, others, sample, vertices, coordinates, ticks_per_length=ticks_per_length),
        holes=(),
        skeleton=NO_SKELETON,
        diagram=diagram,
        doubt=read_only(doubt / ticks_per_length),
        to_landmarks=read_only(to_landmarks / ticks_per_length),
        landmark_encounters=landmark_encounters,
        n_anchors=n_anchors,
        warnings=warnings,
    )


def draw_component(placed: PlacedComponent, recipe: Recipe, *, index: int, is_hole: BoolArray) -> PlacedComponent:
    """Draw what is looked at: outlines and shapes of the loops that are holes, and the complex at the scale that shows them.

    Parameters
    ----------
    index
        Which component this is, for its holes.
    is_hole
        Which of the loops are holes, shape (m,), in the order of the intervals.
    """
    summary = placed.summary
    merges, loops = summary.intervals
    rows = np.flatnonzero(is_hole)
    size_model = load_size_model(recipe.method, recipe.metric)
    holes = tuple(
        shape_hole(
            Hole(component=index, birth=birth, death=death, outline=outline),
            placed.coordinates,
            summary.distances,
            n_used=summary.n_used,
            model=size_model,
        )
        for (birth, death), outline in zip(loops[rows].tolist(), outline_holes(summary.distances, placed.diagram, rows), strict=True)
    )
    if recipe.epsilon_share is None:
        epsilon = choose_epsilon(loops[is_hole], loops[~is_hole], merges[np.isfinite(merges[:, 1]), 1])
    else:
        epsilon = recipe.epsilon_share * summary.diameter
    if placed.n_views > 1:
        epsilon = limit_epsilon(summary.distances, epsilon)
    return replace(
        placed,
        summary=replace(summary, epsilon=epsilon, betti_numbers=(summary.betti_numbers[0], len(rows))),
        holes=holes,
        skeleton=build_skeleton(summary.distances, epsilon=epsilon),
    )


def _locate_landmarks(
    graph: EncounterGraph, metric: Metric, points: IntArray, *, origin_ns: int, ticks_per_length: float, n_seen: int
) -> LandmarkPlaces:
    to_points = distances_to(metric, graph.landmarks, points) / ticks_per_length
    is_known = np.isfinite(to_points).all(axis=1)  # of very many stands, few were placed
    node, begin, end = graph.stands[is_known].T
    landmarks = graph.landmarks[is_known]
    return LandmarkPlaces(
        node=read_only(node.copy()),
        t_start_ns=read_only(origin_ns + begin // 2),
        t_end_ns=read_only(origin_ns + end // 2),
        to_points=read_only(to_points[is_known]),
        between=read_only(distances_to(metric, landmarks, landmarks) / ticks_per_length),
        n_seen=n_seen,
    )


def _place_others(
    compared: _Compared, others: IntArray, sample: Subsample, vertices: IntArray, coordinates: FloatArray, *, ticks_per_length: float
) -> FloatArray:
    """Place further vertices in the same picture, shape (k, 2): where tracks were settled, or else among the points; nan where neither is.

    ``vertices`` stand for the subsample and are at ``coordinates``, shape (m, 2).
    """
    if compared.placement is None:
        to_points = distances_to(compared.metric, others, sample.vertices) / ticks_per_length
        return place_among(to_points, sample.distances / ticks_per_length, coordinates)
    # The picture is turned, moved and perhaps mirrored, and nothing else.
    xy = compared.placement.xy / ticks_per_length
    middle = xy[vertices].mean(axis=0)
    linear = np.linalg.pinv(xy[vertices] - middle) @ coordinates
    return np.asarray(coordinates.mean(axis=0) + (xy[others] - middle) @ linear)


def count_points_of_views(n_points: int, views: Views) -> int:
    """Say how many points a map of several views gets, where one view would get ``n_points``."""
    return max(n_points, min(_MAX_POINTS_OF_VIEWS, round(n_points * views.number)))


def _choose_references(graph: EncounterGraph, recipe: Recipe, *, index: int) -> tuple[IntArray, int, tuple[str, ...]]:
    """Choose the places that profiles measure from, and say how many of them are encounters; the encounter metric asks for none."""
    if recipe.metric is MetricKind.ENCOUNTER:
        return graph.landmarks, 0, ()
    if len(graph.landmarks) >= MIN_LANDMARKS:
        limit = max(_LEAST_MOST, min(_MAX_PROFILE_NUMBERS // graph.n_vertices, isqrt(_MAX_DETOURS // graph.n_vertices)))
        references = graph.busiest_landmarks(limit)
        if len(references) == len(graph.landmarks):
            return references, 0, ()
        warning = (
            f"a landmark stood at {len(graph.landmarks)} places of component {index}; its encounters are measured from the {limit} places "
            "with most encounters, which is what time and memory allow; a map of a window of time would use more"
        )
        return references, 0, (warning,)
    along_graph = EncounterMetric(graph=graph)
    anchors = subsample_maxmin(along_graph, _inliers(along_graph, recipe), n_points=recipe.n_anchors).vertices
    return np.union1d(graph.landmarks, anchors), len(anchors), ()


def _compare_and_filter(
    graph: EncounterGraph, references: IntArray, recipe: Recipe, *, n_points: int, contact: float, begin: Callable[[str], None]
) -> _Compared:
    """Make the metric, and say which vertices are good enough, and which of those may be picked."""
    if recipe.metric is MetricKind.ENCOUNTER:
        along_graph = EncounterMetric(graph=graph)
        begin("outliers")
        kept = _inliers(along_graph, recipe)
        return _Compared(metric=along_graph, kept=kept, candidates=kept)
    if not recipe.bracketed:
        between_profiles = profile_metric(graph, references, norm=recipe.profile_norm)
        begin("outliers")
        kept = _inliers(between_profiles, recipe)
        return _Compared(metric=between_profiles, kept=kept, candidates=thin_out(kept, limit=recipe.max_candidates))
    times = times_to(graph, references)
    views = _count_views(graph, references, times)
    bracket = bracket_profiles(times, references, kernels=graph.kernels)
    begin("outliers")
    kept = keep_well_bracketed(bracket, q=recipe.outlier_q)
    # Of a swarm that moved on, tracks in the plane make a worse map: of 30 obstacles 16 were found with them and 22 without (own count).
    settles = recipe.placed and views.number < _FEWEST_VIEWS
    if settles and recipe.profile_norm is ProfileNorm.MAX and len(graph.landmarks) >= MIN_LANDMARKS:
        return _place_and_compare(graph, references, recipe, bracket=bracket, kept=kept, views=views, n_points=n_points, contact=contact)
    candidates = thin_out(kept, limit=recipe.max_candidates)
    # Of fewer candidates fewer are averaged, over the same area.
    share = recipe.smoothing_share * (candidates.sum() / kept.sum()) / views.number
    profiles = bracket.middle
    profiles[candidates] = smooth_profiles(
        profiles[candidates],
        n_neighbours=round(share * graph.n_vertices),
        n_passes=recipe.smoothing_passes,
        kernels=graph.kernels,
    )
    metric = ProfileMetric(graph=graph, profiles=profiles, norm=recipe.profile_norm)
    return _Compared(metric=metric, kept=kept, candidates=candidates, views=views, doubt=bracket.doubt)


def _place_and_compare(
    graph: EncounterGraph,
    references: IntArray,
    recipe: Recipe,
    *,
    bracket: ProfileBracket,
    kept: BoolArray,
    views: Views,
    n_points: int,
    contact: float,
) -> _Compared:
    placement = place_in_plane(graph, references, middle=bracket.middle, doubt=bracket.doubt, contact=contact)
    candidates = thin_out(kept & placement.is_placed, limit=recipe.max_candidates)
    n_averaged = max(_LEAST_AVERAGED, round(recipe.smoothing_share / views.number * placement.is_placed.sum()))
    profiled = candidates.copy()
    profiled[graph.landmarks] = placement.is_placed[graph.landmarks]  # where they are is asked for, candidates or not
    profiles = placed_profiles(graph, placement, profiled, references, middle=bracket.middle, n_neighbours=n_averaged)
    surplus = candidates.sum() / count_points_of_views(n_points, views) - recipe.encounters_per_point
    profiles[profiled] = smooth_profiles(
        profiles[profiled],
        n_neighbours=max(0, round(_SPREAD_SHARE * surplus)),
        n_passes=recipe.smoothing_passes,
        kernels=graph.kernels,
    )
    metric = ProfileMetric(graph=graph, profiles=profiles, norm=recipe.profile_norm)
    return _Compared(metric=metric, kept=kept, candidates=candidates, views=views, placement=placement, doubt=bracket.doubt)


def _count_views(graph: EncounterGraph, references: IntArray, times: FloatArray) -> Views:
    """Count the views of the swarm by the landmarks among the references; ``times`` as of `times_to`."""
    columns = np.flatnonzero(np.isin(references, graph.landmarks))
    if not len(columns):
        return ONE_VIEW
    of_landmarks = references[columns]
    return count_views(times[np.ix_(of_landmarks, columns)], graph.stands[np.searchsorted(graph.landmarks, of_landmarks), 1:])


def _inliers(metric: Metric, recipe: Recipe) -> BoolArray:
    if recipe.outlier_q == 1:
        return np.ones(metric.graph.n_vertices, dtype=bool)
    return keep_inliers(metric, k=recipe.outlier_k, q=recipe.outlier_q)
