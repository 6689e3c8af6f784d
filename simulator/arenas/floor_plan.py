"""Floor plans: black-and-white PNG pictures, traced along the edges of their pixels.

**What is free.** A pixel at least half as bright as white is free, any other is wall; transparent pixels count as lying on white. What is
white outside a building is free as well: paint it black. The edge of the picture is a wall.

**What is joined.** Insects cannot pass between two wall pixels that touch by their corners: free pixels are joined by their sides (four
neighbours), wall pixels by sides and corners (eight). Specks, fewer than ``MIN_PIXELS`` pixels of one kind in the midst of the other, are
taken for dirt and painted over, first the walls, then the free ones.

**Where it lies.** One pixel is one unit; the lower left corner of the picture is the origin, and up is up.
"""

import io
import warnings

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from scipy import ndimage
from shapely.geometry import LinearRing, MultiPolygon, Polygon

from simulator.errors import ArenaError

Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

MIN_PIXELS = 4

# A picture of this many pixels takes some seconds and most of a gigabyte.
_MAX_PIXELS = 4096 * 4096
# Sides of pixels between free and wall: beyond this it is no floor plan but a photograph or noise.
_MAX_EDGES = 2_000_000

_SIDES = ndimage.generate_binary_structure(2, 1)
_SIDES_AND_CORNERS = ndimage.generate_binary_structure(2, 2)


def read_floor_plan(content: bytes, *, source: str) -> tuple[Polygon | MultiPolygon, dict[str, int]]:
    """Trace the free area of a picture.

    Parameters
    ----------
    content
        The bytes of a PNG file: grey, colour or palette, 1 to 16 bits, with or without transparency.

    Returns
    -------
    shape, counts
        The area [pixels], and how many specks were painted over.

    Raises
    ------
    ArenaError
        It is no PNG picture, broken, too large, without any free pixel, or too intricate.
    """
    free, counts = remove_specks(_find_free(content, source=source))
    if not free.any():
        raise ArenaError(
            source=source, problem="no pixel is free: all are darker than half of white; paint the floor white, the walls black"
        )
    return trace(free, source=source), counts


def remove_specks(free: Bools) -> tuple[Bools, dict[str, int]]:
    """Paint over specks of wall in what is free, then of what is free in the walls; return a new picture and the number of specks.

    A speck of wall at the edge of the picture goes too.
    """
    free, n_walls = _absorb(~free, structure=_SIDES_AND_CORNERS)
    solid, n_gaps = _absorb(free, structure=_SIDES)
    return ~solid, {"specks_removed": n_walls + n_gaps}


def trace(free: Bools, *, source: str = "picture") -> Polygon | MultiPolygon:
    """Turn the free pixels (shape (rows, columns), first row on top) into polygons along the sides of pixels, corners only.

    Raises
    ------
    ArenaError
        There are too many sides between free and wall.
    """
    label, _ = ndimage.label(free, structure=_SIDES)
    padded = np.pad(label[::-1].astype(np.int32), 1)  # the first row is the lowest now: row r of the picture lies between y = r and r + 1
    vertex, heading, owner = _directed_edges(padded, source=source)
    rings, owners = _link(vertex, heading, owner, width=padded.shape[1])
    outer: dict[int, LinearRing] = {}
    inner: dict[int, list[LinearRing]] = {}
    for outline, mark in zip(map(LinearRing, rings), owners, strict=True):
        if outline.is_ccw:
            outer[mark] = outline
        else:
            inner.setdefault(mark, []).append(outline)
    parts = [Polygon(outer[mark], inner.get(mark)) for mark in sorted(outer)]
    return parts[0] if len(parts) == 1 else MultiPolygon(parts)


