"""A finished map as GeoJSON (RFC 7946): points, obstacles in holes, landmarks, pins, and the hull of each component.

Coordinates are longitude and latitude on WGS 84, as the standard has it, only where pins are given in degrees. Otherwise they are those
of the operator's frame in metres, or of the map itself; the member ``coordinate_frame`` of the collection says which (section 4
allows other coordinates where all involved know of it). Without pins each component has a frame of its own.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mapper.frames import OperatorFrame, describe_turn
from mapper.pins import Pinned
from mapper.polygons import contains, convex_hull, signed_area
from mapper.record_columns import to_unsigned
from mapper.report import JsonObject, JsonValue
from mapper.types import FloatArray, Hole, MapResult

_NS_PER_S = 1e9
_DEGREE_DIGITS, _LENGTH_DIGITS = 9, 6  # a tenth of a millimetre on the ground; a micrometre, or a microsecond of walking


@dataclass(frozen=True, slots=True, kw_only=True)
class _Canvas:
    """Where coordinates come from: the operator's frame, or None for the map's own."""

    frame: OperatorFrame | None
    length_unit: str

    @property
    def unit(self) -> str:
        return self.length_unit if self.frame is None else "m"

    def scale(self, component: int) -> float | None:
        """Units of the canvas in one of the map; None: the component is not in it."""
        if self.frame is None:
            return 1.0
        fit = self.frame.fits.get(component)
        return None if fit is None else fit.similarity.scale

    def place(self, places: FloatArray, component: int) -> FloatArray | None:
        if self.frame is None:
            return places
        return self.frame.coordinates(places, component=component) if component in self.frame.fits else None

    def numbers(self, places: FloatArray) -> list[JsonValue]:
        digits = _DEGREE_DIGITS if self.frame is not None and self.frame.plane is not None else _LENGTH_DIGITS
        return [[round(x, digits), round(y, digits)] for x, y in places.tolist()]


def to_geojson(result: MapResult, *, pinned: Pinned | None = None) -> JsonObject:
    """Describe a map for geographic programs.

    Parameters
    ----------
    pinned
        The operator's frame; None: the map's own coordinates. What is in components without pins has no geometry then (null).

    Returns
    -------
    JsonObject
        A FeatureCollection. ``kind`` in the properties of a feature is "component", "hole", "landmark", "pin" or "point"; lengths,
        areas and their errors are in ``coordinate_frame.unit`` and its square (metres where coordinates are degrees).
    """
    canvas = _Canvas(frame=None if pinned is None else pinned.frame, length_unit=result.length_unit)
    features = [
        *_components(result, canvas),
        *_holes(result, canvas),
        *_landmarks(result, canvas),
        *([] if pinned is None else _pins(pinned, canvas)),
        *_points(result, canvas),
    ]
    return {"type": "FeatureCollection", "coordinate_frame": describe_frame(result, pinned), "features": list(features)}


def describe_frame(result: MapResult, pinned: Pinned | None) -> JsonObject:
    """Say what coordinates mean, and how each component was brought there: ``operator = matrix * map + shift``; with pins' residuals."""
    if pinned is None:
        note = (
            "Not WGS 84: coordinates of the map itself. They have no known place, direction or handedness, and each component has its "
            "own; components stand side by side only so that they can be drawn."
        )
        return {"kind": "map", "is_wgs84": False, "unit": result.length_unit, "note": note, "components": [], "warnings": []}
    plane = pinned.frame.plane
    note = (
        "Not WGS 84: metres in the frame that the pins are given in."
        if plane is None
        else "WGS 84 longitude and latitude, by a plane that touches the ellipsoid in the middle of the pins."
    )
    return {
        "kind": "operator" if plane is None else "wgs84",
        "is_wgs84": plane is not None,
        "unit": "m",
        "note": note,
        "origin": None if plane is None else [plane.lon, plane.lat],
        "components": [_fit(pinned, component) for component in sorted(pinned.frame.fits)],
        "holes": [
            {"number": number, **_moved(hole, pinned.frame)}
            for number, hole in enumerate(result.holes, start=1)
            if hole.component in pinned.frame.fits
        ],
        "warnings": list(pinned.warnings),
    }


