"""Laws of arenas drawn as SVG."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import MultiPolygon, Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from simulator.arenas.arena import build_arena
from simulator.arenas.svg import CURVE_TOLERANCE, read_svg
from simulator.arenas.svg_outlines import fill_rings
from simulator.errors import ArenaError

PAGE = 'viewBox="0 0 100 50"'
FLOOR = '<rect id="arena" width="100" height="50"/>'


def read(body: str, page: str = PAGE) -> Polygon | MultiPolygon:
    return read_with_counts(body, page)[0]


def read_with_counts(body: str, page: str = PAGE) -> tuple[Polygon | MultiPolygon, dict[str, int]]:
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" '
        f"{page}>\n{body}\n</svg>"
    )
    return read_svg(text.encode(), source="plan.svg")


def hole_of(body: str) -> Polygon:
    """Return the one hole that some shapes leave in the floor, in the drawing's own coordinates (y down)."""
    shape = read(FLOOR + body)
    assert isinstance(shape, Polygon)
    assert len(shape.interiors) == 1
    return shapely.transform(Polygon(shape.interiors[0]), lambda places: np.column_stack([places[:, 0], 50 - places[:, 1]]))


def assert_same(found: Polygon | MultiPolygon, wanted: Polygon, *, tolerance: float = 1e-6) -> None:
    assert found.symmetric_difference(wanted).area <= tolerance * wanted.length
    assert shapely.hausdorff_distance(found.boundary, wanted.boundary, densify=0.02) <= 2 * tolerance


def test_the_picture_stays_the_same_way_up() -> None:
    """The notch is at the top left of the drawing, where y is small."""
    shape = read('<path d="M 20 0 H 100 V 50 H 0 V 30 H 20 Z"/>')
    assert shape.equals(Polygon([(0, 0), (100, 0), (100, 50), (20, 50), (20, 20), (0, 20)]))


@pytest.mark.parametrize(
    ("page", "bounds"),
    [
        ('viewBox="0 0 100 50"', (10, 5, 90, 45)),
        ('viewBox="-10 -10 200 100" width="20cm"', (20, 45, 100, 85)),
        ('width="100" height="60"', (10, 15, 90, 55)),
        ('width="1in" height="1in"', (10, 51, 90, 91)),
        ('width="100%" height="100%"', (0, 0, 80, 40)),
        ("", (0, 0, 80, 40)),
    ],
)
def test_the_origin_is_the_lower_left_corner_of_the_page(page: str, bounds: tuple[float, ...]) -> None:
    assert read('<rect x="10" y="5" width="80" height="40"/>', page).bounds == pytest.approx(bounds)


