"""Routes as a JSON object for programs, and in words for a person."""

from mapper.map_sketch import MapSketch
from mapper.places import FoundPlace, NamedPlace, find_place, parse_place
from mapper.report import JsonObject
from mapper.routes import Route, Routes, find_routes

_LEAST_TURN = 0.05  # of a full one: less is not on any side worth telling


def answer_routes(sketch: MapSketch, begin: str | NamedPlace, end: str | NamedPlace, *, classes: int) -> Routes:
    """Find routes between two places, in text (`mapper.places`) or read already.

    Raises
    ------
    PlaceError
        A place is not understood, or the map does not show it.
    RouteError
        As for `mapper.routes.find_routes`.
    """
    first, last = (find_place(parse_place(place) if isinstance(place, str) else place, sketch) for place in (begin, end))
    return find_routes(sketch, first, last, classes=classes)


def routes_to_json(routes: Routes) -> JsonObject:
    """Describe routes for programs: lengths and coordinates in ``length_unit`` and coordinates of the map, the shortest first."""
    return {
        "from": _place(routes.begin),
        "to": _place(routes.end),
        "length_unit": routes.length_unit,
        "is_complete": routes.is_complete,
        "routes": [
            {
                "length": route.length,
                "length_error": route.length_error,
                "signature": list(route.signature),
                "passes": [{"hole": number, "turns": turns} for number, turns in route.passes],
                "xy": route.xy.tolist(),
            }
            for route in routes.routes
        ],
    }


def describe_routes(routes: Routes) -> str:
    """Describe routes in a few lines for a person."""
    unit = routes.length_unit
    ends = f"from {routes.begin.name} to {routes.end.name}"
    gaps = [place for place in (routes.begin, routes.end) if place.gap_s > 0]
    lines = [f"{len(routes.routes)} route{'s' if len(routes.routes) != 1 else ''} {ends}"]
    lines += [
        f"route {number:<8} {route.length:.4g} +- {route.length_error:.2g} {unit}{_sides(route)}"
        for number, route in enumerate(routes.routes, start=1)
    ]
    lines += [f"{place.name:<14} is placed by an encounter {place.gap_s:.3g} s away" for place in gaps]
    if not routes.is_complete:
        lines.append("there are others, or the search was ended before all were found: ask for more with --classes")
    return "\n".join(lines)


def _sides(route: Route) -> str:
    """Say on which side each obstacle lies of one who walks: what one turns about counter-clockwise is on the left."""
    sides = [f"hole {number} on the {'left' if turns > 0 else 'right'}" for number, turns in route.passes if abs(turns) >= _LEAST_TURN]
    return f"; {', '.join(sides)}" if sides else ""


def _place(place: FoundPlace) -> JsonObject:
    x, y = place.xy.tolist()
    return {"place": place.name, "x": x, "y": y, "component": place.component, "point": place.point, "gap_s": place.gap_s}
