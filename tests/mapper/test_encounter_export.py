"""Encounters as files: what other programs read of them is what the store has, whatever is asked for, and with little memory."""

import asyncio
import csv
import io
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from pathlib import Path

import httpx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from firmware_protocol.contract.records import EncounterRecord
from mapper.encounter_csv import read_encounters
from mapper.encounter_export import MAX_EXPORTS, ParquetPieces, Period, write_csv
from mapper.reading import read_log
from mapper.record_columns import EncounterColumns, EncounterRows
from mapper.store import Store
from mapper.types import EncounterTable
from tests.mapper.fake_gateway import ANCHOR_NS, S, encounter
from tests.mapper.mapper_side import Side, mapper_side
from tests.mapper.ring import ring_records
from tests.mapper.web_side import client_of

CSV, PARQUET = "/api/v1/encounters.csv", "/api/v1/encounters.parquet"
HUGE = 2**64 - 1
Row = tuple[int, int, int, int]


def run(story: Callable[[Side, httpx.AsyncClient], Awaitable[None]]) -> None:
    async def whole() -> None:
        async with mapper_side(1) as side, client_of(side) as client:
            await story(side, client)

    asyncio.run(whole())


def rows_of(table: EncounterTable) -> list[Row]:
    columns = (table.t_start_ns, table.t_end_ns, table.id1, table.id2)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def make_rows(rows: list[Row]) -> EncounterRows:
    begin, end, first, second = (np.array(column, dtype=np.int64) for column in zip(*rows, strict=True))
    return EncounterRows(
        row=np.arange(len(rows)), t_start_ns=begin, t_end_ns=end, id1=first, id2=second, counts=np.ones(len(rows), dtype=np.bool_)
    )


instants = st.integers(0, 4 * 10**18 - 1)
encounters = st.builds(
    lambda times, ids: (*sorted(times), *ids),
    st.tuples(instants, instants),
    st.lists(st.integers(0, 2**63 - 1), min_size=2, max_size=2, unique=True),
)


@settings(max_examples=12)
@given(rows=st.lists(encounters, min_size=1, max_size=20))
def test_what_is_written_is_read_back_to_the_nanosecond(rows: list[Row], tmp_path_factory: pytest.TempPathFactory) -> None:
    wanted = sorted((begin, end, min(ids), max(ids)) for begin, end, *ids in rows)
    path = tmp_path_factory.mktemp("export") / "encounters.csv"
    path.write_bytes(b"t_start_s,t_end_s,id1,id2\n" + write_csv(make_rows(rows)))
    assert rows_of(read_encounters(path)) == wanted
    pieces = ParquetPieces()
    file = b"".join([pieces.write(make_rows(rows[:7])), pieces.write(make_rows(rows)), pieces.finish()])
    columns = parquet.read_table(io.BytesIO(file)).to_pydict()
    assert columns["id1"] == [row[2] for row in rows[:7] + rows]
    assert [instant.value for instant in columns["t_end_s"]] == [row[1] for row in rows[:7] + rows]


@settings(max_examples=30)
@given(changes=st.lists(st.tuples(st.integers(1, 40), st.booleans()), max_size=60), limit=st.integers(1, 9))
def test_pages_of_any_size_have_each_encounter_that_counts_once(changes: list[tuple[int, bool]], limit: int) -> None:
    columns, counting = EncounterColumns(), dict[int, bool]()
    for number, (row, counts) in enumerate(changes, start=1):
        one = EncounterRows(
            row=np.array([row]),
            t_start_ns=np.array([row]),
            t_end_ns=np.array([row]),
            id1=np.array([1]),
            id2=np.array([2]),
            counts=np.array([counts]),
        )
        columns.put(one, changes=np.array([number]))
        counting[row] = counts
    seen: list[int] = []
    first: int | None = 0
    while first is not None:
        page, first = columns.page(first=first, limit=limit)
        seen += page.row.tolist()
    assert seen == sorted(row for row, counts in counting.items() if counts)


