"""Maps laid over each other, and what is different between them: laws on maps of a ring, turned, mirrored, thinned and doubled."""

import json
from dataclasses import replace
from functools import cache
from math import hypot, pi
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapper.config import RecipeConfig, make_recipe
from mapper.errors import MapDocumentError
from mapper.frames import Similarity
from mapper.map_alignment import align_map, fit_components, fit_motion
from mapper.map_codec import decode_map
from mapper.map_difference import MapDifference, compare_maps
from mapper.map_job import MapDocuments, make_map
from mapper.map_marks import read_marks, shared_marks, take_marks
from mapper.store import Store
from mapper.types import MapResult
from tests.mapper.fake_gateway import batch
from tests.mapper.ring import ring_records

NOW_NS = 2_000_000_000_000_000_000
TURNS = st.builds(
    Similarity,
    scale=st.just(1.0),
    turn_rad=st.floats(-pi, pi),
    is_mirrored=st.booleans(),
    shift=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
)


@cache
def ring_map(n_records: int = 10_000) -> MapDocuments:
    """Map the ring from its first records."""
    store = Store(None)
    store.apply([batch(ring_records()[:n_records])])
    documents = make_map(store.delta(after=0), make_recipe(RecipeConfig()), window_ns=None, now_ns=NOW_NS)
    store.close()
    assert isinstance(documents, MapDocuments)
    return documents


def as_served(documents: MapDocuments, *, version: int = 1) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(documents.map_json)
    return {"version": version, "computed_wall_ns": version, **document}


def moved(document: dict[str, Any], motion: Similarity) -> dict[str, Any]:
    """Put a map into another frame, by hand."""
    other: dict[str, Any] = json.loads(json.dumps(document))

    def move(place: list[float]) -> list[float]:
        return [float(value) for value in motion(np.array([place]))[0]]

    for item in (*other["points"], *other["landmarks"]):
        item["x"], item["y"] = move([item["x"], item["y"]])
    for hole in (*other["holes"], *other["possible_holes"]):
        hole["outline"] = [move(place) for place in hole["outline"]]
        hole["outline_xy"] = [move(place) for place in hole["outline_xy"]]
        hole["centre"] = hole["centre"] and move(hole["centre"])
    return other


def compare(before: dict[str, Any], after: dict[str, Any]) -> MapDifference:
    return compare_maps(json.dumps(before).encode(), json.dumps(after).encode())


def mirror(found: MapDifference) -> dict[str, Any]:
    """What the difference the other way round must be, but for frames and words."""
    return {
        "before": found.after,
        "after": found.before,
        "appeared": {hole.hole for hole in found.vanished},
        "vanished": {hole.hole for hole in found.appeared},
        "possible": sorted([(hole.hole, hole.possible_in_other) for hole in (*found.appeared, *found.vanished)], key=str),
        "stayed": {(one.after.hole, one.before.hole, round(one.moved, 6)) for one in found.stayed},
        "came": found.landmarks.went,
        "went": found.landmarks.came,
        "marks": sorted((fit.after, fit.before, fit.n_shared, round(fit.rms, 6)) for fit in found.frames),
    }


def straight(found: MapDifference) -> dict[str, Any]:
    return {
        "before": found.before,
        "after": found.after,
        "appeared": {hole.hole for hole in found.appeared},
        "vanished": {hole.hole for hole in found.vanished},
        "possible": sorted([(hole.hole, hole.possible_in_other) for hole in (*found.appeared, *found.vanished)], key=str),
        "stayed": {(one.before.hole, one.after.hole, round(one.moved, 6)) for one in found.stayed},
        "came": found.landmarks.came,
        "went": found.landmarks.went,
        "marks": sorted((fit.before, fit.after, fit.n_shared, round(fit.rms, 6)) for fit in found.frames),
    }


