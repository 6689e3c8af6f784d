"""A map goes through bytes and comes back, so that it can be drawn in another process or after a restart."""

import msgspec
import numpy as np
import pytest

from mapper.config import RecipeConfig, make_recipe
from mapper.map_codec import decode_map, encode_map
from mapper.pipeline import compute_map
from mapper.render import render_map
from mapper.window import make_encounter_table
from tests.mapper.worlds import walk_track


def test_a_map_comes_back_whole_but_for_the_distances() -> None:
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    start, end, first, second = np.array(rows).T
    result = compute_map(
        make_encounter_table(t_start_ns=start, t_end_ns=end, id1=first, id2=second), spells, make_recipe(RecipeConfig(speed_mps=2.0))
    )
    again = decode_map(encode_map(result))
    assert [part.distances.shape for part in again.components] == [(0, 0)] * len(result.components)
    assert encode_map(again) == encode_map(result)
    assert again.recipe == result.recipe
    assert again.points.x.tolist() == result.points.x.tolist()
    assert again.triangles.shape == result.triangles.shape
    assert again.holes[0].outline.tolist() == result.holes[0].outline.tolist()
    assert render_map(again, image_format="svg") == render_map(result, image_format="svg")


@pytest.mark.parametrize(
    "data", [b"", b"\x80", b"\xc1", msgspec.msgpack.encode({"betti_numbers": [1, 1], "edges": ["<c16", [1], b"x" * 16]})]
)
def test_bytes_that_are_no_map_are_refused(data: bytes) -> None:
    with pytest.raises(msgspec.DecodeError):
        decode_map(data)


def test_a_map_of_a_version_that_did_not_say_how_sure_it_was_is_read() -> None:
    rows, spells = walk_track(n_landmarks=12, n_walkers=12, duration_s=60, seed=4, is_ring=True)
    start, end, first, second = np.array(rows).T
    result = compute_map(make_encounter_table(t_start_ns=start, t_end_ns=end, id1=first, id2=second), spells, make_recipe(RecipeConfig()))
    content = msgspec.msgpack.decode(encode_map(result))
    for name in ("hole_count", "possible_holes", "data"):
        del content[name]
    del content["points"]["is_well_seen"], content["recipe"]["replicates"]
    for item in content["components"]:
        del item["stability_band"]
    for item in content["holes"]:
        del item["probability"]
    again = decode_map(msgspec.msgpack.encode(content))
    assert (again.hole_count, again.possible_holes, again.data, again.points.is_well_seen) == (None, (), None, None)
    assert [hole.probability for hole in again.holes] == [None] * len(result.holes)
    assert again.points.x.tolist() == result.points.x.tolist()
