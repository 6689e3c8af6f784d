"""Which kernels are used: the compiled ones where the library is there, else the plain ones; ``BIOBOT_KERNELS`` may ask for either."""

import ctypes
import os
from functools import cache
from typing import Protocol

from firmware_protocol.errors import ConfigurationError
from mapper.errors import KernelsError
from mapper.kernels.arrays import Contraction, Links, Picks, Rows, Stands, Tension, VertexArray
from mapper.kernels.binding import LibraryMissing, load_library
from mapper.kernels.compiled import CompiledKernels
from mapper.kernels.plain import PlainKernels
from mapper.types import BoolArray, FloatArray, IntArray, KernelsKind, ProfileNorm

KERNELS_VARIABLE = "BIOBOT_KERNELS"
"""Name of the environment variable."""

_INSTALL = "install gcc and libc6-dev and install the package again"


class Kernels(Protocol):
    """The computations that grow with the number of encounters. All are pure; what is said here holds for every implementation."""

    @property
    def name(self) -> KernelsKind:
        """Which implementation this is."""

    @property
    def shortfall(self) -> str | None:
        """Why it is the slow one, and what to do about it; None where it is not."""

    def contract(
        self, centres: IntArray, id1: IntArray, id2: IntArray, *, still: Stands, commanded: Stands, moving_time: bool
    ) -> Contraction:
        """Join consecutive encounters of each biobot, and contract what lies at distance zero ([Dir16] eq. 6-7).

        ``centres`` [ticks since the origin], not negative, have shape (n,); ``still`` are all static spells, ``commanded`` make landmarks.
        """

    def sweep_times(self, links: Links, *, n_vertices: int, sources: IntArray) -> FloatArray:
        """Measure shortest-path times [ticks] from every vertex to some distinct ones: shape (v, sources); inf where there is no path."""

    def sum_neighbour_times(self, rows: Rows, multiplicity: VertexArray, *, k: int) -> FloatArray:
        """Sum the times from an encounter of each vertex to the k encounters nearest to it [ticks], shape (v,); see `mapper.outliers`."""

    def pick_along_graph(self, rows: Rows, links: Links, candidates: BoolArray, *, hubs: IntArray, n_points: int) -> Picks:
        """Pick maxmin vertices of a connected graph by shortest-path time; see `mapper.subsampling`. ``hubs`` are on many paths.

        The graph need not be connected; of no candidates none is picked, with a cover radius of 0; the same holds of `pick_profiles`.
        """

    def bracket(self, times: FloatArray, references: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return middle (v, l) and doubt (v,) of bounds on profiles; see `mapper.profiles`. ``times`` may be overwritten."""

    def pick_profiles(self, profiles: FloatArray, *, norm: ProfileNorm, n_points: int) -> Picks:
        """Pick maxmin rows of profiles, shape (c, l), l at least 1; see `mapper.subsampling`."""

    def average_nearest(self, profiles: FloatArray, *, n_nearest: int) -> FloatArray:
        """Average the rows nearest to each row of profiles, shape (c, l), itself among them: shape (c, l).

        ``n_nearest`` from 1 to c. Nearness is Euclidean; ties go to the earlier row. Values are finite, and no two that differ are nearer
        than 1e-150 or further apart than 1e150.
        """

    def settle_tracks(self, links: Links, start: FloatArray, pull: FloatArray, *, tension: Tension, rounds: int, steps: int) -> FloatArray:
        """Move places in the plane, shape (v, 2), to where the links between them want them; see `mapper.placement`.

        ``pull``, shape (v,), above 0, draws each to where it starts; ``rounds`` times all is weighed by how well it fits, and ``steps``
        steps of conjugate gradients are made. Sums are made in the order of the links.
        """


def choose_kernels(choice: KernelsKind | None = None) -> Kernels:
    """Return the kernels asked for, by argument or else by the environment; "auto" takes the compiled ones where they are.

    Raises
    ------
    ConfigurationError
        The choice is none of the three.
    KernelsError
        Compiled kernels are asked for and not there.
    """
    return _choose(os.environ.get(KERNELS_VARIABLE, KernelsKind.AUTO) if choice is None else choice)


@cache
def _choose(asked: str) -> Kernels:
    if asked not in set(KernelsKind):
        raise ConfigurationError([f"{KERNELS_VARIABLE} is {asked!r}; set it to {', '.join(KernelsKind)}, or not at all"])
    if asked == KernelsKind.PLAIN:
        return PlainKernels(reason=f"they were asked for; set {KERNELS_VARIABLE} to {KernelsKind.AUTO} for the compiled ones")
    try:
        return CompiledKernels(load_library())
    except LibraryMissing as error:
        if asked == KernelsKind.COMPILED:
            raise KernelsError(
                problem=f"no compiled kernels: {error}", next_step=f"{_INSTALL}, or leave the choice to the program"
            ) from error
        return PlainKernels(reason=f"no compiled ones: {error}; {_INSTALL}")


def find_library(choice: KernelsKind | None = None) -> ctypes.CDLL | None:
    """Return the library of the kernels that `choose_kernels` returns, None where they have none; raises what it raises."""
    kernels = choose_kernels(choice)
    return kernels.library if isinstance(kernels, CompiledKernels) else None