@given(motion=TURNS)
@settings(max_examples=15)
def test_a_map_in_whatever_frame_differs_from_itself_in_nothing(motion: Similarity) -> None:
    document = as_served(ring_map())
    found = compare(document, moved(document, motion))
    assert found.summary == ["nothing changed"]
    assert not found.appeared
    assert not found.vanished
    assert [one.before.hole for one in found.stayed] == [one.after.hole for one in found.stayed] == [1]
    assert found.stayed[0].moved == pytest.approx(0, abs=1e-9)
    (frame,) = found.frames
    assert (frame.n_shared, frame.is_mirrored) == (len(document["points"]) + len(document["landmarks"]), motion.is_mirrored)
    assert frame.rms == pytest.approx(0, abs=1e-9)


@st.composite
def changed_maps(draw: st.DrawFn) -> dict[str, Any]:
    """The ring's map with holes, possible holes, points and landmarks added and taken away, in another frame."""
    document: dict[str, Any] = as_served(ring_map(draw(st.sampled_from([400, 600, 10_000]))), version=draw(st.integers(1, 5)))
    hole: dict[str, Any] = document["holes"][0]

    def a_hole() -> dict[str, Any]:
        x, y, radius = draw(st.floats(-4, 4)), draw(st.floats(-4, 4)), draw(st.floats(0.1, 2))
        corners = [[x + radius * np.cos(angle), y + radius * np.sin(angle)] for angle in (0.0, 2.0, 4.0)]
        return hole | {
            "outline": corners,
            "outline_xy": [*corners, corners[0]],
            "centre": draw(st.sampled_from([[x, y], None])),
            "area": draw(st.sampled_from([pi * radius**2, None])),
            "probability": draw(st.sampled_from([0.2, 0.9, None])),
        }

    document["holes"] = document["holes"][: draw(st.integers(0, 1))] + [a_hole() for _ in range(draw(st.integers(0, 3)))]
    document["possible_holes"] = [a_hole() for _ in range(draw(st.integers(0, 2)))]
    document["landmarks"] = document["landmarks"][draw(st.integers(0, 18)) :]
    document["points"] = document["points"][: draw(st.integers(3, 20))]
    n_apart = draw(st.integers(0, 3))
    for place, point in enumerate(document["points"]):
        point["component"] = int(place < n_apart)
    motion: Similarity = draw(TURNS)
    return moved(document, motion)


@given(before=changed_maps(), after=changed_maps())
@settings(max_examples=25, deadline=None)
def test_the_difference_the_other_way_round_is_its_mirror_image(before: dict[str, Any], after: dict[str, Any]) -> None:
    found = compare(before, after)
    assert straight(compare(after, before)) == mirror(found)
    assert len(found.stayed) + len(found.appeared) == len(after["holes"])
    assert len(found.stayed) + len(found.vanished) == len(before["holes"])
    assert found.summary


def test_holes_that_come_grow_and_go_are_told_with_what_is_known_of_them() -> None:
    before, after = as_served(ring_map(), version=3), as_served(ring_map(), version=4)
    (hole,) = before["holes"]
    small = hole | {"centre": [3.2, 0.0], "area": 0.5, "probability": 0.9, "outline_xy": [[3.0, 0], [3.4, 0], [3.2, 0.3], [3.0, 0]]}
    after["holes"] = [small, hole | {"area": 2 * hole["area"], "probability": 0.99}]
    after["betti_numbers"] = [1, 2]
    before["possible_holes"] = [small | {"probability": 0.3}]
    after["landmarks"] = after["landmarks"][1:]
    found = compare(before, moved(after, Similarity(scale=1.0, turn_rad=2.0, is_mirrored=True, shift=(9.0, 0.0))))
    assert [(one.hole, one.probability, one.possible_in_other) for one in found.appeared] == [(1, 0.9, 0.3)]
    assert [(one.before.hole, one.after.hole, one.after.area) for one in found.stayed] == [(1, 2, 2 * hole["area"])]
    assert found.landmarks.went == [str(before["landmarks"][0]["id"])]
    assert found.summary[0].startswith("hole 1 is new, 90% sure, area 0.5")
    assert "only possible, 30%" in found.summary[0]


