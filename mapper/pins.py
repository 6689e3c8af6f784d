"""Pins: files that say where in the operator's frame some of what a map shows is known to be, and the frame that they fix.

TOML and JSON have a list ``pins``; CSV has a row each. A pin names a landmark (``landmark``, and ``t_s`` where it stood at several
places), a biobot at a time (``biobot``, ``t_s``) or a point of the map (``point``), with ids as the log has them, and its place: ``x`` and
``y`` in metres of the operator's frame, or ``lon`` and ``lat`` in degrees of WGS 84.
"""

import csv
import io
import json
import tomllib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from firmware_protocol.first_use import prepare
from mapper.errors import InputFileError, PinsError
from mapper.frames import MAX_TANGENT_M, OperatorFrame, PinFit, TangentPlane, fit_pins
from mapper.map_sketch import MapSketch
from mapper.places import BiobotPlace, FoundPlace, LandmarkPlace, NamedPlace, PointPlace, find_place
from mapper.types import KNOWN_PLACES, Assumption

_MAX_BYTES = 2**20
_MAX_PINS = 10_000
_ID = Annotated[int, Meta(ge=0, le=2**63 - 1)]
_NAMES = ("landmark", "biobot", "point")
_COLUMNS = (*_NAMES, "t_s", "x", "y", "lon", "lat")
_WARN_SCALE = 1.3  # of map lengths in metres and those that pins give


@dataclass(frozen=True, slots=True, kw_only=True)
class Pin:
    """What is where: metres x and y, or degrees longitude and latitude where ``is_geographic``."""

    place: NamedPlace
    at: tuple[float, float]
    is_geographic: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedPin:
    """A pin and where the map has it; ``known_m``, shape (2,), is its known place in metres of the frame."""

    pin: Pin
    found: FoundPlace
    known_m: tuple[float, float]
    residual_m: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pinned:
    """The operator's frame, the pins that fix it, and what the operator should know of it."""

    frame: OperatorFrame
    pins: tuple[PlacedPin, ...]
    warnings: tuple[str, ...]