SHAPES = {
    "rect": ('<rect x="10" y="10" width="20" height="10"/>', box(10, 10, 30, 20)),
    "rect in percent": ('<rect x="10%" y="20%" width="20%" height="20%"/>', box(10, 10, 30, 20)),
    "rect in millimetres": (f'<rect x="10" y="10" width="{20 * 25.4 / 96}mm" height="7.5pt"/>', box(10, 10, 30, 20)),
    "polygon": ('<polygon points="10,10 30,10 30,20"/>', Polygon([(10, 10), (30, 10), (30, 20)])),
    "open polyline": ('<polyline points="10 10 30 10 30 20 10 20"/>', box(10, 10, 30, 20)),
    "absolute path": ('<path d="M10,10L30 10 30 20 10 20Z"/>', box(10, 10, 30, 20)),
    "relative path": ('<path d="m10 10h20v10h-20z"/>', box(10, 10, 30, 20)),
    "path of two parts": ('<path d="M10 10h20v10h-20z m0 0h5v5h-5z"/>', box(10, 10, 30, 20)),
    "compact numbers": ('<path d="M1e1.10e2 30 10L3e1,20,1.0e1.2e2"/>', box(10, 10, 30, 20)),
    "translated group": ('<g transform="translate(5, 5)"><rect x="5" y="5" width="20" height="10"/></g>', box(10, 10, 30, 20)),
    "nested groups": (
        '<g transform="translate(10 10)"><g transform="scale(2)"><rect width="10" height="5"/></g></g>',
        box(10, 10, 30, 20),
    ),
    "turned": ('<rect width="20" height="10" transform="translate(30 10) rotate(90)"/>', box(20, 10, 30, 30)),
    "turned about a point": ('<rect x="20" y="20" width="10" height="10" transform="rotate(180 30 25)"/>', box(30, 20, 40, 30)),
    "skewed": ('<rect width="10" height="10" transform="translate(20 10) skewX(45)"/>', Polygon([(20, 10), (30, 10), (40, 20), (30, 20)])),
    "matrix": ('<rect width="10" height="10" transform="matrix(0 1 -2 0 50 10)"/>', box(30, 10, 50, 20)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_straight_shapes_are_read_exactly(kind: str) -> None:
    body, wanted = SHAPES[kind]
    assert_same(hole_of(body), wanted)


CURVES: dict[str, tuple[str, Callable[[], BaseGeometry]]] = {
    "circle": ('<circle cx="30" cy="25" r="15"/>', lambda: Point(30, 25).buffer(15, quad_segs=2_000)),
    "arcs": ('<path d="M15 25a15 15 0 1130 0a15 15 0 11-30 0z"/>', lambda: Point(30, 25).buffer(15, quad_segs=2_000)),
    "stretched circle": (
        '<circle r="5" transform="translate(30 25) scale(4 2)"/>',
        lambda: affinity.scale(Point(30, 25).buffer(1, quad_segs=2_000), 20, 10),
    ),
    "skewed ellipse": (
        '<ellipse rx="10" ry="5" transform="translate(40 25) skewX(45)"/>',
        lambda: affinity.affine_transform(Point(0, 0).buffer(1, quad_segs=2_000), [10, 5, 0, 5, 40, 25]),
    ),
    "round corners": ('<rect x="20" y="10" width="30" height="20" rx="5"/>', lambda: box(25, 15, 45, 25).buffer(5, quad_segs=2_000)),
    "quadratic": (
        '<path d="M20 40Q40 0 60 40T60 40z"/>',
        lambda: Polygon([(20 + 40 * t, 40 - 80 * t * (1 - t)) for t in np.linspace(0, 1, 4_001).tolist()]),
    ),
    "cubic": (
        '<path d="M20 40c0-40 40-40 40 0S60 40 60 40z"/>',
        lambda: Polygon(
            [
                (20 * (1 - t) ** 3 + 60 * t * (1 - t) ** 2 + 180 * t**2 * (1 - t) + 60 * t**3, 40 - 120 * t * (1 - t))
                for t in np.linspace(0, 1, 4_001).tolist()
            ]
        ),
    ),
}


@pytest.mark.parametrize("kind", CURVES)
def test_curves_are_met_within_the_tolerance(kind: str) -> None:
    body, wanted = CURVES[kind]
    found, curve = hole_of(body), wanted()
    assert shapely.hausdorff_distance(found.boundary, curve.boundary) <= 1.01 * CURVE_TOLERANCE * 100
    assert len(found.exterior.coords) < 200


def test_the_largest_shape_is_the_floor_when_none_is_labelled() -> None:
    shape = read('<circle cx="20" cy="20" r="3"/><rect width="60" height="50" fill="none"/>')
    assert build_arena(shape).betti.holes == 1
    assert shape.bounds == (0, 0, 60, 50)


@pytest.mark.parametrize("label", ['id="Arena"', 'class="thick arena"', 'inkscape:label="arena"'], ids=["id", "class", "label of Inkscape"])
def test_labelled_shapes_are_the_floor_together(label: str) -> None:
    body = f'<rect width="100" height="50"/><g {label}><rect width="30" height="20"/><rect x="20" width="40" height="10"/></g>'
    shape, counts = read_with_counts(body)
    assert_same(shape, Polygon([(0, 30), (30, 30), (30, 40), (60, 40), (60, 50), (0, 50)]))
    assert counts["shapes_ignored"] == 1  # the background, which covers the floor


@pytest.mark.parametrize(
    "obstacle",
    [
        '<rect width="9" height="9" fill="none"/>',
        '<rect width="9" height="9" style="stroke: red; fill: none"/>',
        '<g fill="none"><rect width="9" height="9"/></g>',
        '<style>.outline, #other { fill: none }</style><rect width="9" height="9" class="outline"/>',
        '<g style="display:none"><rect width="9" height="9"/></g>',
        '<rect width="9" height="9" visibility="hidden"/>',
        '<defs><rect width="9" height="9"/></defs>',
        '<clipPath><rect width="9" height="9"/></clipPath>',
        '<text>9</text><metadata><rect width="9" height="9"/></metadata>',
        '<line x2="9" y2="9"/><rect width="0" height="9"/><path d=""/>',
    ],
)
def test_what_is_not_painted_is_not_in_the_way(obstacle: str) -> None:
    assert read(FLOOR + obstacle).equals(box(0, 0, 100, 50))


def test_the_fill_rule_decides_what_a_path_that_winds_twice_holds() -> None:
    """Both squares are drawn clockwise: together they are one area by the nonzero rule, and a ring by the other."""
    path = '<path fill-rule="{}" d="M10 10h30v30h-30z M20 20h10v10h-10z"/>'
    assert hole_of(path.format("nonzero")).area == pytest.approx(900)
    ring = build_arena(read(FLOOR + path.format("evenodd")))
    assert (ring.betti.components, ring.betti.holes) == (2, 1)


def winding_by_angles(ring: list[tuple[float, float]], x: float, y: float) -> int:
    angles = [math.atan2(b - y, a - x) for a, b in ring]
    steps = [(after - before + math.pi) % (2 * math.pi) - math.pi for before, after in zip(angles, angles[1:] + angles[:1], strict=True)]
    return round(sum(steps) / (2 * math.pi))


@settings(max_examples=40)
@given(st.lists(st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), min_size=3, max_size=6), min_size=1, max_size=3), st.booleans())
def test_fill_rules_agree_with_counting_turns(rings: list[list[tuple[int, int]]], is_even_odd: bool) -> None:
    """Places are chosen off every line between grid points."""
    area = fill_rings([np.array(ring, dtype=np.float64) for ring in rings], is_even_odd=is_even_odd)
    for place in np.random.default_rng(1).uniform(0, 8, size=(20, 2)).tolist():
        winding = sum(winding_by_angles([(float(x), float(y)) for x, y in ring], *place) for ring in rings)
        assert shapely.intersects_xy(area, *place) == (winding % 2 == 1 if is_even_odd else winding != 0)