def _find_free(content: bytes, *, source: str) -> Bools:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of large pictures; the limit here is lower than where it does
            picture = Image.open(io.BytesIO(content), formats=["PNG"])
            columns, rows = picture.size
            if columns * rows > _MAX_PIXELS:
                problem = f"its picture has {columns} x {rows} pixels; wanted at most {_MAX_PIXELS} in all: scale it down"
                raise ArenaError(source=source, problem=problem)
            picture.load()
    except UnidentifiedImageError as error:
        raise ArenaError(source=source, problem="not a PNG picture; save the floor plan as PNG") from error
    except Image.DecompressionBombError as error:
        raise ArenaError(source=source, problem=f"its picture is far too large; wanted at most {_MAX_PIXELS} pixels") from error
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise ArenaError(source=source, problem=f"a broken PNG picture: {error}; save it anew") from error
    if picture.mode.startswith("I"):  # 16 bits of grey, which Pillow's conversions would cut off
        grey = np.asarray(picture, dtype=np.int32)
        is_free: Bools = 2 * grey >= 65_535
        transparent = picture.info.get("transparency")
        return is_free | (grey == transparent) if isinstance(transparent, int) else is_free
    red, green, blue, alpha = (np.asarray(band, dtype=np.int32) for band in picture.convert("RGBA").split())
    # ITU-R BT.601 luma in thousandths, over white.
    luma = red * 299 + green * 587 + blue * 114
    return np.asarray(2 * (luma * alpha + 255_000 * (255 - alpha)) >= 255_000 * 255)


def _absorb(marked: Bools, *, structure: Bools) -> tuple[Bools, int]:
    """Unmark groups of fewer than ``MIN_PIXELS``; return what is then *not* marked, and how many groups went."""
    label, count = ndimage.label(marked, structure=structure)
    size = np.bincount(label.ravel(), minlength=count + 1)
    is_small = size < MIN_PIXELS
    is_small[0] = False
    return ~marked | is_small[label], int(is_small.sum())


def _directed_edges(label: NDArray[np.int32], *, source: str) -> tuple[Indices, Indices, Indices]:
    """List the sides between pixels of different label, once for each label but 0, so that the label is on the left.

    Returns
    -------
    vertex, heading, owner
        Number of the grid corner where each begins, its heading (0 right, 1 up, 2 left, 3 down), and its label, shape (n_edges,).
    """
    width = label.shape[1]
    found = []
    # A pixel of row r and column c has the corners (r, c), lower left, to (r + 1, c + 1).
    for heading, (below, right, rows, columns) in enumerate([(1, 0, 0, 0), (0, -1, 0, 1), (-1, 0, 1, 1), (0, 1, 1, 0)]):
        differs = (label != 0) & (label != np.roll(label, (below, right), axis=(0, 1)))
        row, column = np.nonzero(differs)
        found.append(((row + rows) * width + column + columns, np.full(row.size, heading), label[row, column].astype(np.int64)))
    n_edges = sum(part[0].size for part in found)
    if n_edges > _MAX_EDGES:
        problem = f"its outlines have {n_edges} pixel sides; wanted at most {_MAX_EDGES}: give a plan in black and white, without shading"
        raise ArenaError(source=source, problem=problem)
    vertex, heading_, owner = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return vertex, heading_, owner


def _link(vertex: Indices, heading: Indices, owner: Indices, *, width: int) -> tuple[list[NDArray[np.float64]], list[int]]:
    """Follow edges to closed rings of corners, and tell whose each is.

    Where four edges of one label meet in a corner, its two wall pixels touch there: the way turns right, so that each wall keeps a ring of
    its own and no ring touches itself.
    """
    step = np.array([1, width, -1, -width])
    by_start: dict[tuple[int, int], list[int]] = {}
    for edge, key in enumerate(zip(owner.tolist(), vertex.tolist(), strict=True)):
        by_start.setdefault(key, []).append(edge)
    ends, headings, owners_of = (vertex + step[heading]).tolist(), heading.tolist(), owner.tolist()
    is_used = bytearray(len(ends))
    rings, owners = [], []
    for first in range(len(ends)):
        if is_used[first]:
            continue
        corners, edge = [], first
        while True:
            is_used[edge] = 1
            going = by_start[owners_of[edge], ends[edge]]
            following = going[0]
            if len(going) > 1:
                right = (headings[edge] - 1) % 4
                following = going[0] if headings[going[0]] == right else going[1]
            if headings[following] != headings[edge]:
                corners.append(ends[edge])
            if following == first:
                break
            edge = following
        at = np.array(corners, dtype=np.int64)
        # The picture was padded by one pixel on each side.
        rings.append(np.column_stack([at % width - 1, at // width - 1]).astype(np.float64))
        owners.append(owners_of[first])
    return rings, owners
