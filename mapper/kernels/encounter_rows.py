"""Plain rows of a CSV file of encounters to columns of whole numbers, by the compiled library."""

import ctypes
from collections.abc import Sequence

import numpy as np

from mapper.types import IntArray


def read_rows(
    library: ctypes.CDLL, data: bytes, *, begin: int, places: Sequence[int], n_columns: int, longest_field: int
) -> tuple[IntArray, IntArray, IntArray, IntArray] | None:
    """Read all rows of a file from byte ``begin`` on, where every one of them is plain.

    Parameters
    ----------
    data
        The file: UTF-8 without NUL, which is not checked here.
    places
        The fields of a row that hold ``t_start_s``, ``t_end_s``, ``id1`` and ``id2``, counted from 0.
    n_columns
        Rows of more fields are not plain.
    longest_field
        Fields of more bytes are not plain.

    Returns
    -------
    tuple or None
        Start and end [ns], rounded half to even from the exact decimal seconds, and ids, shape (rows,) each. None where anything is out of
        the ordinary: a row that is wrong (`mapper.encounter_csv` has the rules and the words), a number of more than 28 digits, a carriage
        return alone at the end of a line, a blank that is neither space nor tab around a value.
    """
    text, fields = np.frombuffer(data, dtype=np.uint8)[begin:], np.array(places, dtype=np.int64)
    room = int(library.count_lines(text.ctypes.data, len(text)))
    # Pages that are not written to cost nothing.
    columns = tuple(np.empty(room, dtype=np.int64) for _ in range(4))
    addresses = (column.ctypes.data for column in columns)
    n_rows = int(library.read_rows(text.ctypes.data, len(text), fields.ctypes.data, n_columns, longest_field, room, *addresses))
    if n_rows < 0:
        return None
    start, end, id1, id2 = (column[:n_rows] for column in columns)
    return start, end, id1, id2
