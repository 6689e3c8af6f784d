"""The mapper's kernels: one set of functions, compiled from C where that was possible, plain numpy and scipy elsewhere; same results."""

from mapper.kernels.arrays import Contraction, Links, Picks, Rows, Stands, Tension, VertexArray
from mapper.kernels.choice import KERNELS_VARIABLE, Kernels, choose_kernels, find_library
from mapper.kernels.encounter_rows import read_rows

__all__ = [
    "KERNELS_VARIABLE",
    "Contraction",
    "Kernels",
    "Links",
    "Picks",
    "Rows",
    "Stands",
    "Tension",
    "VertexArray",
    "choose_kernels",
    "find_library",
    "read_rows",
]
