"""Lines heard live and once more: the same bytes say the same, and listening takes nothing from the gateway that comes later."""

import asyncio
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dialects.choice import DIALECTS
from firmware_protocol.dialects.xbee_frames import Receive
from firmware_protocol.envelope import CoordinatorHello
from gateway.__main__ import main
from gateway.recordings.dialects import make_line_dissector
from gateway.recordings.line_offer import parse_offer
from gateway.recordings.listening import Listening, listen
from gateway.recordings.plain_values import fields_of
from gateway.recordings.printing import LinePrinter, as_json, as_text
from gateway.recordings.recorder import record_to_file
from gateway.recordings.replaying import offer_recording, open_recording
from gateway.transports.recording import LineRecord, RecordKind
from gateway.transports.spec import open_transport, parse_port_spec
from simulator.dongles.choice import DIALECTS as VIRTUAL
from tests.gateway.virtual_dongles import dongle_on_tcp, some_payloads

_ROOT = Path(__file__).parents[2]
_BOTH = [dialect for dialect in DIALECTS if dialect in VIRTUAL and "can" not in dialect]


async def start(*arguments: str, cwd: Path) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "gateway",
        *arguments,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(_ROOT)},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )


async def sniff_until(process: asyncio.subprocess.Process, is_enough: Callable[[dict[str, object]], bool]) -> str:
    """Return all that a sniffing process prints; it is interrupted when a line is enough."""
    assert process.stdout is not None
    printed = ""
    async with asyncio.timeout(60):
        while line := (await process.stdout.readline()).decode():
            printed += line
            if is_enough(json.loads(line)):
                process.send_signal(signal.SIGINT)
                is_enough = lambda _: False  # noqa: E731  # once
    assert await process.wait() == 0
    return printed


async def replay(*arguments: str, cwd: Path) -> str:
    process = await start("replay", *arguments, cwd=cwd)
    out, _ = await process.communicate()
    assert process.returncode == 0
    return out.decode()


@pytest.mark.parametrize("dialect", _BOTH)
def test_a_replay_prints_line_for_line_what_sniff_printed_while_it_was_recorded(dialect: str, tmp_path: Path) -> None:
    async def run() -> tuple[str, str, str]:
        async with dongle_on_tcp(dialect, payloads=some_payloads(7)) as (_, spec):
            sniffing = await start("sniff", "--port", spec, "--json", "--record", "x.biorec", cwd=tmp_path)
            live = await sniff_until(sniffing, lambda event: event.get("sequence") == 6 and "node" in event)
        again, text = await asyncio.gather(replay("x.biorec", "--json", cwd=tmp_path), replay("x.biorec", cwd=tmp_path))
        return live, again, text

    live, again, text = asyncio.run(run())

    assert again == live
    events = [json.loads(line) for line in live.splitlines()]
    assert {event.get("message") for event in events} >= {"Status", "EncounterBatch"}
    assert {event["node"] for event in events if "node" in event} == {7}
    assert len(text.splitlines()) == len(events)


def test_what_was_sniffed_without_confirming_is_there_for_the_gateway() -> None:
    """The native dialect alone has confirmations; in the others the backpack repeats, for nothing acknowledges it."""
    heard: list[set[str]] = []

    async def run() -> None:
        async with dongle_on_tcp("native", payloads=some_payloads(4)) as (_, spec):
            for _ in range(2):
                printer = LinePrinter(make_line_dissector("native", path="x"))
                events: set[str] = set()

                def take(record: LineRecord, printer: LinePrinter = printer, events: set[str] = events) -> None:
                    events |= {str(event["sequence"]) for event in printer.take(record) if "message" in event and "node" in event}

                await listen(parse_port_spec(spec), how=Listening(duration_s=0.5), take=take)
                heard.append(events)

    asyncio.run(run())

    assert heard == [{"0", "1", "2", "3"}] * 2


def test_a_passive_listener_writes_nothing() -> None:
    async def run() -> list[LineRecord]:
        records: list[LineRecord] = []
        async with dongle_on_tcp("native", payloads=some_payloads(1)) as (_, spec):
            await listen(parse_port_spec(spec), how=Listening(is_passive=True, duration_s=0.2), take=records.append)
        return records

    kinds = {record.kind for record in asyncio.run(run())}

    assert RecordKind.BYTES_OUT not in kinds
    assert {RecordKind.OPENED, RecordKind.CLOSED} <= kinds


