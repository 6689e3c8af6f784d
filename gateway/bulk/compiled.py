"""Bulk decoding in C, through ctypes: the portable sources of ``firmware_protocol/c``, compiled when the package was installed."""

import ctypes
import zlib
from ctypes import c_uint32, c_void_p
from pathlib import Path

from gateway.bulk.columns import OF_ENTRIES, OF_FRAMES, Column, Columns

LIBRARY = Path(__file__).with_name("_bulk.so")
_C_FOLDER = Path(__file__).resolve().parents[2] / "firmware_protocol" / "c"
_SOURCES = ("biobot_codec.c", "biobot_codec.h", "biobot_crc.c", "biobot_crc.h", "biobot_frame.c", "biobot_frame.h", "biobot_layouts.c",
            "biobot_layouts.h", "bulk/biobot_bulk.c", "bulk/biobot_bulk.h")  # fmt: skip

_DECODER_SIZE = 256
_MOST_ENTRIES = 4
_LEAST_FRAME_SIZE = 2
"""Fewest octets of input that a frame, or what was none, takes: one and its delimiter."""

_FRAMES_A_CALL = 1 << 16


class _ColumnPointers(ctypes.Structure):
    """``bb_bulk_columns``."""

    _fields_ = (
        ("frames_size", c_uint32),
        ("entries_size", c_uint32),
        ("first_entry", c_uint32),
        ("status", c_void_p),
        ("type", c_void_p),
        ("lqi", c_void_p),
        ("rssi_dbm", c_void_p),
        ("source", c_void_p),
        ("node", c_void_p),
        ("boot", c_void_p),
        ("sequence", c_void_p),
        ("sent_ms", c_void_p),
        ("entries_end", c_void_p),
        ("peer", c_void_p),
        ("start_ms", c_void_p),
        ("duration_ms", c_void_p),
        ("is_ongoing", c_void_p),
        ("entry_rssi_dbm", c_void_p),
        ("path_mm", c_void_p),
    )


class _Progress(ctypes.Structure):
    """``bb_bulk_progress``."""

    _fields_ = (("n_bytes", c_uint32), ("n_frames", c_uint32), ("n_entries", c_uint32))


class LibraryMissing(Exception):  # noqa: N818  # a reason, which never leaves this package
    """The library was not built, cannot be loaded here, or is of other sources than this file."""


def load_library(path: Path = LIBRARY) -> ctypes.CDLL:
    """Load the library, or one that was built of the same sources elsewhere.

    Raises
    ------
    LibraryMissing
        See there.
    """
    try:
        library = ctypes.CDLL(str(path))
        library.bulk_decode.restype = library.bulk_start.restype = None
        library.bulk_start.argtypes = (c_void_p,)
        library.bulk_decode.argtypes = (c_void_p, c_void_p, c_uint32, ctypes.c_bool, c_void_p, c_void_p)
        library.bulk_layout.restype = library.bulk_sources.restype = ctypes.c_int64
        layout, sources = int(library.bulk_layout()), int(library.bulk_sources())
    except (OSError, AttributeError) as error:
        raise LibraryMissing(str(error)) from error
    own = 1_000_000 * _DECODER_SIZE + 1000 * ctypes.sizeof(_ColumnPointers) + ctypes.sizeof(_Progress)
    if layout != own or sources != _sum_sources():
        raise LibraryMissing(f"{path} was built from other sources than are installed")
    return library


class CompiledDecoder:
    """See the module and ``decoder.Decoder``."""

    def __init__(self, library: ctypes.CDLL, *, is_bare: bool) -> None:
        self._library = library
        self._is_bare = is_bare
        self._memory = ctypes.create_string_buffer(_DECODER_SIZE)
        library.bulk_start(self._memory)

    def feed(self, chunk: bytes) -> Columns:
        """Take the next bytes of the stream; return what became of the frames they complete."""
        columns = Columns()
        data = ctypes.c_char_p(chunk)
        address = ctypes.cast(data, c_void_p).value or 0
        at = 0
        while at < len(chunk):
            at += self._decode(columns, address + at, len(chunk) - at)
        return columns

    def _decode(self, columns: Columns, address: int, length: int) -> int:
        length = min(length, 0xFFFF_FFFF)
        n_frames = min(length // _LEAST_FRAME_SIZE + 1, _FRAMES_A_CALL)
        n_entries = n_frames + _MOST_ENTRIES
        room = Columns()
        pointers = _ColumnPointers(frames_size=n_frames, entries_size=n_entries, first_entry=len(columns.peer))
        for names, size in ((OF_FRAMES, n_frames), (OF_ENTRIES, n_entries)):
            for name in names:
                column: Column = getattr(room, name)
                column.frombytes(bytes(size * column.itemsize))
                setattr(pointers, name, column.buffer_info()[0])
        progress = _Progress()
        self._library.bulk_decode(self._memory, address, length, self._is_bare, ctypes.byref(pointers), ctypes.byref(progress))
        for names, size in ((OF_FRAMES, progress.n_frames), (OF_ENTRIES, progress.n_entries)):
            for name in names:
                column = getattr(room, name)
                del column[size:]
                getattr(columns, name).extend(column)
        return int(progress.n_bytes)


def _sum_sources() -> int:
    """Return the CRC-32 of the C sources as they are installed, as hatch_build.py does; an upgrade may have left an old library."""
    total = 0
    for path in (*sorted(LIBRARY.parent.glob("*.c")), *(_C_FOLDER / name for name in _SOURCES)):
        total = zlib.crc32(path.read_bytes(), total)
    return total
