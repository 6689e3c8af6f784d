"""Mazes with a known number of loops."""

from collections import Counter

import shapely
from shapely.geometry import Polygon, box

from simulator import chance

_WALL_STREAM = 300

_SIDE = 50.0
_CELLS = 6
_WALL = 0.4
_CELL = (_SIDE - (_CELLS - 1) * _WALL) / _CELLS

LOOPS = 4

Cell = tuple[int, int]


def draw_maze(seed: int) -> Polygon:
    """Draw a maze of six by six cells in a square of side 50, with walls 0.4 thick and as many holes as ``LOOPS``.

    The walls between cells are taken in an order drawn by lot. First those fall that join what is apart, until every cell can be reached
    from every other in one way; then ``LOOPS`` more, each of which opens one more way round, and so leaves one more hole. Those that
    would leave a post without any wall are passed over, because a hole of its size is none to an insect.
    """
    walls = [(cell, other) for cell in _cells() for other in ((cell[0] + 1, cell[1]), (cell[0], cell[1] + 1)) if max(other) < _CELLS]
    lots = {wall: chance.uniform(seed=seed, biobot=0, stream=_WALL_STREAM, index=number) for number, wall in enumerate(walls)}
    group = {cell: cell for cell in _cells()}
    doors, standing = [], []
    for cell, other in sorted(walls, key=lots.__getitem__):
        one, two = group[cell], group[other]
        if one == two:
            standing.append((cell, other))
            continue
        doors.append((cell, other))
        group = {name: one if mark == two else mark for name, mark in group.items()}
    loops = _choose_loops(standing)
    floor = shapely.union_all([_room(cell, cell) for cell in _cells()] + [_room(*door) for door in doors + loops])
    assert isinstance(floor, Polygon)
    return floor


def _choose_loops(standing: list[tuple[Cell, Cell]]) -> list[tuple[Cell, Cell]]:
    left = Counter(post for wall in standing for post in _posts(*wall))
    loops: list[tuple[Cell, Cell]] = []
    for wall in standing:
        if len(loops) < LOOPS and all(left[post] > 1 for post in _posts(*wall)):
            loops.append(wall)
            left.subtract(_posts(*wall))
    return loops


def _posts(cell: Cell, other: Cell) -> list[Cell]:
    """Name the inner ends of the wall between two cells: by the cell to the lower left of each."""
    column, row = cell
    ends = [(column, row - 1), (column, row)] if other[0] > column else [(column - 1, row), (column, row)]
    return [end for end in ends if all(0 <= at < _CELLS - 1 for at in end)]


def _cells() -> list[Cell]:
    return [(column, row) for row in range(_CELLS) for column in range(_CELLS)]


def _room(first: Cell, last: Cell) -> Polygon:
    """Return the rectangle from the lower left corner of a cell to the upper right one of another."""
    pitch = _CELL + _WALL
    return box(first[0] * pitch, first[1] * pitch, last[0] * pitch + _CELL, last[1] * pitch + _CELL)
