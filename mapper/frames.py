"""Frames of the operator: where a map lies in them, as fixed by pins, and how to get from metres to degrees.

A map made of encounters has no place, no direction and no handedness, and without a walking speed no unit. Known places of some of what it
shows, the *pins*, fix all of these by a similarity: turn, mirror if need be, scale, and move.
"""

from dataclasses import dataclass, field
from math import cos, degrees, radians, sin, sqrt

import numpy as np

from mapper.errors import PinsError
from mapper.types import FloatArray

# Of the spread of pins across their main direction to that along it: with less they are on one line.
_LEAST_WIDTH = 0.02
# The mirrored fit must be worse by this factor, or which one is right is not certain.
_CLEARLY_WORSE = 2.0
_FALSE_ALARMS = 0.02
_LEAST_FOR_OUTLIER = 4
# WGS 84: semi-major axis [m] and flattening (NGA.STND.0036, table 3.1).
_SEMI_MAJOR_M, _FLATTENING = 6_378_137.0, 1.0 / 298.257_223_563
MAX_TANGENT_M = 50_000.0
"""A plane of this radius departs from the ellipsoid by less than 1 in 10,000 in lengths [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Similarity:
    """Maps ``z`` to ``scale * turn(mirror(z)) + shift``: mirror at the x axis where ``is_mirrored``, then turn counter-clockwise."""

    scale: float
    turn_rad: float
    is_mirrored: bool
    shift: tuple[float, float]

    def __call__(self, places: FloatArray) -> FloatArray:
        """Take places, shape (k, 2), to the other frame."""
        return np.asarray(places @ self.matrix.T + np.array(self.shift))

    @property
    def matrix(self) -> FloatArray:
        """Return the linear part, shape (2, 2)."""
        c, s = self.scale * cos(self.turn_rad), self.scale * sin(self.turn_rad)
        sign = -1.0 if self.is_mirrored else 1.0
        return np.array([[c, -s * sign], [s, c * sign]])

    def inverse(self) -> "Similarity":
        """Return the way back."""
        turn_rad = self.turn_rad if self.is_mirrored else -self.turn_rad
        plain = Similarity(scale=1.0 / self.scale, turn_rad=turn_rad, is_mirrored=self.is_mirrored, shift=(0.0, 0.0))
        x, y = (-plain(np.array([self.shift]))[0]).tolist()
        return Similarity(scale=plain.scale, turn_rad=turn_rad, is_mirrored=self.is_mirrored, shift=(x, y))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PinFit:
    """Where a component lies in the operator's frame.

    Parameters
    ----------
    similarity
        From map coordinates to those of the operator [m].
    residuals
        How far each pin is from where the fit puts it [m], shape (n,).
    is_handed
        Whether the pins say which of the map and its mirror image is meant: two cannot.
    warnings
        What the operator should know of the fit.
    """

    similarity: Similarity
    residuals: FloatArray
    is_handed: bool
    warnings: tuple[str, ...] = field(default=())

    @property
    def rms(self) -> float:
        """Root mean square of the residuals [m]."""
        return float(np.sqrt(np.mean(self.residuals**2)))


def fit_pins(on_map: FloatArray, known: FloatArray, names: list[str]) -> PinFit:
    """Fit the similarity that brings pins of one component to their known places, by least squares.

    Parameters
    ----------
    on_map, known
        Where each is on the map [unit of the map], and where it is known to be [m], shapes (n, 2).
    names
        What to call them, length n.

    Raises
    ------
    PinsError
        Fewer than two pins, pins at one place, or three and more on one line.

    Notes
    -----
    Two pins fix all but the handedness: the map is then taken as it is, and a warning says so. With four and more, a pin that the others
    contradict is named, but not left out.

    References
    ----------
    The best similarity in closed form, as by Umeyama 1991, in complex numbers.
    """
    n = len(known)
    if n < 2:
        raise PinsError(problems=[f"{n} pin, {', '.join(names) or 'none'}: wanted at least 2, and 3 to tell the map from its mirror image"])
    for places, where in ((known, "known places"), (on_map, "places on the map")):
        along, across = _spread(places)
        if along <= 1e-9 * (1.0 + float(np.abs(places).max())):
            raise PinsError(problems=[f"the {where} of {', '.join(names)} are one; pin places that are far apart"])
        if n > 2 and across < _LEAST_WIDTH * along:
            problem = (
                f"the {where} of {', '.join(names)} are on one line ({across:.3g} across, {along:.3g} along): a map and its mirror image "
                "fit them alike; add a pin off that line, or give two pins and choose the handedness by eye"
            )
            raise PinsError(problems=[problem])
    plain, mirrored = (_fit(on_map, known, is_mirrored=is_mirrored) for is_mirrored in (False, True))
    if n == 2:
        warning = "two pins fix place, scale and direction, but a map and its mirror image fit them alike: add a third pin off their line"
        return PinFit(similarity=plain, residuals=_residuals(plain, on_map, known), is_handed=False, warnings=(warning,))
    costs = [float(np.sqrt(np.mean(_residuals(fit, on_map, known) ** 2))) for fit in (plain, mirrored)]
    best = plain if costs[0] <= costs[1] else mirrored
    warnings = []
    is_handed = max(costs) > _CLEARLY_WORSE * min(costs)
    if not is_handed:
        warnings.append(
            f"the pins fit the map ({costs[0]:.3g} m rms) and its mirror image ({costs[1]:.3g} m rms) about alike; "
            "check one of them, or pin places further apart"
        )
    warnings += _name_outlier(on_map, known, names)
    return PinFit(similarity=best, residuals=_residuals(best, on_map, known), is_handed=is_handed, warnings=tuple(warnings))


@dataclass(frozen=True, slots=True, kw_only=True)
class TangentPlane:
    """Metres east and north of an origin on the WGS 84 ellipsoid, and degrees: the plane that touches it there.

    Notes
    -----
    Degrees are scaled by the radii of curvature at the origin; within ``MAX_TANGENT_M`` lengths are right to 1 in 10,000 outside the polar
    regions (Snyder 1987, eq. 4-18 to 4-20).
    """

    lon: float
    lat: float

    def _metres_per_degree(self) -> FloatArray:
        squared = _FLATTENING * (2.0 - _FLATTENING)
        root = sqrt(1.0 - squared * sin(radians(self.lat)) ** 2)
        east = _SEMI_MAJOR_M / root * cos(radians(self.lat))
        north = _SEMI_MAJOR_M * (1.0 - squared) / root**3
        return np.array([radians(east), radians(north)])

    def to_metres(self, lon_lat: FloatArray) -> FloatArray:
        """Take longitudes and latitudes [degrees], shape (k, 2), to metres east and north; across the date line, too."""
        off = lon_lat - np.array([self.lon, self.lat])
        off[:, 0] = (off[:, 0] + 180.0) % 360.0 - 180.0
        return np.asarray(off * self._metres_per_degree())

    def to_degrees(self, metres: FloatArray) -> FloatArray:
        """Invert `to_metres`; longitudes are from -180 to 180."""
        found = metres / self._metres_per_degree() + np.array([self.lon, self.lat])
        found[:, 0] = (found[:, 0] + 180.0) % 360.0 - 180.0
        return np.asarray(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorFrame:
    """The operator's frame [m], and the components that pins place in it, by their numbers; ``plane`` None: metres are all there is."""

    fits: dict[int, PinFit]
    plane: TangentPlane | None

    def metres(self, places: FloatArray, *, component: int) -> FloatArray:
        """Take places of a pinned component, shape (k, 2), from map coordinates to metres of the frame."""
        return self.fits[component].similarity(places)

    def coordinates(self, places: FloatArray, *, component: int) -> FloatArray:
        """Take them to what the operator gave: metres, or longitude and latitude."""
        metres = self.metres(places, component=component)
        return metres if self.plane is None else self.plane.to_degrees(metres)


