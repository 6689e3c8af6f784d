"""Integers to bytes and back, by a layout of the one table (``layouts.py``): the part of every codec that knows no message.

The rules are those of WIRE_FORMAT.md §7. A layout of fixed fields may end at the front of any appended field, whose default then counts,
and may go on after the last one: what follows is of a newer peer, and ignored. A layout with entries or text has neither freedom.
"""

import struct
from collections.abc import Callable, Sequence
from enum import Enum
from typing import TypeAlias

from firmware_protocol.errors import EncodeError
from firmware_protocol.layouts import CODE_SIZES, Field, Layout

Values: TypeAlias = tuple[int, ...]


class LayoutFault(Enum):
    """Why octets are not what a layout says."""

    BAD_LENGTH = "bad_length"
    BAD_VALUE = "bad_value"


class LayoutCodec:
    """One layout, compiled.

    Parameters
    ----------
    layout
        Of the table; one with entries or text has no appended fields.

    Raises
    ------
    ValueError
        The layout appends fields and has entries or text, or has both of these, or a field without default after one with.
    """

    __slots__ = ("_entries_sizes", "_entry", "_iter_entries", "_limits", "_names", "_packing", "_shorter", "_size", "layout")

    def __init__(self, layout: Layout) -> None:
        is_open = bool(layout.entry) or layout.text_limit is not None
        appended = [field.default is not None for field in layout.fields]
        if appended != sorted(appended) or (is_open and any(appended)) or (layout.entry and layout.text_limit is not None):
            msg = f"layout {layout.name}: appended fields come last, and with neither entries nor text; entries and text exclude each other"
            raise ValueError(msg)
        self.layout = layout
        self._names = tuple(field.name for field in layout.fields)
        self._packing = layout.packing
        self._size = self._packing.size
        self._limits = tuple((index, *field.limits) for index, field in enumerate(layout.fields) if field.limits is not None)
        self._entry = layout.entry_packing
        self._iter_entries = self._entry.iter_unpack
        least, most = layout.entry_counts
        self._entries_sizes = frozenset(self._size + count * self._entry.size for count in range(least, most + 1))
        self._shorter = _shorter_forms(layout)

    def read_fields(self, body: bytes) -> Values | LayoutFault:
        """Return the fields of a body that has nothing but fields, appended ones that are missing by their defaults."""
        if len(body) >= self._size:
            values: Values = self._packing.unpack_from(body)
        else:
            form = self._shorter.get(len(body))
            if form is None:
                return LayoutFault.BAD_LENGTH
            packing, defaults = form
            values = packing.unpack(body) + defaults
        for index, low, high in self._limits:
            if not low <= values[index] <= high:
                return LayoutFault.BAD_VALUE
        return values

    def read_entries(self, body: bytes) -> tuple[Values, tuple[Values, ...]] | LayoutFault:
        """Return the fields of a body and its entries, as many as there are."""
        if len(body) not in self._entries_sizes:
            return LayoutFault.BAD_LENGTH
        values = self._packing.unpack_from(body)
        for index, low, high in self._limits:
            if not low <= values[index] <= high:
                return LayoutFault.BAD_VALUE
        return values, tuple(self._iter_entries(body[self._size :]))

    def make_entries_reader(self) -> "Callable[[bytes], tuple[Values, tuple[Values, ...]] | LayoutFault]":
        """Return what does as ``read_entries`` does for a layout of entries alone, with all it needs at hand: most messages are such.

        Raises
        ------
        ValueError
            The layout has fields too.
        """
        if self._size:
            msg = f"layout {self.layout.name} has fields before its entries"
            raise ValueError(msg)
        sizes, iter_entries = self._entries_sizes, self._iter_entries

        def read(body: bytes) -> tuple[Values, tuple[Values, ...]] | LayoutFault:
            return ((), tuple(iter_entries(body))) if len(body) in sizes else LayoutFault.BAD_LENGTH

        return read

    def read_text(self, body: bytes) -> tuple[Values, bytes] | LayoutFault:
        """Return the fields of a body and the octets of its text, which may be no good UTF-8."""
        text = body[self._size :]
        if len(body) < self._size or len(text) > (self.layout.text_limit or 0):
            return LayoutFault.BAD_LENGTH
        values = self._packing.unpack_from(body)
        for index, low, high in self._limits:
            if not low <= values[index] <= high:
                return LayoutFault.BAD_VALUE
        return values, text

    def write_fields(self, values: Sequence[int]) -> bytes:
        """Return the fields as octets, appended ones too.

        Raises
        ------
        EncodeError
            A value does not fit its field, or is outside the field's limits.
        """
        for index, low, high in self._limits:
            if not low <= values[index] <= high:
                raise EncodeError(field=f"{self.layout.name}.{self._names[index]}", value=values[index], limit=f"{low} to {high}")
        try:
            return self._packing.pack(*values)
        except struct.error:
            raise _unfit(self.layout.name, self.layout.fields, values) from None

    def write_entries(self, entries: Sequence[Sequence[int]]) -> bytes:
        """Return entries as octets.

        Raises
        ------
        EncodeError
            There are too few or too many, or a value does not fit its field.
        """
        least, most = self.layout.entry_counts
        if not least <= len(entries) <= most:
            raise EncodeError(field=f"{self.layout.name} entries", value=len(entries), limit=f"{least} to {most} of them")
        try:
            return b"".join([self._entry.pack(*entry) for entry in entries])
        except struct.error:
            unfit = next(entry for entry in entries if not _fits(self.layout.entry, entry))
            raise _unfit(f"{self.layout.name} entry", self.layout.entry, unfit) from None

    def write_text(self, text: str) -> bytes:
        """Return text as octets.

        Raises
        ------
        EncodeError
            It is longer than the layout allows, or no text that UTF-8 can say.
        """
        limit = self.layout.text_limit or 0
        try:
            octets = text.encode()
        except UnicodeEncodeError as error:
            raise EncodeError(field=f"{self.layout.name}.text", value=text, limit="what UTF-8 can say") from error
        if len(octets) > limit:
            raise EncodeError(field=f"{self.layout.name}.text", value=text, limit=f"{limit} octets of UTF-8")
        return octets


def _shorter_forms(layout: Layout) -> dict[int, tuple[struct.Struct, Values]]:
    """Return, by its size, each form of the layout that lacks appended fields, and the defaults for them."""
    forms = {}
    for n_fields in range(len(layout.fields)):
        missing = tuple(field.default for field in layout.fields[n_fields:] if field.default is not None)
        if len(missing) == len(layout.fields) - n_fields:
            packing = struct.Struct("<" + "".join(field.code for field in layout.fields[:n_fields]))
            forms[packing.size] = (packing, missing)
    return forms


def range_of(code: str) -> tuple[int, int]:
    """Return the smallest and largest value that a field code can say."""
    bits = 8 * CODE_SIZES[code]
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)


def _fits(fields: Sequence[Field], values: Sequence[int]) -> bool:
    return all(range_of(field.code)[0] <= value <= range_of(field.code)[1] for field, value in zip(fields, values, strict=True))


def _unfit(name: str, fields: Sequence[Field], values: Sequence[int]) -> EncodeError:
    for field, value in zip(fields, values, strict=True):
        low, high = range_of(field.code)
        if not low <= value <= high:
            return EncodeError(field=f"{name}.{field.name}", value=value, limit=f"{low} to {high}")
    return EncodeError(field=name, value=tuple(values), limit="integers")
