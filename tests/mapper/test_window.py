"""Encounters in canonical order, and who is among them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.errors import UnknownBiobotError
from mapper.types import IntArray
from mapper.window import absent_biobots, make_encounter_table

Columns = tuple[IntArray, IntArray, IntArray, IntArray]

# Few instants and ids, so that many rows tie.
_rows = st.tuples(st.integers(0, 5), st.integers(0, 2), st.integers(1, 4), st.integers(1, 3))


def _columns(rows: list[tuple[int, int, int, int]]) -> Columns:
    start, length, id1, step = np.array(rows, dtype=np.int64).reshape(-1, 4).T
    return start, start + length, id1, (id1 + step - 1) % 4 + 1


def _literal_order(start: IntArray, end: IntArray, id1: IntArray, id2: IntArray) -> IntArray:
    return np.lexsort((np.arange(len(start)), np.maximum(id1, id2), np.minimum(id1, id2), end, start))


@st.composite
def _tables(draw: st.DrawFn) -> Columns:
    """Rows as they come, by start alone, or in canonical order already."""
    columns = _columns(draw(st.lists(_rows.filter(lambda row: row[3] != 4), max_size=25)))
    match draw(st.sampled_from(["as they come", "by start", "canonical"])):
        case "by start":
            order = np.argsort(columns[0], kind="stable")
        case "canonical":
            order = _literal_order(*columns)
        case _:
            order = np.arange(len(columns[0]))
    start, end, id1, id2 = (column[order] for column in columns)
    return start, end, id1, id2


@given(_tables())
def test_the_order_is_by_start_end_ids_and_then_as_rows_came(columns: Columns) -> None:
    start, end, id1, id2 = columns
    table = make_encounter_table(t_start_ns=start, t_end_ns=end, id1=id1, id2=id2)
    order = _literal_order(*columns)
    assert table.source_row.tolist() == order.tolist()
    assert table.t_start_ns.tolist() == start[order].tolist()
    assert table.t_end_ns.tolist() == end[order].tolist()
    assert table.id1.tolist() == np.minimum(id1, id2)[order].tolist()
    assert table.id2.tolist() == np.maximum(id1, id2)[order].tolist()


@given(_tables())
def test_a_table_is_read_only_and_shares_nothing_with_what_it_was_made_from(columns: Columns) -> None:
    start, end, id1, id2 = columns
    table = make_encounter_table(t_start_ns=start, t_end_ns=end, id1=id1, id2=id2)
    for column in (table.t_start_ns, table.t_end_ns, table.id1, table.id2, table.source_row):
        assert column.dtype == np.int64
        assert not column.flags.writeable
        assert not any(np.shares_memory(column, given) for given in columns)
    assert all(column.flags.writeable for column in columns)


@given(_tables(), st.lists(st.integers(0, 6), max_size=6))
def test_absent_are_those_in_neither_column(columns: Columns, ids: list[int]) -> None:
    start, end, id1, id2 = columns
    table = make_encounter_table(t_start_ns=start, t_end_ns=end, id1=id1, id2=id2)
    absent = sorted(set(ids) - set(id1.tolist()) - set(id2.tolist()))
    if ids and absent == sorted(set(ids)):
        with pytest.raises(UnknownBiobotError) as caught:
            absent_biobots(table, ids)
        assert caught.value.ids == tuple(absent)
    else:
        assert absent_biobots(table, ids) == tuple(absent)
