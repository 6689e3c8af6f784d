"""Pins fix a map in the operator's frame: what they fix comes out, what they cannot is told."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapper.errors import InputFileError, PinsError
from mapper.frames import Similarity, TangentPlane, fit_pins
from mapper.pins import Pin, read_pins
from mapper.places import BiobotPlace, LandmarkPlace, PointPlace
from mapper.types import FloatArray

few = settings(max_examples=40)
similarities = st.builds(
    Similarity,
    scale=st.floats(1e-3, 1e3),
    turn_rad=st.floats(-3.0, 3.0),
    is_mirrored=st.booleans(),
    shift=st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
)
whole = st.integers(-50, 50).map(float)
pins_on_map = st.integers(3, 8).flatmap(lambda n: arrays(np.float64, (n, 2), elements=whole))


def _names(n: int) -> list[str]:
    return [f"landmark:{number}" for number in range(n)]


def _is_wide(places: FloatArray) -> bool:
    widths = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(widths[1] > 0.1 * widths[0])


@given(similarities, pins_on_map)
@few
def test_exact_pins_give_the_similarity_back(similarity: Similarity, places: FloatArray) -> None:
    assume(_is_wide(places))
    fit = fit_pins(places, similarity(places), _names(len(places)))
    assert fit.similarity.is_mirrored == similarity.is_mirrored
    assert fit.is_handed
    assert np.isclose(fit.similarity.scale, similarity.scale)
    assert np.allclose(fit.similarity(places), similarity(places), rtol=1e-6, atol=1e-6 * similarity.scale)
    assert fit.rms < 1e-6 * (1.0 + similarity.scale * 50.0 + 1e4 * 1e-3)
    assert fit.warnings == ()


@given(similarities, pins_on_map)
@few
def test_the_inverse_leads_back(similarity: Similarity, places: FloatArray) -> None:
    there = similarity(places)
    assert np.allclose(similarity.inverse()(there), places, atol=1e-6 * (1.0 + np.abs(there).max() / similarity.scale))


@given(similarities, st.integers(0, 2**32))
@few
def test_no_other_similarity_fits_better(similarity: Similarity, seed: int) -> None:
    """Least squares: a nudge of scale, turn or shift never makes the residuals smaller."""
    rng = np.random.default_rng(seed)
    places = rng.normal(0.0, 10.0, (5, 2))
    known = similarity(places) + rng.normal(0.0, similarity.scale, (5, 2))
    fit = fit_pins(places, known, _names(5))
    best = float((fit.residuals**2).sum())
    for scale, turn, shift in rng.normal(0.0, 0.01, (20, 3)).tolist():
        nudged = Similarity(
            scale=fit.similarity.scale * (1.0 + scale),
            turn_rad=fit.similarity.turn_rad + turn,
            is_mirrored=fit.similarity.is_mirrored,
            shift=(fit.similarity.shift[0] + shift, fit.similarity.shift[1]),
        )
        assert float(((nudged(places) - known) ** 2).sum()) >= best * (1.0 - 1e-9)


def test_two_pins_leave_the_mirror_image_open_and_say_so() -> None:
    fit = fit_pins(np.array([(0.0, 0.0), (2.0, 0.0)]), np.array([(5.0, 5.0), (5.0, 9.0)]), _names(2))
    assert not fit.is_handed
    assert "mirror image" in fit.warnings[0]
    assert fit.similarity.scale == pytest.approx(2.0)
    assert fit.rms == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("on_map", "known", "reason"),
    [
        ([(0, 0)], [(0, 0)], "1 pin"),
        ([(0, 0), (1, 1)], [(3, 3), (3, 3)], "known places of landmark:0, landmark:1 are one"),
        ([(1, 1), (1, 1)], [(3, 3), (4, 3)], "places on the map of landmark:0, landmark:1 are one"),
        ([(0, 0), (1, 0), (2, 1)], [(0, 0), (1, 1), (2, 2)], "on one line"),
        ([(0, 0), (1, 0), (2, 0)], [(0, 0), (1, 1), (2, 1)], "on one line"),
    ],
)
def test_pins_that_fix_nothing_are_refused_with_the_reason(
    on_map: list[tuple[int, int]], known: list[tuple[int, int]], reason: str
) -> None:
    with pytest.raises(PinsError, match=reason):
        fit_pins(np.array(on_map, dtype=np.float64), np.array(known, dtype=np.float64), _names(len(known)))


@given(similarities, st.integers(0, 4), st.integers(0, 2**32))
@few
def test_a_pin_that_all_others_contradict_is_named(similarity: Similarity, wrong: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.array([(0.0, 0.0), (10.0, 1.0), (9.0, 10.0), (1.0, 9.0), (5.0, 4.0)])
    known = similarity(places + rng.normal(0.0, 0.05, (5, 2)))
    known[wrong] += 20.0 * similarity.scale * np.array([np.cos(seed), np.sin(seed)])
    warnings = fit_pins(places, known, _names(5)).warnings
    assert any(warning.startswith(f"landmark:{wrong} is ") for warning in warnings)


@given(st.floats(-180, 180), st.floats(-85, 85), arrays(np.float64, (4, 2), elements=st.floats(-5e4, 5e4)))
@few
def test_metres_and_degrees_invert_each_other(lon: float, lat: float, metres: FloatArray) -> None:
    plane = TangentPlane(lon=lon, lat=lat)
    assert np.allclose(plane.to_metres(plane.to_degrees(metres)), metres, atol=1e-4)


def test_a_degree_is_as_long_as_the_ellipsoid_has_it() -> None:
    """At the equator 111,319.49 m east and 110,574.28 m north; at 60 degrees 55,800.09 m and 111,412.24 m (WGS 84, radii of curvature)."""
    for lat, wanted in ((0.0, (111_319.49, 110_574.28)), (60.0, (55_800.09, 111_412.24))):
        metres = TangentPlane(lon=10.0, lat=lat).to_metres(np.array([(11.0, lat + 1.0)]))[0]
        assert metres.tolist() == pytest.approx(wanted, rel=2e-5)


_PINS = (
    Pin(place=LandmarkPlace(node="7"), at=(0.0, 1.5), is_geographic=False),
    Pin(place=BiobotPlace(node="3", t_s=61.5), at=(4.0, -2.0), is_geographic=False),
    Pin(place=LandmarkPlace(node="9", t_s=12.0), at=(1.0, 1.0), is_geographic=False),
    Pin(place=PointPlace(index=4), at=(2.5, 0.0), is_geographic=False),
)
_ROWS = [
    {"landmark": 7, "x": 0.0, "y": 1.5},
    {"biobot": 3, "t_s": 61.5, "x": 4.0, "y": -2.0},
    {"landmark": 9, "t_s": 12.0, "x": 1.0, "y": 1.0},
    {"point": 4, "x": 2.5, "y": 0.0},
]


def _toml(rows: list[dict[str, float]]) -> str:
    return "".join("[[pins]]\n" + "".join(f"{name} = {value}\n" for name, value in row.items()) for row in rows)


def _csv(rows: list[dict[str, float]]) -> str:
    names = ["landmark", "biobot", "point", "t_s", "x", "y"]
    return "\n".join([",".join(names), *(",".join(str(row.get(name, "")) for name in names) for row in rows)]) + "\n"


@pytest.mark.parametrize(
    ("ending", "text"), [("toml", _toml(_ROWS)), ("json", json.dumps(_ROWS)), ("json", json.dumps({"pins": _ROWS})), ("csv", _csv(_ROWS))]
)
def test_all_kinds_of_files_say_the_same(tmp_path: Path, ending: str, text: str) -> None:
    path = tmp_path / f"pins.{ending}"
    path.write_text(text, encoding="utf-8")
    assert read_pins(path) == _PINS


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("pins.toml", "[[pins]]\nlandmark = 7\nx = 1\n", "pin 1: wants x and y in metres"),
        ("pins.toml", "[[pins]]\nlandmark = 7\nbiobot = 3\nx = 1\ny = 2\n", "names landmark and biobot"),
        ("pins.toml", "[[pins]]\nx = 1\ny = 2\n", "names nothing"),
        ("pins.toml", "[[pins]]\nbiobot = 3\nx = 1\ny = 2\n", "but not when"),
        ("pins.toml", "[[pins]]\nlandmark = 7\nx = inf\ny = 2\n", "not finite"),
        ("pins.toml", "[[pins]]\nlandmark = 7\nlon = 7\nlat = 95\n", "wanted degrees"),
        ("pins.toml", "[[pins]]\nlandmark = 7\nlon = 7\nlat = 5\n[[pins]]\nlandmark = 8\nx = 7\ny = 5\n", "give one kind"),
        ("pins.toml", "[[pins]]\nlandmark = 7\nplace = 7\n", "unknown field"),
        ("pins.toml", "pins = [", "Invalid"),
        ("pins.json", "[]", "has no pins"),
        ("pins.json", "[1]", "Expected"),
        ("pins.csv", "point,x,y\nseven,1,2\n", "line 2: point is 'seven'"),
        ("pins.csv", "landmark,x,y\nseven,one,2\n", "line 2: x is 'one'"),
        ("pins.csv", "landmark,x,y\n7,1,2,3\n", "more values"),
        ("pins.csv", "landmark,x,z\n7,1,2\n", "has columns 'z'"),
        ("pins.txt", "", "wanted .toml, .json or .csv"),
    ],
)
def test_what_is_wrong_with_a_file_of_pins_is_told(tmp_path: Path, name: str, text: str, reason: str) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputFileError) as caught:
        read_pins(path)
    assert reason in str(caught.value)


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="no such file"):
        read_pins(tmp_path / "pins.toml")