def summarize_frame(pinned: Pinned) -> str:
    """Describe in a few lines for a person how pins place the map."""
    lines = []
    for component, fit in sorted(pinned.frame.fits.items()):
        similarity = fit.similarity
        n_pins = sum(pin.found.component == component for pin in pinned.pins)
        mirrored = "mirrored" if similarity.is_mirrored else "not mirrored"
        lines.append(
            f"pins {component:<9} {n_pins} for component {component}: scale {similarity.scale:.4g}, turned {describe_turn(similarity):.1f} "
            f"degrees, {mirrored}{'' if fit.is_handed else ' (not known)'}; residuals {fit.rms:.3g} m rms"
        )
    return "\n".join(lines)


def _moved(hole: Hole, frame: OperatorFrame) -> JsonObject:
    """Return what a hole's polygon and size are in the operator's frame: coordinates as the pins', lengths in metres."""
    scale = frame.fits[hole.component].similarity.scale
    ring: list[JsonValue] = []
    centre: JsonValue = None
    if hole.centre is not None:
        placed = frame.coordinates(hole.outline_xy, component=hole.component)
        turned = placed if signed_area(placed) > 0 else placed[::-1]
        ring = np.concatenate([turned, turned[:1]]).tolist()
        centre = frame.coordinates(hole.centre[None], component=hole.component)[0].tolist()
    lengths = {name: _scaled(getattr(hole, name), scale) for name in ("perimeter", "perimeter_error")}
    areas = {name: _scaled(getattr(hole, name), scale**2) for name in ("area", "area_error")}
    return {"outline_xy": ring, "centre": centre, **lengths, **areas}


def _fit(pinned: Pinned, component: int) -> JsonObject:
    fit = pinned.frame.fits[component]
    similarity = fit.similarity
    return {
        "component": component,
        "scale": similarity.scale,
        "turn_deg": describe_turn(similarity),
        "is_mirrored": similarity.is_mirrored,
        "is_handedness_known": fit.is_handed,
        "matrix": similarity.matrix.tolist(),
        "shift": list(similarity.shift),
        "rms_residual_m": fit.rms,
        "pins": [
            {
                "place": pin.found.name,
                "map_xy": pin.found.xy.tolist(),
                "known": list(pin.pin.at),
                "residual_m": pin.residual_m,
                "gap_s": pin.found.gap_s,
            }
            for pin in pinned.pins
            if pin.found.component == component
        ],
    }


def _components(result: MapResult, canvas: _Canvas) -> Iterable[JsonValue]:
    """Make a polygon of each component: the convex hull of its points, less the obstacles that are inside it."""
    xy = np.column_stack([result.points.x, result.points.y])
    for index, part in enumerate(result.components):
        hull = convex_hull(xy[result.points.component == index])
        inside = [hole.outline_xy for hole in result.holes if hole.component == index and _is_inside(hole, hull)]
        properties: JsonObject = {
            "kind": "component",
            "component": index,
            "n_encounters": part.n_encounters,
            "n_points": part.n_points,
            "n_landmarks": part.n_landmarks,
            "betti_numbers": list(part.betti_numbers),
            "is_convex_hull": True,
        }
        if len(hull) < 3:
            geometry = _geometry("LineString" if len(hull) == 2 else "Point", _line(hull, canvas, index))
        else:
            geometry = _geometry("Polygon", _rings(hull, inside, canvas, index))
        yield _feature(f"component-{index}", geometry, properties)