class _Row(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    landmark: _ID | str | None = None
    biobot: _ID | str | None = None
    point: Annotated[int, Meta(ge=0)] | None = None
    t_s: float | None = None
    x: float | None = None
    y: float | None = None
    lon: float | None = None
    lat: float | None = None


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pins: list[_Row]


prepare(_File)


def read_pins(path: Path) -> tuple[Pin, ...]:
    """Read a file of pins; its name ends with .toml, .json or .csv.

    Raises
    ------
    InputFileError
        It cannot be read, is none of these, or has pins that say too little or contradict themselves; all faults are listed.
    """
    rows = _read_rows(path)
    pins: list[Pin] = []
    faults: list[str] = []
    for number, row in enumerate(rows, start=1):
        try:
            pins.append(_make_pin(row))
        except ValueError as error:
            faults.append(f"pin {number}: {error}")
    faults += _contradictions(pins)
    pins = list(dict.fromkeys(pins))  # what is given twice is known once
    if not faults and len({pin.is_geographic for pin in pins}) > 1:
        faults.append("some pins have x and y, others lon and lat; give one kind")
    if not rows:
        faults.append("has no pins; give at least 2, and 3 to tell the map from its mirror image")
    if faults:
        raise InputFileError(path=str(path), faults=faults)
    return tuple(pins)


def _contradictions(pins: Sequence[Pin]) -> list[str]:
    """List the things that are put at more than one place."""
    places: defaultdict[NamedPlace, set[tuple[float, float]]] = defaultdict(set)
    for pin in pins:
        places[pin.place].add(pin.at)
    return [
        f"{place} is put at {' and at '.join(f'{x:.10g},{y:.10g}' for x, y in sorted(at))}; give it one place"
        for place, at in places.items()
        if len(at) > 1
    ]


def place_pins(pins: Sequence[Pin], sketch: MapSketch) -> Pinned:
    """Find pins on a map and fit a frame to those of each component.

    Raises
    ------
    PlaceError
        The map does not show what a pin names.
    PinsError
        The pins of a component do not fix where it lies, or lie too far apart for a plane.
    """
    known, plane = _to_metres(pins)
    found = [find_place(pin.place, sketch) for pin in pins]
    by_component: defaultdict[int, list[int]] = defaultdict(list)
    for number, place in enumerate(found):
        by_component[place.component].append(number)
    fits: dict[int, PinFit] = {}
    problems, warnings = [], []
    residuals: dict[int, float] = {}
    for component, numbers in sorted(by_component.items()):
        where = f"component {component}: " if len(sketch.cover_radii) > 1 else ""
        try:
            fit = fit_pins(np.array([found[k].xy for k in numbers]), known[numbers], [found[k].name for k in numbers])
        except PinsError as error:
            problems += [where + problem for problem in error.problems]
            continue
        fits[component] = fit
        residuals |= dict(zip(numbers, fit.residuals.tolist(), strict=True))
        warnings += [where + warning for warning in (*fit.warnings, *_warn_of_scale(fit, sketch.length_unit))]
    if problems:
        raise PinsError(problems=problems)
    left_out = [component for component in range(len(sketch.cover_radii)) if component not in fits]
    if left_out:
        warnings.append(
            f"no pins are in component {', '.join(map(str, left_out))}, so where that lies in the operator's frame is not known"
        )
    placed = (
        PlacedPin(pin=pin, found=place, known_m=(float(at[0]), float(at[1])), residual_m=residuals.get(number))
        for number, (pin, place, at) in enumerate(zip(pins, found, known, strict=True))
    )
    return Pinned(frame=OperatorFrame(fits=fits, plane=plane), pins=tuple(placed), warnings=tuple(warnings))


def know_places(assumptions: Sequence[Assumption], pinned: Pinned) -> tuple[Assumption, ...]:
    """Say of what a map rests on that places are known, if the pins tell the map from its mirror image; with what else they told."""
    if not all(fit.is_handed for fit in pinned.frame.fits.values()):
        return tuple(assumptions)
    text = f"{len(pinned.pins)} pins say where the map lies" + "".join(f"; {warning}" for warning in pinned.warnings)
    known = Assumption(name=KNOWN_PLACES, holds=True, text=text)
    return tuple(known if one.name == KNOWN_PLACES else one for one in assumptions)


def _to_metres(pins: Sequence[Pin]) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.float64]], TangentPlane | None]:
    at = np.array([pin.at for pin in pins], dtype=np.float64).reshape(-1, 2)
    if not pins or not pins[0].is_geographic:
        return at, None
    # About the first pin, so that a swarm at the date line has one middle.
    off = at - at[0]
    off[:, 0] = (off[:, 0] + 180.0) % 360.0 - 180.0
    lon, lat = (at[0] + off.mean(axis=0)).tolist()
    plane = TangentPlane(lon=(lon + 180.0) % 360.0 - 180.0, lat=lat)
    metres = plane.to_metres(at)
    furthest = float(np.hypot(*metres.T).max())
    if furthest > MAX_TANGENT_M:
        problem = f"pins lie up to {furthest / 1e3:.0f} km from their middle; wanted at most {MAX_TANGENT_M / 1e3:.0f} km; is one mistyped?"
        raise PinsError(problems=[problem])
    return metres, plane


def _warn_of_scale(fit: PinFit, length_unit: str) -> list[str]:
    scale = fit.similarity.scale
    if length_unit != "m" or 1.0 / _WARN_SCALE <= scale <= _WARN_SCALE:
        return []
    return [f"lengths by the pins are {scale:.3g} times those of the map; is the walking speed right, and are the pins?"]


