"""Where the obstacle in a hole stands on the map, and how large it is: a closed polygon, its area and perimeter, and a place inside."""

from dataclasses import replace

import numpy as np

from mapper.hole_sizes import LoopMeasures, SizeModel, estimate_size
from mapper.polygons import boundary_length, convex_hull, inner_place, scale_to_area, signed_area, uncross
from mapper.types import FloatArray, Hole, IntArray, read_only


def shape_hole(hole: Hole, coordinates: FloatArray, distances: FloatArray, *, n_used: int, model: SizeModel | None) -> Hole:
    """Add polygon, centre and size to a hole.

    Parameters
    ----------
    hole
        Its outline has indices into ``coordinates``.
    coordinates, distances
        Of the points of the component, shapes (m, 2) and (m, m) [unit of the map].
    n_used
        Encounters that the points stand for.
    model
        Trained numbers for the method; None: the size is not estimated, and the polygon goes through the points around the hole.

    Notes
    -----
    The polygon has the form and the place of the outline drawn through the points around the hole, and the area that is estimated. It is
    simple and counter-clockwise. Where the outline crosses itself, its points are put in the order of a shorter one that does not. Where
    the points lie on one line in the picture there is no polygon, but there may be a perimeter.
    """
    drawn = draw_outline(coordinates[hole.outline])
    loop = measure_loop(hole.outline, coordinates, distances, birth=hole.birth, death=hole.death, n_used=n_used)
    size = None if model is None else estimate_size(loop, model)
    if size is not None:
        hole = replace(hole, perimeter=size.perimeter, perimeter_error=size.perimeter_error)
    if drawn is None:
        return hole
    if size is not None:
        drawn = scale_to_area(drawn, size.area)
        hole = replace(hole, area=size.area, area_error=size.area_error)
    return replace(hole, outline_xy=read_only(drawn), centre=read_only(inner_place(drawn)))


def draw_outline(corners: FloatArray) -> FloatArray | None:
    """Make the simple counter-clockwise polygon of an outline; None where its corners are on one line."""
    simple = uncross(corners)
    if simple is None:
        simple = convex_hull(corners)
    extent = float(np.ptp(corners, axis=0).max())
    return simple if len(simple) >= 3 and signed_area(simple) > np.finfo(np.float64).eps * extent**2 else None


def measure_loop(
    outline: IntArray, coordinates: FloatArray, distances: FloatArray, *, birth: float, death: float, n_used: int
) -> LoopMeasures:
    """Measure what the size of a hole is estimated from; parameters as in `shape_hole`."""
    drawn = draw_outline(coordinates[outline])
    diameter = float(distances.max())
    return LoopMeasures(
        birth=birth,
        death=death,
        loop_length=float(distances[outline, np.roll(outline, -1)].sum()),
        drawn_length=1.0 if drawn is None else boundary_length(drawn),
        drawn_area=0.0 if drawn is None else signed_area(drawn),
        encounters_per_point=n_used / len(distances),
        encounters_about=n_used * (death / diameter) ** 2,
    )