def test_sides_drawn_to_coincide_leave_no_slivers() -> None:
    """Thirds do not add up in binary, but three blocks side by side close the room all the same."""
    blocks = "".join(f'<rect x="{k * 100 / 3}" y="20" width="{100 / 3}" height="10"/>' for k in range(3))
    arena = build_arena(read(FLOOR + blocks))
    assert (arena.betti.components, arena.betti.holes) == (2, 0)


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ('<path d="L 1 1"/>', "line 3: <path>: its path begins with 'L'; wanted M or m"),
        ('<path d="M 0 0 L 1"/>', "line 3: <path>: its path has 1 numbers after L before character 10; wanted a multiple of 2"),
        ('\n<path d="M 0 0 A 5 5 0 2 0 1 1"/>', "line 4: <path>: its path has '2 0 1 1' at character 15; wanted a flag 0 or 1"),
        ('<path d="M 0 0 Z 5"/>', "wanted a command"),
        ('<path d="M 0 nan"/>', "its path has 'nan' at character 5; wanted a number"),
        ('<path d="M 0 1e999"/>', "wanted a finite number"),
        ('<path d="M 0 0 L 1e10 0 0 1"/>', r"reaches beyond 1e\+09 units"),
        ('<rect width="wide" height="1"/>', "<rect> width is 'wide'; wanted a number, with px"),
        ('<rect width="-1" height="1"/>', "wanted none negative"),
        ('<rect width="1e999" height="1"/>', "wanted a finite number"),
        ('<rect width="5em" height="1"/>', "<rect> width is '5em'"),
        ('<polygon points="0 0 1 1 2"/>', "has 5 numbers in points; wanted an even number"),
        ('<polygon points="0 0 x 1 2 2"/>', "<polygon> points has 'x'; wanted finite numbers"),
        ('<g transform="turn(3)"/>', r"transform has 'turn\(3\)'; wanted matrix"),
        ('<g transform="matrix(1 2)"/>', "transform matrix has 2 numbers"),
        ('<use href="#a"/>', "<use> is not supported; turn clones into shapes"),
        ("<svg/>", "an <svg> within the drawing is not supported"),
        ("<g>", "not well-formed XML: mismatched tag in line 4"),
        ("", "holds no shape with an area"),
        ('<line x2="5"/>', "holds no shape with an area"),
        ('<path d="M 0 0 L 5 5 Z"/>', "nothing of the floor is left free"),
        ("<g>" * 300 + "</g>" * 300, "nested more than 200 deep"),
        (
            '<rect id="arena" width="9" height="9"/><rect width="9" height="5"/><rect y="4" width="9" height="5"/>',
            "nothing of the floor is left",
        ),
    ],
)
def test_a_faulty_drawing_is_refused_with_the_place_of_its_fault(body: str, problem: str) -> None:
    with pytest.raises(ArenaError, match=rf"plan\.svg: .*{problem}"):
        read(body)


