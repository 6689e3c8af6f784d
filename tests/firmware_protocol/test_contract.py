"""Keys and records on the bus."""

import contextlib
import dataclasses
import json
import re
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

import firmware_protocol.contract
from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction
from firmware_protocol.contract.keys import ANY, Key, Stream, build_key, parse_key
from firmware_protocol.contract.records import (
    GatewayStatus,
    HistoryRequest,
    JournalRecord,
    RecordBatch,
    decode_journal_record,
    decode_record,
    encode_journal_record,
    encode_record,
)
from firmware_protocol.errors import KeyExpressionError, RecordError
from firmware_protocol.units import Nanoseconds, NodeId
from tests.strategies import journal_records

CONTRACT = (Path(firmware_protocol.contract.__file__).parent / "CONTRACT.md").read_text()
names = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,20}", fullmatch=True)


@given(names, st.sampled_from(Stream), names, st.none() | st.integers(0, 2**64 - 1), names)
def test_parsing_inverts_building(site: str, stream: Stream, gateway: str, number: int | None, name: str) -> None:
    node = NodeId(number) if number is not None and stream in {Stream.STATUS, Stream.NEIGHBOURS} else None
    mapper = name if stream is Stream.WATERMARK else None

    key = build_key(site=site, stream=stream, gateway=gateway, node=node, mapper=mapper)

    assert parse_key(key) == Key(site=site, stream=stream, gateway=gateway, node=node, mapper=mapper)


@pytest.mark.parametrize("stream", [stream for stream in Stream if stream is not Stream.WATERMARK])
def test_a_watermark_alone_has_a_mapper(stream: Stream) -> None:
    for wrong, mapper in ((stream, "m1"), (Stream.WATERMARK, None)):
        with pytest.raises(KeyExpressionError, match="mapper"):
            build_key(site="s", stream=wrong, gateway="g", mapper=mapper)


def test_patterns_hold_wildcards() -> None:
    assert build_key(site=ANY, stream=Stream.STATUS, gateway=ANY, node=ANY) == "biobot/@v1/*/status/*/*"


@pytest.mark.parametrize("name", ["", "a/b", "a*", "@v1", "-x", "ä", "x" * 64, "a b", "a#"])
def test_a_name_that_would_break_a_key_is_refused(name: str) -> None:
    with pytest.raises(KeyExpressionError):
        build_key(site=name, stream=Stream.EVENTS, gateway="g")


@pytest.mark.parametrize("node", ["9" * 5000, "9" * 20, str(2**64), "٣", "-1", "1 "])
def test_a_node_that_is_no_64_bit_number_is_refused(node: str) -> None:
    with pytest.raises(KeyExpressionError):
        parse_key(f"biobot/@v1/a/status/b/{node}")


@pytest.mark.parametrize("nesting", [b"\x91", b"\x81\xa1x"])
def test_deeply_nested_bytes_are_a_fault_and_no_crash(nesting: bytes) -> None:
    data = b"\x81\xa1x" + nesting * 5000 + b"\xc0"

    with pytest.raises(RecordError):
        decode_record(data, GatewayStatus)
    with pytest.raises(RecordError):
        decode_journal_record(data)


@given(st.text(max_size=60))
def test_no_text_crashes_the_parser(text: str) -> None:
    for key in (text, "biobot/@v1/" + text):
        with contextlib.suppress(KeyExpressionError):
            assert build_key(**dataclasses.asdict(parse_key(key))) == key


@pytest.mark.parametrize(
    "key", ["biobot/@v2/a/events/b", "biobot/@v1/a/events", "biobot/@v1/a/nothing/b", "biobot/@v1/a/events/b/1", "biobot/@v1/a/status/b/x"]
)
def test_a_key_of_another_form_is_refused(key: str) -> None:
    with pytest.raises(KeyExpressionError):
        parse_key(key)


def test_a_stream_without_nodes_takes_none() -> None:
    with pytest.raises(KeyExpressionError, match="no node"):
        build_key(site="a", stream=Stream.EVENTS, gateway="g", node=NodeId(1))


@given(st.lists(journal_records, max_size=5))
def test_decoding_inverts_encoding_of_batches(records: list[JournalRecord]) -> None:
    batch = RecordBatch(gateway="base1", journal="j", head_offset=9, records=tuple(records))

    assert decode_record(encode_record(batch), RecordBatch) == batch
    assert [decode_journal_record(encode_journal_record(record)) for record in records] == records


def test_unknown_fields_are_ignored_so_that_one_can_be_added() -> None:
    raw = msgspec.msgpack.encode({"from_offset": 3, "colour": "blue"})

    assert decode_record(raw, HistoryRequest) == HistoryRequest(from_offset=3)


@given(st.binary(max_size=60))
def test_no_bytes_crash_the_record_decoders(data: bytes) -> None:
    for decode in (lambda: decode_record(data, GatewayStatus), lambda: decode_journal_record(data)):
        with contextlib.suppress(RecordError):
            assert decode() is not None


def test_the_example_of_the_contract_is_a_batch() -> None:
    match = re.search(r"```json\n(.*?)```", CONTRACT, re.DOTALL)

    assert match
    batch = decode_record(msgspec.msgpack.encode(json.loads(match[1])), RecordBatch)
    assert batch.records[0].identity == ("base1", "5f0c9a31", 1795400000, 11)


def test_every_stream_is_in_the_contract() -> None:
    for stream in Stream:
        assert f"`{stream.value}/" in CONTRACT


def test_a_stage_is_final_when_none_follows() -> None:
    final = {stage for stage in Stage if _stage(stage).is_final}

    assert final == {Stage.BIOBOT_CONFIRMED, Stage.REFUSED, Stage.FAILED, Stage.UNKNOWN}


def _stage(stage: Stage) -> CommandStage:
    return CommandStage(command_id="c", gateway="g", node=NodeId(1), action=StimulationAction.STOP, stage=stage, wall_ns=Nanoseconds(0))
