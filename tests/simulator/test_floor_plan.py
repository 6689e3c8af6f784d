"""Laws of floor plans: what is traced is what is white, joined as insects can walk."""

import io
import struct
import zlib

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from simulator.arenas import floor_plan
from simulator.arenas.arena import build_arena
from simulator.arenas.floor_plan import read_floor_plan, remove_specks, trace
from simulator.errors import ArenaError

Bools = NDArray[np.bool_]

PICTURES = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=9)).filter(lambda free: bool(free.any()))


def to_png(picture: Image.Image, **options: object) -> bytes:
    file = io.BytesIO()
    picture.save(file, "png", **options)
    return file.getvalue()


def draw(*rows: str) -> Bools:
    return np.array([[mark != "#" for mark in row] for row in rows])


@given(PICTURES)
def test_a_traced_plan_covers_the_free_pixels_and_no_others(free: Bools) -> None:
    arena = build_arena(trace(free))
    row, column = np.indices(free.shape)
    centres = np.column_stack([column.ravel() + 0.5, free.shape[0] - row.ravel() - 0.5])
    assert np.array_equal(shapely.contains_xy(arena.polygon, *centres.T), free.ravel())
    assert arena.area == free.sum()


@given(PICTURES)
def test_free_pixels_are_joined_by_sides_and_walls_by_corners_too(free: Bools) -> None:
    """The walls but for that around the picture are the holes: what touches it, or each other, by a corner is one."""
    betti = build_arena(trace(free)).betti
    _, components = ndimage.label(free)
    _, walls = ndimage.label(np.pad(~free, 1, constant_values=True), structure=np.ones((3, 3)))
    assert (betti.components, betti.holes) == (components, walls - 1)


@given(PICTURES)
def test_no_corner_lies_within_a_straight_wall(free: Bools) -> None:
    for ring in shapely.get_rings(trace(free)).tolist():
        steps = np.diff(shapely.get_coordinates(ring), axis=0)
        following = np.roll(steps, -1, axis=0)
        assert np.all(steps[:, 0] * following[:, 1] != steps[:, 1] * following[:, 0])


def test_specks_are_painted_over_and_counted_and_four_pixels_stay() -> None:
    plan = draw("..........", ".#....##..", "..#...##..", ".......###", ".......#.#", ".......###")
    left, counts = remove_specks(plan)
    # Two wall pixels that touch by a corner are one speck, the free pixel in the block another.
    assert counts == {"specks_removed": 2}
    assert np.array_equal(left, draw("..........", "......##..", "......##..", ".......###", ".......###", ".......###"))


@given(PICTURES, st.integers(0, 3))
def test_a_plan_without_specks_stays_as_it_is(free: Bools, turns: int) -> None:
    large = np.rot90(free, turns).repeat(2, axis=0).repeat(2, axis=1)
    left, counts = remove_specks(large)
    assert counts == {"specks_removed": 0}
    assert np.array_equal(left, large)


NOISE = np.random.default_rng(0).integers(0, 256, size=(30, 30), dtype=np.uint8)
GREY = np.tile(np.array([0, 127, 128, 255], dtype=np.uint8), (4, 1))


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGB", "RGBA", "1", "I;16"])
def test_half_of_white_is_free_in_every_kind_of_picture(mode: str) -> None:
    picture = (
        Image.fromarray(GREY.astype(np.uint16) * 257) if mode == "I;16" else Image.fromarray(GREY).convert(mode, dither=Image.Dither.NONE)
    )
    shape, _ = read_floor_plan(to_png(picture), source="plan.png")
    assert shape.area == 8
    assert shape.bounds == (2, 0, 4, 4)


def test_what_is_transparent_lies_on_white() -> None:
    picture = np.zeros((4, 4, 4), dtype=np.uint8)
    picture[:, :2, 3] = 255
    picture[:, 2, 3] = 128  # half black is just darker than half of white
    shape, _ = read_floor_plan(to_png(Image.fromarray(picture)), source="plan.png")
    assert shape.bounds == (3, 0, 4, 4)


def bomb() -> bytes:
    """A picture of 60,000 x 60,000 grey pixels, said in 60 bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "not a PNG picture; save the floor plan as PNG"),
        (b"GIF89a" + bytes(100), "not a PNG picture"),
        (to_png(Image.fromarray(NOISE))[:400], "a broken PNG picture: .*; save it anew"),
        (bomb(), "far too large; wanted at most 16777216 pixels"),
        (to_png(Image.new("1", (4097, 4096))), "has 4097 x 4096 pixels; wanted at most 16777216 in all"),
        (to_png(Image.new("1", (9, 9))), "no pixel is free: all are darker than half of white"),
    ],
    ids=["empty", "GIF", "cut off", "bomb", "large", "black"],
)
def test_a_picture_that_is_no_plan_is_refused_with_what_is_wanted(content: bytes, problem: str) -> None:
    with pytest.raises(ArenaError, match=rf"plan\.png: .*{problem}"):
        read_floor_plan(content, source="plan.png")


def test_a_photograph_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(floor_plan, "_MAX_EDGES", 1_000)
    noise = np.random.default_rng(1).random((60, 60)) < 0.5
    with pytest.raises(ArenaError, match="pixel sides; wanted at most 1000: give a plan in black and white, without shading"):
        trace(noise)
