"""The kernels' C interface as ctypes sees it: structures, functions, and the library that was built when the package was installed."""

import ctypes
import zlib
from ctypes import POINTER, c_double, c_int, c_int32, c_int64, c_void_p
from pathlib import Path

import numpy as np

LIBRARY = Path(__file__).with_name("_kernels.so")

SPELL = np.dtype([("node", "i8"), ("begin", "i8"), ("end", "i8")])

_Array = c_void_p


class Graph(ctypes.Structure):
    """``graph`` of kernels.h, field by field."""

    _fields_ = (
        ("n_vertices", c_int32),
        ("n_components", c_int32),
        ("n_links", c_int64),
        ("n_edges", c_int64),
        ("vertex_of", _Array),
        ("first_encounter", _Array),
        ("multiplicity", _Array),
        ("is_landmark", _Array),
        ("component", _Array),
        ("link_from", _Array),
        ("link_to", _Array),
        ("link_time", _Array),
        ("link_before", _Array),
        ("row_start", _Array),
        ("neighbour", _Array),
        ("time", _Array),
    )


_ROWS = (_Array, _Array, _Array)
_LEAVES = (_Array, c_int32, c_int32, c_int32, c_int32)
_TREE = (_Array, _Array, _Array, _Array)

# Name: result, arguments.
_FUNCTIONS = {
    "build_graph": (c_int, (_Array, _Array, _Array, c_int32, _Array, c_int64, _Array, c_int64, c_int32, POINTER(Graph))),
    "sweep_times": (c_int, (c_int64, _Array, _Array, _Array, c_int32, c_int32, _Array, _Array)),
    "sum_neighbours": (c_int, (*_ROWS, _Array, c_int32, c_int32, c_int32, c_int64, _Array)),
    "pick_maxmin": (
        c_int32,
        (*_ROWS, c_int32, c_int32, _Array, _Array, _Array, c_int32, _Array, _Array, POINTER(c_int32), POINTER(c_double)),
    ),
    "bracket": (c_int, (_Array, c_int64, c_int32, _Array, _Array)),
    "pick_profiles": (c_int32, (_Array, c_int64, c_int32, c_int32, c_int32, _Array, _Array, POINTER(c_double))),
    "read_rows": (c_int64, (_Array, c_int64, _Array, c_int64, c_int64, c_int64, _Array, _Array, _Array, _Array)),
    "count_lines": (c_int64, (_Array, c_int64)),
    "plant_tree": (c_int, (*_LEAVES, _Array, _Array, c_int32, *_TREE, POINTER(c_double))),
    "average_nearest": (c_int, (*_LEAVES, *_TREE, c_double, c_int32, c_int32, c_int32, _Array)),
    "settle_tracks": (
        c_int,
        (c_int32, c_int64, *(_Array,) * 6, c_double, c_double, c_double, c_int32, c_int32, _Array),
    ),
    "kernels_layout": (c_int64, ()),
    "kernels_sources": (c_int64, ()),
}


class LibraryMissing(Exception):  # noqa: N818  # a reason, which never leaves this package
    """The library was not built, cannot be loaded here, or is of other sources than this file."""


def load_library() -> ctypes.CDLL:
    """Load the library.

    Raises
    ------
    LibraryMissing
        See there.
    """
    try:
        library = ctypes.CDLL(str(LIBRARY))
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        layout, sources = int(library.kernels_layout()), int(library.kernels_sources())
    except (OSError, AttributeError) as error:
        raise LibraryMissing(str(error)) from error
    if layout != 1000 * ctypes.sizeof(Graph) + SPELL.itemsize or sources != _sum_sources():
        raise LibraryMissing(f"{LIBRARY} was built from other sources than are installed")
    return library


def _sum_sources() -> int:
    """Return the CRC-32 of the C sources as they are installed, as hatch_build.py does; an upgrade may have left an old library."""
    total = 0
    for path in sorted((*LIBRARY.parent.glob("*.c"), *LIBRARY.parent.glob("*.h"))):
        total = zlib.crc32(path.read_bytes(), total)
    return total
