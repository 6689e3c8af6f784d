"""A finished map as bytes and back, for the process that draws it and for the store: plain data, nothing that could be run."""

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from mapper.types import MapResult

_ARRAYS = {"<f8": np.float64, "<i8": np.int64, "|b1": np.bool_}


def encode_map(result: MapResult) -> bytes:
    """Return a map as MessagePack, without the distances between its points and landmarks: most of it, and nobody draws them."""
    components = tuple(replace(part, distances=np.zeros((0, 0)), places=None) for part in result.components)
    return msgspec.msgpack.encode(replace(result, components=components), enc_hook=_encode_array)


def decode_map(data: bytes) -> MapResult:
    """Invert `encode_map`; ``distances`` have shape (0, 0).

    Raises
    ------
    msgspec.DecodeError
        ``data`` is something else.
    """
    return _decoder.decode(data)


def _encode_array(value: object) -> tuple[str, tuple[int, ...], bytes]:
    if not isinstance(value, np.ndarray):
        raise NotImplementedError(f"{type(value).__name__} is neither plain data nor an array")
    little = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<"))
    return little.dtype.str, value.shape, little.tobytes()


def _decode_array(_kind: type, value: Any) -> Any:  # msgspec's hook: whatever was decoded so far
    name, shape, content = value
    if name not in _ARRAYS:
        raise ValueError(f"an array of {name!r}; wanted one of {', '.join(_ARRAYS)}")
    return np.frombuffer(content, dtype=_ARRAYS[name]).reshape(shape)


_decoder = msgspec.msgpack.Decoder(MapResult, dec_hook=_decode_array)
