"""The jobs of the drawing process: pictures, GeoJSON, routes, distances and frames of a map that `make_map` made.

What draws is imported where it runs: the serving process needs these functions only by name.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import TYPE_CHECKING, Literal

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mapper.named_pins import Framing, NamedPin
    from mapper.render import ImageFormat
    from mapper.report import JsonObject
    from mapper.types import MapResult

PictureKind = Literal["map", "diagram", "barcode"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoRoutes:
    """Why there are none: what is wrong with ``place``, or None where both places are there and nothing leads from one to the other."""

    place: str | None
    problem: str
    next_step: str


def draw_picture(drawing: bytes, kind: PictureKind, image_format: ImageFormat, *, pins: Sequence[NamedPin]) -> bytes:
    """Draw a map, its diagram or its barcode; the map in the operator's frame, where pins fix one."""
    from mapper.interval_pictures import render_barcode, render_diagram  # noqa: PLC0415  # see the module's docstring
    from mapper.map_codec import decode_map  # noqa: PLC0415  # same
    from mapper.map_framing import pin_down  # noqa: PLC0415  # same
    from mapper.render import render_map  # noqa: PLC0415  # same

    result = decode_map(drawing)
    match kind:
        case "map":
            return render_map(result, image_format=image_format, pinned=pin_down(result, pins))
        case "diagram":
            return render_diagram(result, image_format=image_format)
        case "barcode":
            return render_barcode(result, image_format=image_format)


def write_geojson(drawing: bytes, *, pins: Sequence[NamedPin]) -> bytes:
    """Write a map as GeoJSON, in the operator's frame where pins fix one."""
    from mapper.geojson import to_geojson  # noqa: PLC0415  # see the module's docstring
    from mapper.map_codec import decode_map  # noqa: PLC0415  # same
    from mapper.map_framing import pin_down  # noqa: PLC0415  # same

    result = decode_map(drawing)
    return msgspec.json.encode(to_geojson(result, pinned=pin_down(result, pins)))


def frame_drawing(drawing: bytes, *, pins: Sequence[NamedPin]) -> Framing:
    """Find pins on a map, and where they put it."""
    from mapper.map_codec import decode_map  # noqa: PLC0415  # see the module's docstring
    from mapper.map_framing import frame_map  # noqa: PLC0415  # same

    return frame_map(decode_map(drawing), pins)


def find_map_routes(drawing: bytes, begin: str, end: str, *, classes: int) -> bytes | NoRoutes:
    """Find routes on a map, as JSON."""

    def answer(result: MapResult) -> JsonObject:
        from mapper.map_sketch import sketch_map  # noqa: PLC0415  # see the module's docstring
        from mapper.route_report import answer_routes, routes_to_json  # noqa: PLC0415  # same

        return routes_to_json(answer_routes(sketch_map(result), begin, end, classes=classes))

    return _search(drawing, answer)


def measure_map_distance(drawing: bytes, begin: str, end: str, *, pins: Sequence[NamedPin]) -> bytes | NoRoutes:
    """Say how far it is from one place on a map to another, as JSON: along the shortest route, and as the crow flies."""

    def answer(result: MapResult) -> JsonObject:
        from mapper.map_framing import pin_down  # noqa: PLC0415  # see the module's docstring
        from mapper.map_sketch import sketch_map  # noqa: PLC0415  # same
        from mapper.route_report import answer_routes, routes_to_json  # noqa: PLC0415  # same

        routes = answer_routes(sketch_map(result), begin, end, classes=1)
        shortest, described = routes.routes[0], routes_to_json(routes)
        straight = hypot(*(routes.end.xy - routes.begin.xy).tolist())
        pinned = pin_down(result, pins)
        fit = None if pinned is None else pinned.frame.fits.get(routes.begin.component)
        scale = None if fit is None else fit.similarity.scale
        lengths = {"distance": shortest.length, "distance_error": shortest.length_error, "straight": straight}
        return {
            "from": described["from"],
            "to": described["to"],
            "length_unit": routes.length_unit,
            **lengths,
            "in_frame": None if scale is None else {"unit": "m", **{name: scale * length for name, length in lengths.items()}},
            "xy": shortest.xy.tolist(),
        }

    return _search(drawing, answer)


def _search(drawing: bytes, answer: Callable[[MapResult], JsonObject]) -> bytes | NoRoutes:
    from mapper.errors import PlaceError, RouteError  # noqa: PLC0415  # see the module's docstring
    from mapper.map_codec import decode_map  # noqa: PLC0415  # same

    try:
        return msgspec.json.encode(answer(decode_map(drawing)))
    except PlaceError as error:
        return NoRoutes(place=error.place, problem=error.problem, next_step=error.next_step)
    except RouteError as error:
        return NoRoutes(place=None, problem=error.problem, next_step=error.next_step)
