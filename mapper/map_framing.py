"""Where the operator's pins are on a map, and where three and more with known places put it.

The pins of a file (`mapper.pins`) stand or fall together; those of a live map do not: what cannot be found on this map, or does not fix
where it lies, is told of, and the others count.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

import msgspec

from mapper.errors import PinsError, PlaceError
from mapper.geojson import describe_frame
from mapper.map_sketch import MapSketch, sketch_map
from mapper.named_pins import Framing, NamedPin, PinOnMap
from mapper.pins import Pin, Pinned, place_pins
from mapper.places import FoundPlace, find_place, parse_place
from mapper.types import MapResult

LEAST_PINS: Final = 3
"""So many with known places, not on one line, fix place, scale, direction and handedness of a component."""


def frame_map(result: MapResult, pins: Sequence[NamedPin]) -> Framing:
    """Find pins on a map, and fit the operator's frame to those with known places, if there are enough."""
    if not pins:
        return Framing()
    sketch = sketch_map(result)
    found, problems_of = _find(pins, sketch)
    pinned, problems = _fit(pins, found, sketch)
    residuals = {} if pinned is None else {str(one.pin.place): one.residual_m for one in pinned.pins}
    places = []
    for pin in pins:
        place = found.get(pin.name)
        if place is None:
            places.append(PinOnMap(problem=problems_of[pin.name]))
            continue
        x, y = place.xy.tolist()
        residual_m = None if pin.at is None else residuals.get(place.name)
        places.append(PinOnMap(x=x, y=y, component=place.component, gap_s=place.gap_s, residual_m=residual_m))
    return Framing(
        pins=tuple(pins),
        places=tuple(places),
        frame_json=b"null" if pinned is None else msgspec.json.encode(describe_frame(result, pinned)),
        problems=problems,
    )


def pin_down(result: MapResult, pins: Sequence[NamedPin]) -> Pinned | None:
    """Return the operator's frame for pictures; None where the pins fix none."""
    if not pins:
        return None
    sketch = sketch_map(result)
    return _fit(pins, _find(pins, sketch)[0], sketch)[0]


def _find(pins: Sequence[NamedPin], sketch: MapSketch) -> tuple[dict[str, FoundPlace], dict[str, str]]:
    found, problems = {}, {}
    for pin in pins:
        try:
            found[pin.name] = find_place(parse_place(pin.place), sketch)
        except PlaceError as error:
            problems[pin.name] = str(error)
    return found, problems


def _fit(pins: Sequence[NamedPin], found: dict[str, FoundPlace], sketch: MapSketch) -> tuple[Pinned | None, tuple[str, ...]]:
    """Fit each component that has pins enough; say of the others that have some why not."""
    by_component: defaultdict[int, list[Pin]] = defaultdict(list)
    for pin in pins:
        if pin.at is not None and pin.name in found:
            by_component[found[pin.name].component].append(Pin(place=parse_place(pin.place), at=pin.at, is_geographic=False))
    fitting: list[Pin] = []
    problems: list[str] = []
    for component, own in sorted(by_component.items()):
        where = f"component {component}: " if len(sketch.cover_radii) > 1 else ""
        if len(own) < LEAST_PINS:
            counted = "1 pin has x and y" if len(own) == 1 else f"{len(own)} pins have x and y"
            problems.append(f"{where}{counted}; {LEAST_PINS} that are not on one line fix where the map lies")
            continue
        try:
            place_pins(own, sketch)
        except PinsError as error:
            problems += [where + problem for problem in error.problems]
        else:
            fitting += own
    return place_pins(fitting, sketch) if fitting else None, tuple(problems)