@pytest.mark.parametrize("line", ["tcp:127.0.0.1:0", "pty:{}/line"])
def test_an_offered_recording_is_the_dongles_bytes_and_no_other(line: str, tmp_path: Path) -> None:
    path = tmp_path / "x.biorec"
    recorder = record_to_file(path, port="tcp:a:1", dialect="native")
    chunks = [bytes([one]) * (one + 1) for one in range(60)]
    for one, chunk in enumerate(chunks):
        recorder.take(LineRecord(kind=RecordKind.BYTES_IN, monotonic_ns=one * 1_000_000, wall_ns=0, data=chunk))
        recorder.take(LineRecord(kind=RecordKind.BYTES_OUT, monotonic_ns=one * 1_000_000, wall_ns=0, data=b"what went to the dongle"))
    recorder.close()
    wanted = b"".join(chunks)

    async def run() -> tuple[bytes, int]:
        address: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        with open_recording(path) as recording:
            offering = asyncio.ensure_future(
                offer_recording(recording, parse_offer(line.format(tmp_path)), speed=1.0, on_ready=address.set_result)
            )
            transport = await open_transport(parse_port_spec(await address))
            await transport.write(b"is dropped")
            heard = b""
            while len(heard) < len(wanted):
                heard += await transport.read()
            await transport.aclose()
            return heard, await offering

    assert asyncio.run(run()) == (wanted, len(wanted))


@given(st.sampled_from(_BOTH), st.lists(st.tuples(st.booleans(), st.binary(max_size=60)), max_size=8))
def test_no_bytes_raise_in_the_decoder_or_the_printers(dialect: str, chunks: list[tuple[bool, bytes]]) -> None:
    printer = LinePrinter(make_line_dissector(dialect, path="x"))
    for is_outgoing, chunk in chunks:
        kind = RecordKind.BYTES_OUT if is_outgoing else RecordKind.BYTES_IN
        for event in printer.take(LineRecord(kind=kind, monotonic_ns=0, wall_ns=1 << 63, data=chunk)):
            assert json.loads(as_json(event)) == event
            assert "\n" not in as_text(event)


@pytest.mark.parametrize("command", ["sniff", "record"])
def test_listening_in_the_wrong_dialect_fails_and_names_the_next_step(command: str, tmp_path: Path) -> None:
    async def run() -> list[tuple[int | None, str]]:
        ends = []
        async with dongle_on_tcp("native") as (_, spec):
            place = spec.split("?")[0]
            for number, (dialect, *more) in enumerate([("znp",), ("znp", "--passive"), ("native",)]):
                file = [f"{number}.biorec"] if command == "record" else []
                port = ("--port", f"{place}?dialect={dialect}", "--duration-s", "1")
                process = await start(command, *file, *port, *more, cwd=tmp_path)
                _, error = await process.communicate()
                ends.append((process.returncode, error.decode()))
        return ends

    wrong, passive, right = asyncio.run(run())

    assert wrong[0] == 1
    assert "did not answer as znp; `biobot-gateway probe tcp:127.0.0.1:" in wrong[1]
    assert [(status, "did not answer" in error) for status, error in (passive, right)] == [(0, False)] * 2


def test_addresses_of_64_bits_are_printed_as_on_labels() -> None:
    hello = CoordinatorHello(firmware=1, eui64=0x00124B0000001000, pan_id=1, channel=20, max_radio_payload=57)
    frame = Receive(source64=0x0013A200407D1113, source16=0x1234, options=1, payload=b"", endpoints=None)

    assert fields_of(hello)["eui64"] == "00124b0000001000"
    assert fields_of(frame)["source64"] == "0013a200407d1113"


def test_the_text_that_opens_a_transparent_xbee_is_no_fault() -> None:
    dissector = make_line_dissector("xbee", path="x")

    told = [one for text in (b"+++", b"ATAP2\r") for one in dissector.feed(text, is_outgoing=True)]

    assert [(one.name, one.fields, one.fault) for one in told] == [("text", {"says": "+++"}, ""), ("text", {"says": "ATAP2"}, "")]
    assert [one.fault for one in dissector.feed(b"+++", is_outgoing=False)] == ["frame.noise"]


def test_a_port_that_was_spelled_wrong_leaves_the_name_of_the_recording_free(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port = f"serial:{tmp_path}/nowhere"
    for _ in range(2):
        assert main(["record", str(tmp_path / "one.biorec"), "--port", port]) == 1
        assert main(["sniff", "--record", str(tmp_path / "two.biorec"), "--port", port]) == 1
        assert capsys.readouterr().err.count("there is no ") == 2
    assert not list(tmp_path.iterdir())
