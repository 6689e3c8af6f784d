"""What kernels take and give: graphs and subsamples as bare arrays. Times are in ticks, whole numbers in float64, exact up to 2**53."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapper.types import BoolArray, FloatArray, IntArray

VertexArray = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stands:
    """Times in which biobots stood still; all arrays have shape (m,).

    ``nodes`` ascending; ``begins`` and ``ends`` [ticks since the origin], both inside, ascending and disjoint for each node.
    """

    nodes: IntArray
    begins: IntArray
    ends: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Links:
    """Directed steps in the order of time: shape (k,) each; ``times`` [ticks], above 0. Two may join the same vertices.

    ``before`` is the step before of the same biobot, whose target is this one's source; -1 where there is none.
    """

    sources: VertexArray
    targets: VertexArray
    times: FloatArray
    before: VertexArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Edges by vertex, both ways, each once: ``starts``, shape (v + 1,), ``neighbours`` and ``times`` [ticks], shape (e,).

    A row is sorted by time, then by neighbour.
    """

    starts: IntArray
    neighbours: VertexArray
    times: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contraction:
    """A graph of v vertices, made of n encounters.

    ``vertex_of``, shape (n,), is the vertex of each encounter.
    ``first_encounter``, ``multiplicity``, ``is_landmark`` and ``component`` have shape (v,): the earliest encounter (ascending), how many
    there are, whether a landmark stood there, and the number of the connected component, in the order of their first vertices.
    """

    links: Links
    rows: Rows
    first_encounter: VertexArray
    multiplicity: VertexArray
    is_landmark: BoolArray
    component: VertexArray
    vertex_of: VertexArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picks:
    """Vertices or rows in order of choice, shape (m,), the distances between them, shape (m, m), and their cover radius."""

    chosen: IntArray
    distances: FloatArray
    cover_radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Tension:
    """How well links are believed when tracks are settled; lengths and times are in one unit, as speeds are 1.

    ``blur``: error of a place. ``drift``: error of a link's length, as a share of its time. ``swerve``: change of velocity without a turn.
    """

    blur: float
    drift: float
    swerve: float