def describe_turn(similarity: Similarity) -> float:
    """Return the turn in degrees, from -180 to 180."""
    return float((degrees(similarity.turn_rad) + 180.0) % 360.0 - 180.0)


def _fit(on_map: FloatArray, known: FloatArray, *, is_mirrored: bool) -> Similarity:
    """Fit ``known = a z + b`` in complex numbers, of z or its conjugate."""
    z = on_map[:, 0] + 1j * (-on_map[:, 1] if is_mirrored else on_map[:, 1])
    w = known[:, 0] + 1j * known[:, 1]
    centred = z - z.mean()
    factor = complex(np.vdot(centred, w - w.mean()) / np.vdot(centred, centred))
    if abs(factor) == 0.0:
        factor = complex(np.finfo(np.float64).tiny)
    shift = complex(w.mean() - factor * z.mean())
    return Similarity(
        scale=abs(factor), turn_rad=float(np.angle(factor)), is_mirrored=is_mirrored, shift=(float(shift.real), float(shift.imag))
    )


def _residuals(fit: Similarity, on_map: FloatArray, known: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(*(fit(on_map) - known).T))


def _spread(places: FloatArray) -> tuple[float, float]:
    """Return the root mean square distances along and across the main direction."""
    widths = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / sqrt(len(places))
    return float(widths[0]), float(widths[1])


def _name_outlier(on_map: FloatArray, known: FloatArray, names: list[str]) -> list[str]:
    """Name the pin that lies further from where the others put it than they scatter; of three pins none can be told from the others.

    By an F test with 2 and ``2 m - 4`` degrees of freedom for m other pins, so that of maps whose pins are all right one in 50 is told one
    is not. Its tail is ``(1 + 2 f / d)^(-d / 2)``.
    """
    n = len(names)
    if n < _LEAST_FOR_OUTLIER:
        return []
    found = []
    # What is exact but for rounding is no outlier of anything.
    floor = (1e-9 * (1.0 + float(np.abs(known).max()))) ** 2
    for left_out in range(n):
        kept = np.arange(n) != left_out
        one = np.arange(left_out, left_out + 1)
        fits = [_fit(on_map[kept], known[kept], is_mirrored=is_mirrored) for is_mirrored in (False, True)]
        squares = [float((_residuals(fit, on_map[kept], known[kept]) ** 2).sum()) for fit in fits]
        # Where the others leave the handedness open, the pin may choose it.
        possible = [fit for fit, square in zip(fits, squares, strict=True) if square <= _CLEARLY_WORSE**2 * min(squares) + n * floor]
        off = min(float(_residuals(fit, on_map[one], known[one])[0]) for fit in possible)
        found.append((min(squares), off, left_out))
    total, off, worst = min(found)
    freedom = 2 * (n - 1) - 4
    variance = max(total / freedom, floor)
    others = on_map[np.arange(n) != worst]
    middle = others.mean(axis=0)
    leverage = 1.0 / (n - 1) + float(((on_map[worst] - middle) ** 2).sum() / ((others - middle) ** 2).sum())
    f = off**2 / (2.0 * variance * (1.0 + leverage))
    if (1.0 + 2.0 * f / freedom) ** (-freedom / 2.0) > _FALSE_ALARMS / n:
        return []
    rms = sqrt(total / (n - 1))
    return [f"{names[worst]} is {off:.3g} m from where the other {n - 1} pins put it, which agree within {rms:.3g} m rms; check its place"]