def test_the_mapper_maps_what_it_exported(tmp_path: Path) -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        records = ring_records()
        last = records[-1].offset
        more = [encounter(last + 1, nodes=(1, HUGE), t_ns=(S, 2 * S)), encounter(last + 2, nodes=(1, 2), is_void=True)]
        await side.take_in([*records, *more])
        n = sum(isinstance(record, EncounterRecord) for record in records) + 1
        wanted = sorted(
            (record.t_start_ns + ANCHOR_NS, record.t_end_ns + ANCHOR_NS, record.node_a, record.node_b)
            for record in [*records, more[0]]
            if isinstance(record, EncounterRecord)
        )
        text = await client.get(CSV)
        assert text.headers["content-type"].startswith("text/csv")
        assert text.headers["content-encoding"] == "gzip"
        assert text.headers["content-disposition"] == 'attachment; filename="encounters.csv"'
        plain = await client.get(CSV, headers={"Accept-Encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert plain.text == text.text
        listed = [
            (round(float(row["t_start_s"]) * 1e9), int(row["id1"]), int(row["id2"])) for row in csv.DictReader(io.StringIO(text.text))
        ]
        assert len(listed) == n
        packed = await client.get(PARQUET)
        for name, content in (("log.csv", text.content), ("log.parquet", packed.content)):
            (tmp_path / name).write_bytes(content)
            log = read_log(tmp_path / name)
            found = sorted(
                (begin, end, *sorted((int(log.names.name(first)), int(log.names.name(second)))))
                for begin, end, first, second in rows_of(log.table)
            )
            assert found == [(begin, end, *sorted(ids)) for begin, end, *ids in wanted], name

    run(story)


def test_a_period_leaves_out_what_was_over_and_what_had_not_begun() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        await side.take_in([encounter(n, nodes=(1, 2), t_ns=(n * S, (n + 2) * S)) for n in range(1, 11)])
        base = ANCHOR_NS // S

        async def begins(path: str, **asked: float) -> list[int]:
            answer = await client.get(path, params={name.rstrip("_"): value for name, value in asked.items()})
            if path == CSV:
                return [int(float(row["t_start_s"])) - base for row in csv.DictReader(io.StringIO(answer.text))]
            return [one.value // S - base for one in parquet.read_table(io.BytesIO(answer.content)).to_pydict()["t_start_s"]]

        for path in (CSV, PARQUET):
            assert await begins(path) == list(range(1, 11))
            assert await begins(path, from_=base + 5) == list(range(4, 11))
            assert await begins(path, until=base + 5) == [1, 2, 3, 4]
            assert await begins(path, from_=base + 5, until=base + 6) == [4, 5]
            assert await begins(path, from_=base + 500) == []
            for bad in ({"from": -1}, {"from": "nan"}, {"until": 1e300}, {"from": 5, "until": 5}):
                answer = await client.get(path, params=bad)
                assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, bad
                assert answer.headers["content-type"] == "application/problem+json"
        assert (await client.head(CSV)).status_code == HTTPStatus.METHOD_NOT_ALLOWED

    run(story)


def test_few_files_are_written_at_a_time_and_one_given_up_frees_its_place() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        exports = side.services.exports
        await side.take_in([encounter(1)])
        begun = [exports.csv(Period()) for _ in range(MAX_EXPORTS)]
        for one in begun:
            await anext(one)
        with pytest.raises(Exception, match="the limit; ask again later"):
            exports.csv(Period())
        await begun[0].aclose()  # type: ignore[attr-defined]  # it is a generator
        again = exports.csv(Period())
        assert await anext(again) == b"t_start_s,t_end_s,id1,id2\n"
        begun[0] = again
        for one in begun:
            await one.aclose()  # type: ignore[attr-defined]  # same

    run(story)


def test_a_store_hands_out_its_rows_a_piece_at_a_time() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        await side.take_in([encounter(n) for n in range(1, 8)])
        page, following = await side.records.call(Store.rows, first=0, limit=4)
        rest, end = await side.records.call(Store.rows, first=following or 0, limit=100)
        assert (len(page) + len(rest), end) == (7, None)

    run(story)
