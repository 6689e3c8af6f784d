"""The engine's C interface as ctypes sees it: structures, functions, and the library that was built when the package was installed."""

import ctypes
import zlib
from ctypes import POINTER, c_double, c_int32, c_int64, c_uint64, c_void_p
from pathlib import Path

import numpy as np

from simulator.errors import EngineMissingError

LIBRARY = Path(__file__).with_name("_engine.so")

EVENT = np.dtype(
    [("t_s", "f8"), ("met_s", "f8"), ("kind", "i4"), ("first", "i4"), ("second", "i4"), ("cause", "i4")],
)
LEG = np.dtype([("t_start_s", "f8"), ("t_end_s", "f8"), ("x", "f8"), ("y", "f8"), ("vx", "f8"), ("vy", "f8"), ("row", "i8")])

KIND_MODE, KIND_END, KIND_BEGIN, KIND_SILENCED = range(4)


class EngineConfig(ctypes.Structure):
    """``engine_config`` of engine.h, field by field."""

    _fields_ = (
        ("seed", c_uint64),
        ("speed", c_double),
        ("wall_speed", c_double),
        ("leg_scale", c_double),
        ("levy_exponent", c_double),
        ("longest_leg", c_double),
        ("persistence", c_double),
        ("detection", c_double),
        ("contact", c_double),
        ("stop_open", c_double),
        ("stop_wall", c_double),
        ("rest_short", c_double),
        ("rest_long", c_double),
        ("share_long", c_double),
        ("social_stop", c_double),
        ("social_rest", c_double),
        ("exit_wall", c_double),
        ("departure_median", c_double),
        ("departure_log_sd", c_double),
        ("mishap", c_double),
        ("mishap_rest", c_double),
        ("rescue", c_double),
        ("death", c_double),
        ("period", c_double),
        ("wall_law", c_int32),
        ("contact_turns", c_int32),
    )


_WALLS = (c_int32, c_void_p, c_void_p, c_void_p, c_void_p, c_double)

# Name: result, arguments.
_FUNCTIONS = {
    "engine_create": (c_void_p, (POINTER(EngineConfig), c_int32, c_void_p, c_void_p, c_void_p)),
    "engine_free": (None, (c_void_p,)),
    "engine_set_walls": (c_int32, (c_void_p, *_WALLS)),
    "engine_start": (c_int32, (c_void_p, c_double, c_double, c_double, c_double)),
    "engine_advance": (c_int32, (c_void_p, c_double, c_int64)),
    "engine_count": (c_int32, (c_void_p,)),
    "engine_replace_walls": (c_int32, (c_void_p, *_WALLS, c_void_p)),
    "engine_stop": (c_int32, (c_void_p, c_int32, c_int32)),
    "engine_go": (c_int32, (c_void_p, c_int32, c_int32)),
    "engine_turn": (c_int32, (c_void_p, c_int32, c_double, c_double)),
    "engine_follow_walls": (c_int32, (c_void_p, c_int32, c_int32)),
    "engine_silence": (c_int32, (c_void_p, c_int32)),
    "engine_modes": (None, (c_void_p, c_void_p, c_void_p)),
    "engine_current_legs": (None, (c_void_p, c_void_p)),
    "engine_take_events": (c_int64, (c_void_p, POINTER(c_void_p))),
    "engine_take_legs": (c_int64, (c_void_p, POINTER(c_void_p))),
    "engine_open": (c_int64, (c_void_p, c_void_p, c_int64)),
    "engine_steps": (c_int64, (c_void_p,)),
    "engine_work": (c_int64, (c_void_p,)),
    "engine_now": (c_double, (c_void_p,)),
    "engine_save": (c_int64, (c_void_p, c_void_p, c_int64)),
    "engine_load": (c_void_p, (c_void_p, c_int64)),
    "engine_layout": (c_int64, ()),
    "engine_sources": (c_int64, ()),
}


def load_library() -> ctypes.CDLL:
    """Load the engine.

    Raises
    ------
    EngineMissingError
        It was not built, or cannot be loaded here, or is of another version than this file.
    """
    try:
        library = ctypes.CDLL(str(LIBRARY))
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        layout, sources = int(library.engine_layout()), int(library.engine_sources())
    except (OSError, AttributeError) as error:
        raise EngineMissingError(path=LIBRARY, problem=str(error)) from error
    if layout != 10_000 * ctypes.sizeof(EngineConfig) + 100 * EVENT.itemsize + LEG.itemsize or sources != _sum_sources():
        raise EngineMissingError(path=LIBRARY, problem="it was built from other sources than are installed")
    return library


def _sum_sources() -> int:
    """Return the CRC-32 of the C sources as they are installed, as hatch_build.py does; an upgrade may have left an old library."""
    total = 0
    for path in sorted((*LIBRARY.parent.glob("*.c"), *LIBRARY.parent.glob("*.h"))):
        total = zlib.crc32(path.read_bytes(), total)
    return total
