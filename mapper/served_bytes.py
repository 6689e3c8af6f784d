"""An answer that many ask for: its bytes, and the same compressed, once, when somebody first asks for that."""

import asyncio
import gzip
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Final, Self

LEAST_PACKED: Final = 1024
"""Shorter answers are sent as they are: they fit a packet or two either way."""
_LEVEL: Final = 6


@dataclass(slots=True)
class ServedBytes:
    """Bytes that never change under one ``tag``, without quotes; another coding of them has another."""

    plain: bytes
    tag: str
    _packed: bytes | None = field(default=None, compare=False, repr=False)

    @classmethod
    def of(cls, plain: bytes) -> Self:
        """Name bytes by what they are."""
        return cls(plain, tag=blake2b(plain, digest_size=8).hexdigest())

    @property
    def etag(self) -> str:
        """The entity tag of the bytes as they are (RFC 9110, 8.8.3)."""
        return f'"{self.tag}"'

    @property
    def packed_etag(self) -> str:
        """The entity tag of the compressed bytes."""
        return f'"{self.tag}-gzip"'

    @property
    def packed(self) -> bytes | None:
        """The compressed bytes, if they are there already."""
        return self._packed

    @property
    def is_worth_packing(self) -> bool:
        """Say whether compressing them is."""
        return len(self.plain) >= LEAST_PACKED

    async def pack(self) -> bytes:
        """Compress them off the event loop; those who ask meanwhile may do it too, and get the same."""
        if self._packed is None:
            # No date in the header: equal bytes are equal compressed.
            self._packed = await asyncio.to_thread(gzip.compress, self.plain, _LEVEL, mtime=0)
        return self._packed
