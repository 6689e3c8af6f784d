"""Sizes of holes: to the map's scale, with errors, within what geometry allows; and the polygon has the size that is told."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapper.config import RecipeConfig, make_recipe
from mapper.hole_shapes import draw_outline, shape_hole
from mapper.hole_sizes import LoopMeasures, estimate_size, load_size_model
from mapper.placing import place_among
from mapper.polygons import contains, signed_area
from mapper.types import FloatArray, Hole, Method, MetricKind

few = settings(max_examples=50)
loops = st.builds(
    LoopMeasures,
    birth=st.floats(0.01, 0.9),
    death=st.just(1.0),
    loop_length=st.floats(1.0, 10.0),
    drawn_length=st.floats(1.0, 10.0),
    drawn_area=st.floats(0.0, 8.0),
    encounters_per_point=st.floats(1.0, 1e4),
    encounters_about=st.floats(1.0, 1e6),
)
methods = st.sampled_from(list(Method))


def _scaled(loop: LoopMeasures, factor: float) -> LoopMeasures:
    lengths = ("birth", "death", "loop_length", "drawn_length")
    return replace(loop, **{name: factor * getattr(loop, name) for name in lengths}, drawn_area=factor**2 * loop.drawn_area)


@given(loops, methods, st.floats(1e-3, 1e3))
@few
def test_sizes_and_errors_scale_with_the_map(loop: LoopMeasures, method: Method, factor: float) -> None:
    model = load_size_model(method, make_recipe(RecipeConfig(method=method)).metric)
    assert model is not None
    one, other = estimate_size(loop, model), estimate_size(_scaled(loop, factor), model)
    assert other.perimeter == pytest.approx(factor * one.perimeter)
    assert other.perimeter_error == pytest.approx(factor * one.perimeter_error)
    assert other.area == pytest.approx(factor**2 * one.area)
    assert other.area_error == pytest.approx(factor**2 * one.area_error)
    assert 0 < one.area <= one.perimeter**2 / (4 * np.pi) * (1 + 1e-12)
    assert 0 < one.perimeter_error <= one.perimeter * (1 + 1e-12)


@given(loops, methods)
@few
def test_fewer_encounters_and_wider_steps_never_make_a_size_surer(loop: LoopMeasures, method: Method) -> None:
    model = load_size_model(method, make_recipe(RecipeConfig(method=method)).metric)
    assert model is not None
    known = estimate_size(loop, model)
    for worse in (replace(loop, birth=0.95), replace(loop, encounters_about=loop.encounters_about / 4)):
        doubted = estimate_size(worse, model)
        assert doubted.perimeter_error / doubted.perimeter >= known.perimeter_error / known.perimeter - 1e-12
        assert doubted.area_error / doubted.area >= known.area_error / known.area - 1e-12


def test_where_nothing_was_trained_nothing_is_told() -> None:
    assert load_size_model(Method.PAPER, MetricKind.LANDMARK_PROFILE) is None


def _hole(corners: FloatArray) -> Hole:
    return Hole(component=0, birth=0.5, death=2.0, outline=np.arange(len(corners)))


@given(st.integers(4, 10), st.integers(0, 2**32))
@few
def test_the_polygon_is_simple_has_the_area_told_and_goes_around_its_centre(n: int, seed: int) -> None:
    corners = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 2))
    distances = np.hypot(*(np.subtract.outer(at, at) for at in corners.T))
    model = load_size_model(Method.DEFAULT, MetricKind.LANDMARK_PROFILE)
    hole = shape_hole(_hole(corners), corners, distances, n_used=100, model=model)
    assert hole.centre is not None
    assert signed_area(hole.outline_xy) == pytest.approx(hole.area)
    assert contains(hole.outline_xy, hole.centre[None])[0]
    bare = shape_hole(_hole(corners), corners, distances, n_used=100, model=None)
    assert (bare.area, bare.perimeter) == (None, None)
    drawn = draw_outline(corners)
    assert drawn is not None
    assert bare.outline_xy.tolist() == drawn.tolist()


def test_an_outline_on_a_line_has_a_perimeter_and_no_polygon() -> None:
    corners = np.column_stack([np.arange(5.0), np.zeros(5)])
    distances = np.abs(np.subtract.outer(corners[:, 0], corners[:, 0]))
    hole = shape_hole(_hole(corners), corners, distances, n_used=100, model=load_size_model(Method.DEFAULT, MetricKind.LANDMARK_PROFILE))
    assert (hole.centre, hole.area, len(hole.outline_xy)) == (None, None, 0)
    assert hole.perimeter is not None


@given(st.integers(3, 12), st.integers(0, 2**32))
@few
def test_further_encounters_are_placed_where_their_distances_say(n: int, seed: int) -> None:
    """In the plane distances leave no choice; the picture may be turned and mirrored."""
    rng = np.random.default_rng(seed)
    places = rng.normal(0.0, 1.0, (n + 4, 2))
    distances = np.hypot(*(np.subtract.outer(at, at) for at in places.T))
    turned = (places - places[:n].mean(axis=0)) @ np.array([[0.6, 0.8], [0.8, -0.6]])
    found = place_among(distances[n:, :n], distances[:n, :n], turned[:n])
    assert np.allclose(found, turned[n:], atol=1e-6 / np.linalg.svd(turned[:n], compute_uv=False)[1])
