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