def _holes(result: MapResult, canvas: _Canvas) -> Iterable[JsonValue]:
    for number, hole in enumerate(result.holes, start=1):
        scale = canvas.scale(hole.component)
        lengths = ("birth", "death", "perimeter", "perimeter_error")
        sizes: JsonObject = {name: _scaled(getattr(hole, name), scale) for name in lengths}
        sizes |= {name: _scaled(getattr(hole, name), None if scale is None else scale**2) for name in ("area", "area_error")}
        properties: JsonObject = {
            "kind": "hole",
            "number": number,
            "component": hole.component,
            **sizes,
            "probability": hole.probability,
            "points": hole.outline.tolist(),
        }
        rings = _rings(hole.outline_xy, [], canvas, hole.component) if hole.centre is not None else None
        yield _feature(f"hole-{number}", _geometry("Polygon", rings), properties)


def _landmarks(result: MapResult, canvas: _Canvas) -> Iterable[JsonValue]:
    for number, landmark in enumerate(result.landmarks):
        end_ns = landmark.t_end_ns
        properties: JsonObject = {
            "kind": "landmark",
            "id": result.node_names.get(landmark.node, to_unsigned(landmark.node)),
            "component": landmark.component,
            "t_start": landmark.t_start_ns / _NS_PER_S,
            "t_end": None if end_ns is None else end_ns / _NS_PER_S,
        }
        at = _line(np.array([[landmark.x, landmark.y]]), canvas, landmark.component)
        yield _feature(f"landmark-{number}", _geometry("Point", at), properties)


def _points(result: MapResult, canvas: _Canvas) -> Iterable[JsonValue]:
    points = result.points
    xy = np.column_stack([points.x, points.y])
    for index, (t_ns, id1, id2, component) in enumerate(
        zip(points.t_ns.tolist(), points.id1.tolist(), points.id2.tolist(), points.component.tolist(), strict=True)
    ):
        properties: JsonObject = {
            "kind": "point",
            "index": index,
            "t": t_ns / _NS_PER_S,
            "id1": result.node_names.get(id1, to_unsigned(id1)),
            "id2": result.node_names.get(id2, to_unsigned(id2)),
            "component": component,
        }
        yield _feature(f"point-{index}", _geometry("Point", _line(xy[index : index + 1], canvas, component)), properties)


def _pins(pinned: Pinned, canvas: _Canvas) -> Iterable[JsonValue]:
    """Put each pin where it is known to be, not where the map has it."""
    for number, placed in enumerate(pinned.pins, start=1):
        properties: JsonObject = {
            "kind": "pin",
            "place": placed.found.name,
            "component": placed.found.component,
            "residual_m": placed.residual_m,
        }
        at = canvas.numbers(np.array([placed.pin.at]))
        yield _feature(f"pin-{number}", _geometry("Point", at), properties)


def _is_inside(hole: Hole, hull: FloatArray) -> bool:
    return hole.centre is not None and len(hull) >= 3 and bool(contains(hull, hole.outline_xy).all())


def _rings(outer: FloatArray, inner: Sequence[FloatArray], canvas: _Canvas, component: int) -> list[JsonValue] | None:
    """Make the rings of a polygon: closed, the outer one counter-clockwise, those of holes clockwise (RFC 7946, 3.1.6)."""
    rings: list[JsonValue] = []
    for ring, is_outer in [(outer, True), *((ring, False) for ring in inner)]:
        placed = canvas.place(ring, component)
        if placed is None:
            return None
        turned = placed if (signed_area(placed) > 0) is is_outer else placed[::-1]
        rings.append(canvas.numbers(np.concatenate([turned, turned[:1]])))
    return rings


def _line(places: FloatArray, canvas: _Canvas, component: int) -> list[JsonValue] | None:
    placed = canvas.place(places, component)
    return None if placed is None else canvas.numbers(placed)


def _geometry(kind: str, coordinates: list[JsonValue] | None) -> JsonObject | None:
    if coordinates is None:
        return None
    return {"type": kind, "coordinates": coordinates[0] if kind == "Point" else coordinates}


def _feature(name: str, geometry: JsonObject | None, properties: JsonObject) -> JsonObject:
    return {"type": "Feature", "id": name, "geometry": geometry, "properties": properties}


def _scaled(value: float | None, factor: float | None) -> float | None:
    return None if value is None or factor is None else value * factor
