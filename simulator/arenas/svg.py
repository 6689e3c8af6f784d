"""Arenas drawn as SVG: which shapes are the floor and which are in the way.

**The floor** is the union of all shapes labelled ``arena``: by their id, by one of their classes or by their Inkscape label, or those of
a group they are in, in small or capital letters. If none is, it is the largest shape. Whether it is painted does not matter.

**In the way** is every other shape that is filled, whatever its colour, but for one that covers the whole floor: that is a background.
Shapes without fill (lines, dimensions, swings of doors) or hidden are left aside and counted; so are, uncounted, text, pictures and
definitions. Strokes have no width: draw a wall as a shape, not as a line.

**Where it lies.** Lengths are the drawing's user units, those of the viewBox. Its lower left corner is the origin, and up is up: SVG's own
y goes down. Without a viewBox that is the page's corner, and without a page the drawing's own. Curves are cut into straight pieces that
leave them by at most ``CURVE_TOLERANCE`` of the drawing's longer side; corners are rounded to a billionth of it where shapes meet.

``use``, nested ``svg`` and entities are refused, clips and masks ignored.
"""

import math
import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import Never
from xml.parsers import expat

import numpy as np
import shapely
import svgelements
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from simulator.arenas.svg_outlines import Outline, OutlineError, parse_path
from simulator.arenas.svg_style import Stylesheet, read_declarations
from simulator.errors import ArenaError

Floats = NDArray[np.float64]

CURVE_TOLERANCE = 1e-4
_GRID_OF_EXTENT = 1e-9

_SVG = "http://www.w3.org/2000/svg"
_INKSCAPE_LABEL = "http://www.inkscape.org/namespaces/inkscape label"
_GROUPS = frozenset({"svg", "g", "a", "switch"})
_SHAPES = frozenset({"path", "rect", "circle", "ellipse", "polygon", "polyline", "line"})
_MAX_DEPTH = 200
_MAX_SHAPES = 50_000
_MAX_COORDINATE = 1e9

# CSS Values and Units 3, 5.2, at 96 pixels an inch.
_UNITS = {"": 1.0, "px": 1.0, "in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "q": 96 / 101.6, "pt": 96 / 72, "pc": 16.0}
_LENGTH = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zA-Z]*|%)\s*")
_TRANSFORM = re.compile(r"[\s,]*(matrix|translate|scale|rotate|skewX|skewY)\s*\(([^()]*)\)[\s,]*")
_TRANSFORM_ARGUMENTS = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}


def read_svg(content: bytes, *, source: str) -> tuple[Polygon | MultiPolygon, dict[str, int]]:
    """Read a drawing.

    Returns
    -------
    shape, counts
        The floor less what is in the way [user units], and how many shapes were left aside.

    Raises
    ------
    ArenaError
        It is no well-formed SVG, has a faulty or unsupported element (the message tells the line), or no floor is left.
    """
    reader = _Reader(source)
    reader.parse(content)
    return reader.build()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Context:
    """What an element hands down to those in it."""

    matrix: Floats
    properties: dict[str, str]
    is_arena: bool = False
    is_skipped: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Shape:
    outline: Outline
    is_arena: bool
    is_filled: bool
    line: int