def test_maps_that_share_nothing_are_said_not_to_be_comparable() -> None:
    before, after = as_served(ring_map()), as_served(ring_map())
    for point in after["points"]:
        point["t"] += 100.0
    for landmark in after["landmarks"]:
        landmark["t_start"] += 100.0
    found = compare(before, after)
    assert not found.is_comparable
    assert [hole.is_comparable for hole in (*found.appeared, *found.vanished)] == [False, False]
    assert "not known" in found.summary[0]
    with pytest.raises(MapDocumentError, match="the later map"):
        compare_maps(json.dumps(before).encode(), b"[]")


def rotated(result: MapResult, motion: Similarity) -> MapResult:
    xy = motion(np.column_stack([result.points.x, result.points.y]))
    landmarks = []
    for one in result.landmarks:
        x, y = motion(np.array([[one.x, one.y]]))[0].tolist()
        landmarks.append(replace(one, x=x, y=y))
    return replace(result, points=replace(result.points, x=xy[:, 0], y=xy[:, 1]), landmarks=tuple(landmarks))


@given(motion=TURNS)
@settings(max_examples=15)
def test_a_map_laid_over_another_frame_of_itself_is_that_one(motion: Similarity) -> None:
    result = decode_map(ring_map().drawing)
    there = rotated(result, motion)
    back, fit = align_map(result, take_marks(there))
    assert fit is not None
    assert fit.n_shared == len(result.points) + len(result.landmarks)
    assert np.allclose(np.column_stack([back.points.x, back.points.y]), np.column_stack([there.points.x, there.points.y]))
    for hole, before in zip(back.holes, result.holes, strict=True):
        assert hole.centre is not None
        assert before.centre is not None
        assert np.allclose(hole.centre, motion(before.centre[None, :])[0])
        x, y = hole.outline_xy.T
        assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0, "counter-clockwise"


def test_maps_of_more_and_more_encounters_lie_as_the_first() -> None:
    """Of a ring, every direction is as long as any other: by itself each map would turn as it likes."""
    first = as_served(ring_map(400))
    store = Store(None)
    store.apply([batch(ring_records())])
    later = make_map(store.delta(after=0), make_recipe(RecipeConfig()), window_ns=None, now_ns=NOW_NS, previous=msgspec.json.encode(first))
    other = make_map(store.delta(after=0), make_recipe(RecipeConfig()), window_ns=None, now_ns=NOW_NS, previous=b"of another version")
    store.close()
    assert isinstance(later, MapDocuments)
    assert isinstance(other, MapDocuments)
    assert json.loads(other.map_json) == json.loads(ring_map().map_json)
    document = json.loads(later.map_json)
    places = {one["id"]: (one["x"], one["y"]) for one in first["landmarks"]}
    moves = [hypot(one["x"] - places[one["id"]][0], one["y"] - places[one["id"]][1]) for one in document["landmarks"]]
    assert max(moves) < 0.05 * document["diameter"]
    assert document["aligned"]["n_shared"] == len(places) + len(document["points"])
    assert json.loads(ring_map().map_json)["aligned"] is None


def test_marks_of_a_map_and_of_its_json_are_the_same() -> None:
    marks, read = take_marks(decode_map(ring_map().drawing)), read_marks(ring_map().map_json, source="it")
    assert marks.key == read.key
    assert np.allclose(marks.xy, read.xy)
    assert [list(rows) for rows in shared_marks(marks, read)] == [list(rows) for rows in shared_marks(read, marks)][::-1]
    assert [fit.n_shared for fit in fit_components(marks, read)] == [len(marks)]


@given(places=st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), min_size=3, max_size=12), motion=TURNS)
@settings(max_examples=25)
def test_one_mark_that_is_elsewhere_does_not_turn_the_others(places: list[tuple[float, float]], motion: Similarity) -> None:
    here = np.array([(0.0, 0.0), (7.0, 0.0), (0.0, 4.0), (9.0, 9.0), (3.0, -8.0), (-9.0, -5.0), (-8.0, 6.0), *places])
    there = motion(here)
    there[0] += 8.0
    assert np.allclose(fit_motion(here, there)(here[1:]), there[1:], atol=1e-6)
