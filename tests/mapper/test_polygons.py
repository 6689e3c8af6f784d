"""Polygons: simple, counter-clockwise, of the area asked for."""

import numpy as np
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapper.polygons import (
    boundary_length,
    centroid,
    contains,
    convex_hull,
    crossing_sides,
    inner_place,
    is_simple,
    scale_to_area,
    signed_area,
    uncross,
)
from mapper.types import FloatArray

few = settings(max_examples=40)
whole = st.integers(-20, 20).map(float)
corners = st.integers(3, 12).flatmap(lambda n: arrays(np.float64, (n, 2), elements=whole))


def _star(radii: list[int]) -> FloatArray:
    """A simple polygon about the origin, counter-clockwise."""
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    return np.asarray(np.column_stack([np.cos(angles), np.sin(angles)]) * np.array(radii)[:, None], dtype=np.float64)


stars = st.lists(st.integers(1, 20), min_size=3, max_size=12).map(_star)


@given(corners)
@few
def test_areas_and_lengths_are_those_of_shapely(places: FloatArray) -> None:
    polygon = shapely.Polygon(places)
    assert abs(signed_area(places)) == abs(signed_area(places[::-1]))
    assert np.isclose(boundary_length(places), polygon.length)
    if polygon.is_valid and polygon.area > 0:
        assert np.isclose(abs(signed_area(places)), polygon.area)
        assert (signed_area(places) > 0) == polygon.exterior.is_ccw
        assert np.allclose(centroid(places), polygon.centroid.coords[0])


@given(corners)
@few
def test_simple_is_what_shapely_calls_simple(places: FloatArray) -> None:
    assert is_simple(places) == (len(np.unique(places, axis=0)) == len(places) and shapely.LinearRing(places).is_simple)


@given(corners)
@few
def test_uncrossing_keeps_the_corners_and_makes_a_simple_polygon(places: FloatArray) -> None:
    found = uncross(places)
    if found is None:
        return
    assert is_simple(found)
    assert signed_area(found) > 0
    assert (found[0] == places[0]).all()
    assert sorted(map(tuple, found.tolist())) == sorted(map(tuple, places.tolist()))
    assert boundary_length(found) <= boundary_length(places) + 1e-9


@given(st.permutations(range(9)))
@few
def test_corners_on_a_circle_can_always_be_uncrossed(order: list[int]) -> None:
    angles = np.arange(9) * 2 * np.pi / 9
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    found = uncross(circle[order])
    assert found is not None
    assert np.isclose(boundary_length(found), boundary_length(circle))


@given(stars, arrays(np.float64, (5, 2), elements=st.floats(-21, 21).map(lambda value: round(value, 2) + 0.00371)))
@few
def test_what_is_inside_is_what_shapely_says(places: FloatArray, asked: FloatArray) -> None:
    polygon = shapely.Polygon(places)
    wanted = shapely.contains_xy(polygon, *asked.T)
    near = shapely.distance(polygon.exterior, shapely.points(asked)) < 1e-9
    assert (contains(places, asked) == wanted)[~near].all()
    assert shapely.intersects(polygon.buffer(1e-9), shapely.Point(inner_place(places)))


@given(stars, st.floats(0.01, 1e4))
@few
def test_scaling_gives_the_area_asked_for_about_the_same_centre(places: FloatArray, area: float) -> None:
    scaled = scale_to_area(places, area)
    assert np.isclose(abs(signed_area(scaled)), area)
    assert np.allclose(centroid(scaled), centroid(places))
    assert (signed_area(scaled) > 0) == (signed_area(places) > 0)


@given(corners, arrays(np.float64, (3, 2), elements=whole), arrays(np.float64, (3, 2), elements=whole))
@few
def test_segments_meet_the_sides_that_shapely_says(places: FloatArray, starts: FloatArray, ends: FloatArray) -> None:
    assume(len(np.unique(places, axis=0)) == len(places) and not (starts == ends).all(axis=1).any())
    sides = [shapely.LineString(side) for side in zip(places, np.roll(places, -1, axis=0), strict=True)]
    segments = [shapely.LineString(pair) for pair in zip(starts, ends, strict=True)]
    wanted = [[bool(segment.intersects(side)) for side in sides] for segment in segments]
    assert crossing_sides(starts, ends, places).tolist() == wanted


@given(st.integers(1, 12).flatmap(lambda n: arrays(np.float64, (n, 2), elements=whole)))
@few
def test_the_hull_is_that_of_shapely(places: FloatArray) -> None:
    hull = convex_hull(places)
    wanted = shapely.MultiPoint(places).convex_hull
    assert {tuple(corner) for corner in hull.tolist()} == {tuple(corner) for corner in shapely.get_coordinates(wanted).tolist()}
    assert len(hull) < 3 or signed_area(hull) > 0