class _Reader:
    """Takes the elements of a drawing as the parser meets them."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._parser = expat.ParserCreate(namespace_separator=" ")
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._begin
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._take_text
        self._parser.EntityDeclHandler = self._refuse_entity
        self._stack = [_Context(matrix=np.eye(3)[:2], properties={})]
        self._style_text: list[str] | None = None
        self._stylesheet = Stylesheet()
        self._shapes: list[_Shape] = []
        self._counts: Counter[str] = Counter()
        self._viewport: tuple[float, float, float, float] | None = None

    def parse(self, content: bytes) -> None:
        try:
            self._parser.Parse(content, True)  # noqa: FBT003  # expat takes no keyword
        except expat.ExpatError as error:
            what = expat.errors.messages[error.code]
            problem = f"not well-formed XML: {what} in line {error.lineno}, column {error.offset + 1}; give an SVG drawing"
            raise ArenaError(source=self._source, problem=problem) from error

    def build(self) -> tuple[Polygon | MultiPolygon, dict[str, int]]:
        if not self._shapes:
            raise ArenaError(source=self._source, problem="the drawing holds no shape with an area; draw the floor as a closed shape")
        corners = np.vstack([shape.outline.control_points() for shape in self._shapes])
        extent = float(np.ptp(corners, axis=0).max())
        if not (math.isfinite(extent) and extent > 0):
            raise ArenaError(source=self._source, problem=f"the drawing is {extent:g} wide; draw the floor as a closed shape")
        areas = [self._fill(shape, tolerance=CURVE_TOLERANCE * extent) for shape in self._shapes]
        is_floor = np.array([shape.is_arena for shape in self._shapes])
        if not is_floor.any():
            is_floor[int(np.argmax([area.area for area in areas]))] = True
        floor = shapely.union_all([areas[k] for k in np.flatnonzero(is_floor)])
        is_solid = ~is_floor & np.array([shape.is_filled for shape in self._shapes])
        is_solid &= ~shapely.covers(areas, floor)
        self._counts["shapes_ignored"] += int(np.sum(~is_floor & ~is_solid))
        free = self._subtract([areas[k] for k in np.flatnonzero(is_floor)], [areas[k] for k in np.flatnonzero(is_solid)], extent=extent)
        left, bottom = (corners[:, 0].min(), corners[:, 1].max()) if self._viewport is None else self._lower_left(self._viewport)
        return shapely.transform(free, lambda places: np.column_stack([places[:, 0] - left, bottom - places[:, 1]])), dict(self._counts)

    def _subtract(
        self, floor: list[Polygon | MultiPolygon], solid: list[Polygon | MultiPolygon], *, extent: float
    ) -> Polygon | MultiPolygon:
        if len(floor) == 1 and not solid:
            free: shapely.Geometry = floor[0]
        else:
            # On a grid, sides drawn to coincide do so, and leave no slivers.
            grid = 10.0 ** math.floor(math.log10(_GRID_OF_EXTENT * extent))
            free = shapely.difference(shapely.union_all(floor, grid_size=grid), shapely.union_all(solid, grid_size=grid), grid_size=grid)
        parts = [part for part in shapely.get_parts(free).tolist() if isinstance(part, Polygon) and part.area > 0]
        if not parts:
            raise ArenaError(
                source=self._source, problem="nothing of the floor is left free; label the floor's shape 'arena' (id or class)"
            )
        return parts[0] if len(parts) == 1 else MultiPolygon(parts)

    def _fill(self, shape: _Shape, *, tolerance: float) -> Polygon | MultiPolygon:
        try:
            return shape.outline.fill(tolerance=tolerance)
        except OutlineError as error:
            raise ArenaError(source=self._source, problem=f"line {shape.line}: {error}") from error

    @staticmethod
    def _lower_left(viewport: tuple[float, float, float, float]) -> tuple[float, float]:
        x, y, _, height = viewport
        return x, y + height

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        above = self._stack[-1]
        if len(self._stack) > _MAX_DEPTH:
            self._fault(f"elements are nested more than {_MAX_DEPTH} deep; ungroup the drawing")
        namespace, _, tag = name.rpartition(" ")
        if len(self._stack) == 1:
            if tag != "svg" or namespace not in {_SVG, ""}:
                self._fault(f"the outermost element is <{tag}>; wanted <svg>")
            self._viewport = self._read_viewport(attributes)
        elif tag == "svg":
            self._fault("an <svg> within the drawing is not supported; ungroup it")
        if tag == "style" and namespace in {_SVG, ""}:
            self._style_text = []
        if namespace not in {_SVG, ""} or tag not in _GROUPS | _SHAPES | {"use"} or above.is_skipped:
            self._stack.append(replace(above, is_skipped=True))
            return
        if tag == "use":
            self._fault("<use> is not supported; turn clones into shapes of their own (Inkscape: Edit, Clone, Unlink)")
        self._stack.append(self._inherit(above, tag, attributes))
        if tag in _SHAPES and not self._stack[-1].is_skipped:
            self._take_shape(tag, attributes, self._stack[-1])

    def _end(self, name: str) -> None:
        self._stack.pop()
        if name.rpartition(" ")[2] == "style" and self._style_text is not None:
            self._stylesheet.add("".join(self._style_text))
            self._style_text = None

    def _take_text(self, text: str) -> None:
        if self._style_text is not None:
            self._style_text.append(text)

    def _refuse_entity(self, name: str, *_: object) -> None:
        self._fault(f"it declares the entity {name!r}, which is not supported; save it as plain SVG, without a document type")

    def _inherit(self, above: _Context, tag: str, attributes: dict[str, str]) -> _Context:
        classes = attributes.get("class", "").split()
        own: dict[str, str] = {name: attributes[name] for name in ("fill", "fill-rule", "display", "visibility") if name in attributes}
        own |= self._stylesheet.find(tag=tag, classes=classes, identity=attributes.get("id"))
        own |= read_declarations(attributes.get("style", ""))
        own = {name: value for name, value in own.items() if value != "inherit"}
        properties = above.properties | own
        labels = {attributes.get("id", ""), attributes.get(_INKSCAPE_LABEL, ""), *classes}
        return _Context(
            matrix=self._transform(above.matrix, attributes.get("transform", "")),
            properties=properties,
            is_arena=above.is_arena or any(label.lower() == "arena" for label in labels),
            is_skipped=own.get("display") == "none",
        )

    def _take_shape(self, tag: str, attributes: dict[str, str], context: _Context) -> None:
        properties = context.properties
        if tag == "line" or properties.get("visibility") in {"hidden", "collapse"}:
            self._counts["shapes_ignored"] += 1
            return
        if len(self._shapes) == _MAX_SHAPES:
            self._fault(f"the drawing has more than {_MAX_SHAPES} shapes; leave out what is no wall")
        path = self._read_path(tag, attributes)
        if path is None or not len(path):
            self._counts["shapes_ignored"] += 1
            return
        outline = Outline(path=path, matrix=context.matrix, is_even_odd=properties.get("fill-rule", "nonzero") == "evenodd")
        if not (np.abs(outline.control_points()) <= _MAX_COORDINATE).all():
            self._fault(f"<{tag}> reaches beyond {_MAX_COORDINATE:g} units; wanted a smaller drawing")
        is_filled = properties.get("fill", "black") not in {"none", "transparent"}
        self._shapes.append(_Shape(outline=outline, is_arena=context.is_arena, is_filled=is_filled, line=self._parser.CurrentLineNumber))

    def _read_path(self, tag: str, attributes: dict[str, str]) -> svgelements.Path | None:
        """Turn a shape into a path; None for one without extent, which is not drawn ([SVG2] 10)."""
        if tag == "path":
            try:
                return parse_path(attributes.get("d", ""))
            except OutlineError as error:
                self._fault(f"<path>: {error}")
        if tag in {"polygon", "polyline"}:
            numbers = self._numbers(attributes.get("points", ""), where=f"<{tag}> points")
            if len(numbers) % 2:
                self._fault(f"<{tag}> has {len(numbers)} numbers in points; wanted an even number")
            return svgelements.Path(svgelements.Polygon(*zip(numbers[::2], numbers[1::2], strict=True))) if len(numbers) >= 6 else None
        names = {"rect": ("width", "height"), "circle": ("r",), "ellipse": ("rx", "ry")}[tag]
        sizes = [self._length(attributes.get(name, "0"), axis=axis, where=f"<{tag}> {name}") for axis, name in enumerate(names)]
        if any(size < 0 for size in sizes):
            self._fault(f"<{tag}> has the size {sizes}; wanted none negative")
        if not all(sizes):
            return None
        corner = ("x", "y") if tag == "rect" else ("cx", "cy")
        x, y = (self._length(attributes.get(name, "0"), axis=axis, where=f"<{tag}> {name}") for axis, name in enumerate(corner))
        if tag == "rect":
            rx, ry = self._corner_radii(attributes, sizes)
            return svgelements.Path(svgelements.Rect(x, y, *sizes, rx, ry))
        return svgelements.Path(svgelements.Ellipse(cx=x, cy=y, rx=sizes[0], ry=sizes[-1]))

    def _corner_radii(self, attributes: dict[str, str], sizes: list[float]) -> tuple[float, float]:
        given = {
            name: self._length(attributes[name], axis=axis, where=f"<rect> {name}")
            for axis, name in enumerate(("rx", "ry"))
            if attributes.get(name, "auto") != "auto"
        }
        rx, ry = given.get("rx", given.get("ry", 0.0)), given.get("ry", given.get("rx", 0.0))
        return min(max(rx, 0.0), sizes[0] / 2), min(max(ry, 0.0), sizes[1] / 2)

    def _read_viewport(self, attributes: dict[str, str]) -> tuple[float, float, float, float] | None:
        if "viewBox" in attributes:
            numbers = self._numbers(attributes["viewBox"], where="viewBox")
            if len(numbers) != 4 or min(numbers[2:]) <= 0:
                self._fault(f"viewBox is {attributes['viewBox']!r}; wanted x, y, a positive width and height")
            return numbers[0], numbers[1], numbers[2], numbers[3]
        sizes = [attributes.get(name, "100%") for name in ("width", "height")]
        if any(size.strip().endswith("%") or size.strip() == "auto" for size in sizes):
            return None
        width, height = (self._length(size, axis=axis, where="<svg> size") for axis, size in enumerate(sizes))
        return 0.0, 0.0, width, height

    def _length(self, text: str, *, axis: int, where: str) -> float:
        found = _LENGTH.fullmatch(text)
        unit = "" if found is None else found.group(2).lower()
        if found is None or (unit not in _UNITS and not (unit == "%" and self._viewport is not None)):
            self._fault(f"{where} is {text[:40]!r}; wanted a number, with px, mm, cm, in, pt, pc or nothing after it")
        value = float(found.group(1)) * (
            self._viewport[2 + axis] / 100 if unit == "%" and self._viewport is not None else _UNITS.get(unit, 1.0)
        )
        if not math.isfinite(value):
            self._fault(f"{where} is {text[:40]!r}; wanted a finite number")
        return value

    def _numbers(self, text: str, *, where: str) -> list[float]:
        numbers = []
        for word in re.findall(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[^\s,]", text):
            try:
                number = float(word)
            except ValueError:
                number = math.nan
            if not math.isfinite(number):
                self._fault(f"{where} has {word[:20]!r}; wanted finite numbers")
            numbers.append(number)
        return numbers

    def _transform(self, above: Floats, text: str) -> Floats:
        at, matrix = 0, above
        while at < len(text.rstrip()):
            found = _TRANSFORM.match(text, at)
            if found is None:
                self._fault(f"transform has {text[at : at + 30]!r}; wanted matrix, translate, scale, rotate, skewX or skewY with numbers")
            numbers = self._numbers(found.group(2), where=f"transform {found.group(1)}")
            if len(numbers) not in _TRANSFORM_ARGUMENTS[found.group(1)]:
                self._fault(f"transform {found.group(1)} has {len(numbers)} numbers; wanted {_TRANSFORM_ARGUMENTS[found.group(1)]}")
            step = svgelements.Matrix(f"{found.group(1)}({' '.join(map(repr, numbers))})")
            own = np.array([(step.a, step.c, step.e), (step.b, step.d, step.f), (0.0, 0.0, 1.0)], dtype=np.float64)
            matrix, at = matrix @ own, found.end()
        return matrix

    def _fault(self, problem: str) -> Never:
        raise ArenaError(source=self._source, problem=f"line {self._parser.CurrentLineNumber}: {problem}")