@pytest.mark.parametrize(
    "declaration",
    [
        '<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">',
        '<!ENTITY secret SYSTEM "file:///etc/passwd">',
        '<!ENTITY % p SYSTEM "http://localhost/">',
    ],
)
def test_entities_are_refused_before_they_are_used(declaration: str) -> None:
    text = f'<!DOCTYPE svg [{declaration}]>\n<svg xmlns="http://www.w3.org/2000/svg"><rect width="9" height="9"/></svg>'
    with pytest.raises(ArenaError, match=r"line 1: it declares the entity '\w+', which is not supported"):
        read_svg(text.encode(), source="plan.svg")


def test_a_document_type_alone_does_no_harm() -> None:
    text = (
        '<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd">'
        '<svg xmlns="http://www.w3.org/2000/svg"><rect width="9" height="9"/></svg>'
    )
    assert read_svg(text.encode(), source="plan.svg")[0].area == 81


@pytest.mark.parametrize("root", ["<html/>", '<svg xmlns="http://elsewhere/"/>'])
def test_another_kind_of_document_is_refused(root: str) -> None:
    with pytest.raises(ArenaError, match="wanted <svg>"):
        read_svg(root.encode(), source="plan.svg")


@pytest.mark.parametrize("box_", ["0 0 0 5", "0 0 5", "a b c d"])
def test_a_faulty_viewbox_is_refused(box_: str) -> None:
    with pytest.raises(ArenaError, match="viewBox"):
        read('<rect width="9" height="9"/>', f'viewBox="{box_}"')


@given(st.text("MmLlHhVvCcSsQqTtAaZz0123456789.,-+e ", max_size=30))
def test_no_path_crashes_the_reader(data: str) -> None:
    try:
        read(f'{FLOOR}<path d="{data}"/>')
    except ArenaError as error:
        assert "plan.svg: " in str(error)  # noqa: PT017  # most are refused, none may do anything else
