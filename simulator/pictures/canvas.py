"""A picture made of Unicode braille dots, two across and four down in every cell of a terminal: arrays in, text out.

Where several things share a cell, all their dots are set and the cell has the colour of the one that ranks highest.
"""

import itertools
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Unicode 15.0, chapter 21.1: the block begins at U+2800, and dots 1 to 8 are bits 0 to 7, numbered down the left column (1, 2, 3),
# down the right one (4, 5, 6), and then across the row that came later (7, 8).
_BLANK = 0x2800
_DOT_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
DOTS_ACROSS, DOTS_DOWN = 2, 4


class Ink(IntEnum):
    """What is drawn, from what ranks lowest in a shared cell to what ranks highest."""

    NONE = 0
    WALL = 1
    WALKING = 2
    RESTING = 3
    LANDMARK = 4
    MEETING = 5


# ECMA-48 SGR with colours of xterm's 256: they read on black and on white and are apart for the common colour vision deficiencies. A
# meeting is told by its background, a landmark by its shape.
_STYLES = {
    Ink.WALL: "38;5;244",
    Ink.WALKING: "38;5;32",
    Ink.RESTING: "38;5;172",
    Ink.LANDMARK: "1;38;5;133",
    Ink.MEETING: "1;38;5;231;48;5;160",
}
_RESET = "\x1b[0m"


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """How lengths become dots: to scale, as large as fits, in the middle, with y upwards.

    Parameters
    ----------
    x_min, y_max
        The corner that lies at the left end of the top row [length].
    dots_per_length
        Scale [1/length].
    left, top
        Dots free before that corner.
    """

    x_min: float
    y_max: float
    dots_per_length: float
    left: int
    top: int


def fit_view(bounds: tuple[float, float, float, float], *, columns: int, rows: int) -> View:
    """Fit an area (smallest x and y, largest x and y [length]) into a canvas of so many cells."""
    x_min, y_min, x_max, y_max = bounds
    across, down = columns * DOTS_ACROSS - 1, rows * DOTS_DOWN - 1
    width, height = x_max - x_min, y_max - y_min
    scale = min(across / width if width > 0 else np.inf, down / height if height > 0 else np.inf)
    scale = float(scale) if np.isfinite(scale) else 1.0
    return View(
        x_min=x_min, y_max=y_max, dots_per_length=scale, left=int((across - width * scale) / 2), top=int((down - height * scale) / 2)
    )


class Canvas:
    """Dots in so many columns and rows of cells.

    Parameters
    ----------
    view
        How lengths become dots; what falls outside the canvas is left out.
    """

    __slots__ = ("_dots", "_ink", "_view")

    def __init__(self, view: View, *, columns: int, rows: int) -> None:
        self._view = view
        self._dots = np.zeros((rows, columns), dtype=np.uint8)
        self._ink = np.zeros((rows, columns), dtype=np.uint8)

    def copy(self) -> "Canvas":
        """Return a canvas with the same dots, to draw on further."""
        twin = Canvas(self._view, columns=self._dots.shape[1], rows=self._dots.shape[0])
        twin._dots[:], twin._ink[:] = self._dots, self._ink
        return twin

    def draw_points(self, points: Floats, ink: Ink, *, size: int = 1) -> None:
        """Set a square of ``size`` dots at each point, shape (k, 2) [length]."""
        column, row = self._to_dots(np.asarray(points, dtype=np.float64).reshape(-1, 2))
        for right in range(size):
            for below in range(size):
                self._set(column + right, row + below, ink)

    def draw_lines(self, start: Floats, end: Floats, ink: Ink) -> None:
        """Set the dots of straight lines between points of shape (k, 2) [length]."""
        if not len(start):
            return
        first, last = np.stack(self._to_dots(start)), np.stack(self._to_dots(end))
        steps = np.abs(last - first).max(axis=0)
        for k, count in enumerate(steps.tolist()):
            along = np.linspace(0.0, 1.0, count + 1)
            column, row = np.rint(first[:, k, None] + along * (last - first)[:, k, None]).astype(np.int64)
            self._set(column, row, ink)

    def lines(self, *, is_coloured: bool) -> list[str]:
        """Return the text of each row: one character a cell, with colours as escape sequences between them if asked for."""
        text = []
        for dots, inks in zip(self._dots, self._ink, strict=True):
            characters = [chr(_BLANK + bits) for bits in dots.tolist()]
            text.append(_coloured(characters, inks) if is_coloured else "".join(characters))
        return text

    def _to_dots(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        view = self._view
        column = np.rint((points[:, 0] - view.x_min) * view.dots_per_length).astype(np.int64) + view.left
        row = np.rint((view.y_max - points[:, 1]) * view.dots_per_length).astype(np.int64) + view.top
        return column, row

    def _set(self, column: NDArray[np.int64], row: NDArray[np.int64], ink: Ink) -> None:
        rows, columns = self._dots.shape
        inside = (column >= 0) & (column < columns * DOTS_ACROSS) & (row >= 0) & (row < rows * DOTS_DOWN)
        column, row = column[inside], row[inside]
        cell = row // DOTS_DOWN, column // DOTS_ACROSS
        np.bitwise_or.at(self._dots, cell, _DOT_BITS[row % DOTS_DOWN, column % DOTS_ACROSS])
        np.maximum.at(self._ink, cell, np.uint8(ink))


def paint(text: str, ink: Ink) -> str:
    """Return a text in the colour of an ink."""
    return text if ink is Ink.NONE else f"\x1b[{_STYLES[ink]}m{text}{_RESET}"


def _coloured(characters: list[str], inks: NDArray[np.uint8]) -> str:
    groups = itertools.groupby(zip(characters, inks.tolist(), strict=True), key=lambda cell: cell[1])
    return "".join(paint("".join(character for character, _ in cells), Ink(ink)) for ink, cells in groups)