def _make_pin(row: _Row) -> Pin:
    named = [name for name in _NAMES if getattr(row, name) is not None]
    if len(named) != 1:
        raise ValueError(f"names {' and '.join(named) or 'nothing'}; wanted one of landmark, biobot (with t_s) or point")
    if not all(value is None or isfinite(value) for value in (row.t_s, row.x, row.y, row.lon, row.lat)):
        raise ValueError("has a number that is not finite")
    place: NamedPlace
    if row.landmark is not None:
        place = LandmarkPlace(node=str(row.landmark), t_s=row.t_s)
    elif row.biobot is not None:
        if row.t_s is None:
            raise ValueError(f"says where biobot {row.biobot} was, but not when; add t_s in seconds of the map's clock")
        place = BiobotPlace(node=str(row.biobot), t_s=row.t_s)
    else:
        if row.t_s is not None:
            raise ValueError("has t_s, but a point of the map has its time")
        place = PointPlace(index=row.point or 0)
    flat, geographic = (row.x, row.y), (row.lon, row.lat)
    if None not in flat and geographic == (None, None):
        return Pin(place=place, at=(float(row.x or 0.0), float(row.y or 0.0)), is_geographic=False)
    if None not in geographic and flat == (None, None):
        lon, lat = float(row.lon or 0.0), float(row.lat or 0.0)
        if not (-180.0 <= lon <= 360.0 and -89.0 <= lat <= 89.0):
            raise ValueError(f"lon {lon:g}, lat {lat:g}; wanted degrees from -180 to 360 and from -89 to 89")
        return Pin(place=place, at=(lon, lat), is_geographic=True)
    raise ValueError("wants x and y in metres, or lon and lat in degrees, and not both")


def _read_rows(path: Path) -> list[_Row]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputFileError(path=str(path), faults=[f"is larger than {_MAX_BYTES} bytes; is it a file of pins?"])
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = (error.strerror or str(error)).lower() if isinstance(error, OSError) else "is no UTF-8 text"
        raise InputFileError(path=str(path), faults=[f"cannot be read: {reason}"]) from error
    try:
        match path.suffix.lower():
            case ".toml":
                rows = msgspec.convert(tomllib.loads(text), _File).pins
            case ".json":
                document = json.loads(text)
                rows = msgspec.convert(document if isinstance(document, dict) else {"pins": document}, _File).pins
            case ".csv":
                rows = _read_csv(text)
            case other:
                raise InputFileError(path=str(path), faults=[f"has the ending {other!r}; wanted .toml, .json or .csv"])
    except (tomllib.TOMLDecodeError, ValueError, RecursionError, msgspec.ValidationError, csv.Error) as error:
        raise InputFileError(path=str(path), faults=[str(error)]) from error
    if len(rows) > _MAX_PINS:
        raise InputFileError(path=str(path), faults=[f"has {len(rows)} pins; wanted at most {_MAX_PINS}"])
    return rows


def _read_csv(text: str) -> list[_Row]:
    reader = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True)
    unknown = [name for name in reader.fieldnames or () if name not in _COLUMNS]
    if unknown or not reader.fieldnames:
        raise ValueError(f"has columns {', '.join(map(repr, unknown)) or 'none'}; wanted some of {', '.join(_COLUMNS)}")
    rows = []
    for row in reader:
        given = {name: value.strip() for name, value in row.items() if isinstance(value, str) and value.strip()}
        if None in row:  # the csv module's key for what is beyond the header
            raise ValueError(f"line {reader.line_num}: has more values than the header has columns")
        if given:
            try:
                rows.append(_Row(**{name: _value(name, value) for name, value in given.items()}))  # type: ignore[arg-type]  # by name
            except ValueError as error:
                raise ValueError(f"line {reader.line_num}: {error}") from error
    return rows


def _value(name: str, text: str) -> int | float | str:
    if name in {"landmark", "biobot"}:
        return text
    if name == "point":
        if not (text.isascii() and text.isdigit() and len(text) <= 20 and int(text) < 2**63):
            raise ValueError(f"{name} is {text!r}; wanted a whole number")
        return int(text)
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"{name} is {text!r}; wanted a number") from error
