"""Which way of bulk decoding is used: the compiled one where its library is there, else the plain one. Both say the same."""

import ctypes
from functools import cache
from typing import Protocol

from gateway.bulk.columns import Columns
from gateway.bulk.compiled import CompiledDecoder, LibraryMissing, load_library
from gateway.bulk.plain import PlainDecoder


class Decoder(Protocol):
    """Decodes a stream of native frames; any chunking gives the same columns, one after another. Large chunks are fast."""

    def feed(self, chunk: bytes) -> Columns:
        """Take the next bytes of the stream; return what became of the frames they complete."""
        ...


def make_decoder(*, is_bare: bool = False) -> Decoder:
    """Make a decoder of what a native dongle writes to its line, or, ``is_bare``, of frames whose bodies are radio payloads."""
    library = _load()
    return CompiledDecoder(library, is_bare=is_bare) if isinstance(library, ctypes.CDLL) else PlainDecoder(is_bare=is_bare)


def why_plain() -> str | None:
    """Tell why decoding is slow, and what to do about it; None where it is not."""
    library = _load()
    return None if isinstance(library, ctypes.CDLL) else f"{library}; install gcc and libc6-dev and install the package again"


@cache
def _load() -> ctypes.CDLL | LibraryMissing:
    try:
        return load_library()
    except LibraryMissing as missing:
        return missing
