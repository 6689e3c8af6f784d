"""Laws of the braille canvas: known shapes set known dots."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.pictures.canvas import Canvas, Ink, View, fit_view, paint

# One dot a length, the corner of the canvas at (0, 7): y from 7 down to 0 on two rows of cells.
UNIT = View(x_min=0.0, y_max=7.0, dots_per_length=1.0, left=0, top=0)


def points(*pairs: tuple[float, float]) -> np.ndarray:
    return np.array(pairs, dtype=np.float64)


def unit_canvas() -> Canvas:
    return Canvas(UNIT, columns=2, rows=2)


def dots(text: list[str]) -> set[tuple[int, int]]:
    """Read text back, dot by dot, from Unicode's numbering: (column, row)."""
    places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)]
    return {
        (2 * column + across, 4 * row + down)
        for row, line in enumerate(text)
        for column, character in enumerate(line)
        for bit, (across, down) in enumerate(places)
        if (ord(character) - 0x2800) >> bit & 1
    }


def test_each_dot_of_a_cell_has_its_own_character() -> None:
    characters = []
    for y in (7, 6, 5, 4):
        for x in (0, 1):
            canvas = unit_canvas()
            canvas.draw_points(points((x, y)), Ink.WALKING)
            characters.append(canvas.lines(is_coloured=False)[0][0])
    assert "".join(characters) == "⠁⠈⠂⠐⠄⠠⡀⢀"


def test_a_full_cell_is_a_full_character() -> None:
    canvas = unit_canvas()
    canvas.draw_points(points(*((x, y) for x in (0, 1) for y in (4, 5, 6, 7))), Ink.WALL)
    assert canvas.lines(is_coloured=False) == ["⣿⠀", "⠀⠀"]


def test_a_box_is_its_outline() -> None:
    canvas = unit_canvas()
    corners = points((0, 0), (3, 0), (3, 7), (0, 7))
    canvas.draw_lines(corners, np.roll(corners, -1, axis=0), Ink.WALL)
    assert dots(canvas.lines(is_coloured=False)) == {(x, y) for x in range(4) for y in range(8) if x in {0, 3} or y in {0, 7}}


def test_a_diagonal_has_a_dot_in_every_row() -> None:
    canvas = unit_canvas()
    canvas.draw_lines(points((0, 0)), points((3, 7)), Ink.WALL)
    assert len(dots(canvas.lines(is_coloured=False))) == 8


def test_a_landmark_is_a_square_of_dots() -> None:
    canvas = unit_canvas()
    canvas.draw_points(points((1, 5)), Ink.LANDMARK, size=2)
    assert dots(canvas.lines(is_coloured=False)) == {(1, 2), (2, 2), (1, 3), (2, 3)}


def test_what_lies_outside_is_left_out() -> None:
    canvas = unit_canvas()
    canvas.draw_points(points((-1, 0), (4, 0), (0, 8), (0, -1), (1e6, 1e6)), Ink.WALKING)
    assert canvas.lines(is_coloured=False) == ["⠀⠀", "⠀⠀"]


def test_the_highest_ink_colours_a_shared_cell_in_any_order() -> None:
    texts = []
    for inks in ((Ink.WALL, Ink.MEETING), (Ink.MEETING, Ink.WALL)):
        canvas = unit_canvas()
        for x, ink in enumerate(inks):
            canvas.draw_points(points((x, 7)), ink)
        texts.append(canvas.lines(is_coloured=True)[0])
    assert texts[0] == texts[1] == paint("⠉", Ink.MEETING) + "⠀"


def test_without_colours_there_is_no_escape_sequence() -> None:
    canvas = unit_canvas()
    canvas.draw_points(points((0, 7)), Ink.MEETING)
    assert "\x1b" not in "".join(canvas.lines(is_coloured=False))
    assert "\x1b" in "".join(canvas.lines(is_coloured=True))


def test_drawing_on_a_copy_leaves_the_canvas_as_it_was() -> None:
    canvas = unit_canvas()
    canvas.copy().draw_points(points((0, 7)), Ink.WALKING)
    assert canvas.lines(is_coloured=True) == ["⠀⠀", "⠀⠀"]


@settings(max_examples=40)
@given(
    columns=st.integers(1, 200),
    rows=st.integers(1, 60),
    corner=st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
    size=st.tuples(st.floats(1e-2, 1e4), st.floats(1e-2, 1e4)),
    shares=st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=5),
)
def test_all_of_an_area_fits_into_its_canvas(
    columns: int, rows: int, corner: tuple[float, float], size: tuple[float, float], shares: list[tuple[float, float]]
) -> None:
    bounds = (*corner, corner[0] + size[0], corner[1] + size[1])
    view = fit_view(bounds, columns=columns, rows=rows)
    for share in [*shares, (0.0, 0.0), (1.0, 1.0)]:
        canvas = Canvas(view, columns=columns, rows=rows)
        canvas.draw_points(points((corner[0] + share[0] * size[0], corner[1] + share[1] * size[1])), Ink.WALKING)
        assert len(dots(canvas.lines(is_coloured=False))) == 1


def test_an_area_without_extent_still_has_a_view() -> None:
    assert fit_view((1.0, 1.0, 1.0, 1.0), columns=10, rows=10).dots_per_length == pytest.approx(1.0)
