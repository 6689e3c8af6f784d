"""Pictures of the mission report as SVG without styles of their own: a page under a strict policy may hold them."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from math import floor, log10
from typing import Final

import msgspec

_WIDTH: Final = 720.0
_MAP_HEIGHT: Final = 460.0
_EDGE: Final = 28.0
_TIME_HEIGHT: Final = 190.0
_LEFT: Final = 48.0
_DRAWN_PROBABILITY: Final = 0.2
_ROW: Final = 7.0
_MAX_ROWS: Final = 8
_COLOURS: Final = {"critical": "#b3261e", "warning": "#b26a00", "info": "#3b6ea5"}

_Place = tuple[float, float]


class DrawnPoint(msgspec.Struct, frozen=True):
    """A point of the map."""

    x: float
    y: float
    is_well_seen: bool | None


class DrawnHole(msgspec.Struct, frozen=True):
    """A hole, or what may be one; see ``/api/v1/map``."""

    component: int
    outline: list[_Place]
    outline_xy: list[_Place]
    centre: _Place | None
    probability: float | None
    area: float | None
    area_error: float | None
    perimeter: float | None
    perimeter_error: float | None


class DrawnLandmark(msgspec.Struct, frozen=True):
    """A landmark; ``t_end`` None: it stands."""

    id: int
    x: float
    y: float
    t_start: float
    t_end: float | None


class DrawnComplex(msgspec.Struct, frozen=True):
    """The Rips complex as drawn."""

    triangles: list[tuple[int, int, int]]


class DrawnMap(msgspec.Struct, frozen=True):
    """What is drawn of a map."""

    points: list[DrawnPoint]
    holes: list[DrawnHole]
    possible_holes: list[DrawnHole]
    landmarks: list[DrawnLandmark]
    complex: DrawnComplex


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedCount:
    """How many holes a map showed, and whether its data were enough; None: not known."""

    wall_ns: int
    n_holes: int
    is_enough: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedSpan:
    """Something that lasted, to the end of the picture where ``end_ns`` is None; ``kind`` is a severity."""

    begin_ns: int
    end_ns: int | None
    kind: str
    text: str


def draw_map(map_: DrawnMap, *, unit: str, pins: Sequence[tuple[str, _Place]] = ()) -> str:
    """Draw points, complex, holes with their numbers, landmarks, pins by name and place on the map, and a bar of a round length."""
    places = [(point.x, point.y) for point in map_.points] + [(one.x, one.y) for one in map_.landmarks] + [place for _, place in pins]
    left, right = min(x for x, _ in places), max(x for x, _ in places)
    low, high = min(y for _, y in places), max(y for _, y in places)
    scale = min((_WIDTH - 2 * _EDGE) / max(right - left, 1e-9), (_MAP_HEIGHT - 2 * _EDGE) / max(high - low, 1e-9))
    middle = (left + right) / 2, (low + high) / 2

    def put(place: _Place) -> _Place:
        return _WIDTH / 2 + scale * (place[0] - middle[0]), _MAP_HEIGHT / 2 - scale * (place[1] - middle[1])

    def ring(corners: Sequence[_Place]) -> str:
        return _path([put(corner) for corner in corners])

    spots = [put((point.x, point.y)) for point in map_.points]
    sheet = "".join(_path([spots[corner] for corner in triangle]) for triangle in map_.complex.triangles)
    parts = [f'<path d="{sheet}" fill="#c9d6e6" fill-opacity="0.55"/>'] if sheet else []
    for number, hole in enumerate(map_.holes, start=1):
        parts.append(f'<path d="{ring(hole.outline_xy or hole.outline)}" fill="white" stroke="#b3261e" stroke-width="2"/>')
        parts.append(_label(put(_middle(hole)), str(number), size=15))
    for hole in map_.possible_holes:
        if (hole.probability or 0.0) >= _DRAWN_PROBABILITY:
            outline = ring(hole.outline_xy or hole.outline)
            parts.append(f'<path d="{outline}" fill="none" stroke="#b3261e" stroke-width="1.2" stroke-dasharray="4 3"/>')
            parts.append(_label(put(_middle(hole)), "?", size=13))
    for (x, y), point in zip(spots, map_.points, strict=True):
        fill = "white" if point.is_well_seen is False else "#34506f"
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{fill}" stroke="#34506f" stroke-width="0.7"/>')
    for one in map_.landmarks:
        x, y = put((one.x, one.y))
        corners = f"{x - 5:.1f},{y + 4:.1f} {x + 5:.1f},{y + 4:.1f} {x:.1f},{y - 5:.1f}"
        dashes = "" if one.t_end is None else ' stroke-dasharray="2 2"'
        parts.append(f'<polygon points="{corners}" fill="white" stroke="#1c6b3c" stroke-width="1.4"{dashes}/>')
        parts.append(f'<text x="{x:.1f}" y="{y + 15:.1f}" font-size="9" text-anchor="middle" fill="#1c6b3c">{one.id}</text>')
    for name, place in pins:
        x, y = put(place)
        parts.append(f'<path d="M{x - 6:.1f} {y:.1f}H{x + 6:.1f}M{x:.1f} {y - 6:.1f}V{y + 6:.1f}" stroke="#7a3e9d" stroke-width="2"/>')
        parts.append(f'<text x="{x + 8:.1f}" y="{y - 4:.1f}" font-size="11" fill="#7a3e9d">{escape(name)}</text>')
    return _svg(_MAP_HEIGHT, "The map: points, holes with their numbers, landmarks, pins", [*parts, *_bar(scale, unit)])


def draw_timeline(counts: Sequence[TimedCount], spans: Sequence[TimedSpan], *, end_ns: int) -> str:
    """Draw the number of holes over time, pale where the data were not enough, and below when alerts were on."""
    begin_ns = min([end_ns - 1, *(count.wall_ns for count in counts), *(span.begin_ns for span in spans)])
    most = max([1, *(count.n_holes for count in counts)])
    right, base, top = _WIDTH - 12.0, _TIME_HEIGHT - 26.0 - _ROW * _MAX_ROWS, 14.0

    def across(wall_ns: int) -> float:
        return _LEFT + (right - _LEFT) * (wall_ns - begin_ns) / max(1, end_ns - begin_ns)

    def up(number: int) -> float:
        return base - (base - top) * number / most

    parts = [f'<path d="M{_LEFT:.1f} {top:.1f}V{base:.1f}H{right:.1f}" fill="none" stroke="#666" stroke-width="1"/>']
    parts += [
        f'<text x="{_LEFT - 6:.1f}" y="{up(number) + 3:.1f}" font-size="10" text-anchor="end">{number}</text>'
        for number in sorted({0, most // 2, most})
    ]
    for count, following in zip_longest(counts, counts[1:]):
        x, y = across(count.wall_ns), up(count.n_holes)
        after = "" if following is None else f"V{up(following.n_holes):.1f}"
        until = right if following is None else across(following.wall_ns)
        colour = "#c2ccd8" if count.is_enough is False else "#34506f"
        parts.append(f'<path d="M{x:.1f} {y:.1f}H{until:.1f}{after}" fill="none" stroke="{colour}" stroke-width="2"/>')
    for row, span in enumerate(spans[:_MAX_ROWS]):
        x, y = across(span.begin_ns), base + 8.0 + _ROW * row
        width = max(2.0, across(span.end_ns or end_ns) - x)
        colour = _COLOURS.get(span.kind, "#666")
        parts.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="4.5" fill="{colour}"><title>{escape(span.text)}</title></rect>'
        )
    return _svg(_TIME_HEIGHT, "Holes on the map over time, and when alerts were on", parts)


def _middle(hole: DrawnHole) -> _Place:
    if hole.centre is not None:
        return hole.centre
    n = len(hole.outline)
    return sum(x for x, _ in hole.outline) / n, sum(y for _, y in hole.outline) / n


def _path(corners: Sequence[_Place]) -> str:
    return "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in corners) + "Z"


def _label(place: _Place, text: str, *, size: int) -> str:
    x, y = place
    return (
        f'<text x="{x:.1f}" y="{y + size / 3:.1f}" font-size="{size}" font-weight="bold" text-anchor="middle" fill="#b3261e">{text}</text>'
    )


def _bar(scale: float, unit: str) -> list[str]:
    """Draw a bar of the largest round length that takes no more than a quarter of the width."""
    longest = _WIDTH / 4 / scale
    power = 10.0 ** floor(log10(longest))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= longest)
    x, y = _WIDTH - _EDGE, _MAP_HEIGHT - 12.0
    return [
        f'<path d="M{x - scale * length:.1f} {y - 4:.1f}V{y:.1f}H{x:.1f}V{y - 4:.1f}" fill="none" stroke="black"/>',
        f'<text x="{x - scale * length / 2:.1f}" y="{y - 4:.1f}" font-size="11" text-anchor="middle">{length:g} {escape(unit)}</text>',
    ]


def _svg(height: float, title: str, parts: Sequence[str]) -> str:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {height:g}" role="img" font-family="sans-serif">'
    return f"{head}<title>{escape(title)}</title>{''.join(parts)}</svg>"
