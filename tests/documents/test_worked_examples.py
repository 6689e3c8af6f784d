"""The Python of the documents is run: what it adds does what the page says."""

import asyncio
import contextlib
import queue
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from firmware_protocol.contract.records import RecordBatch
from firmware_protocol.dialects.choice import make_host
from gateway.acceptance.radio_under_test import RadioUnderTest
from gateway.errors import TransportClosedError, TransportOpenError
from gateway.health import Health
from gateway.monitor.exposition import expose, make_registry
from gateway.transports.interface import Transport
from gateway.vitals import Vitals
from mapper.encounter_graph import build_components
from mapper.kernels import choose_kernels
from mapper.metric import ProfileMetric, distances_to, times_to
from mapper.types import ProfileNorm
from simulator.__main__ import main as simulate
from simulator.arenas import scenarios
from studies.ports import free_port
from tests.documents.commands import ROOT, blocks
from tests.gateway.virtual_dongles import dongle_on_tcp, some_payloads
from tests.mapper.fake_gateway import SITE, FakeGateway, encounter
from tests.mapper.worlds import table_of, walk_track


def example(page: str, name: str) -> Any:
    """Run the block of Python of a page that defines a name; return what it is."""
    (text,) = [
        text
        for language, text in blocks(ROOT / "docs" / page)
        if language == "python" and re.search(rf"^(?=\S).*\b{name}\b", text, re.MULTILINE)
    ]
    space: dict[str, Any] = {"__name__": "example"}
    exec(compile(text, f"docs/{page}", "exec"), space)
    return space[name]


def test_a_scenario_that_is_added_is_walked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    courtyard = example("developer.md", "COURTYARD")
    betti = courtyard.build(50.0).betti
    monkeypatch.setattr(scenarios, "SCENARIOS", {**scenarios.SCENARIOS, courtyard.name: courtyard})

    status = simulate(
        ["run", "--scenario", "courtyard", "--seed", "1", "--biobots", "20", "--duration", "20", "--out", str(tmp_path / "run")]
    )

    assert (betti.components, betti.holes) == (1, 1)
    assert status == 0
    assert (tmp_path / "run" / "encounters.csv").exists()


@contextlib.asynccontextmanager
async def socket_to(port: int, path: Path) -> AsyncIterator[None]:
    """Pass on whatever comes at a socket of the file system to a TCP port, and back."""
    joined: set[asyncio.Task[None]] = set()

    async def pour(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            while chunk := await source.read(4096):
                sink.write(chunk)
                await sink.drain()
        sink.close()

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", port)
        try:
            await asyncio.gather(pour(reader, back), pour(there, writer))
        finally:
            for end in (back, writer):
                end.close()
                with contextlib.suppress(ConnectionError):
                    await end.wait_closed()

    def join(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        joined.add(asyncio.create_task(pass_on(reader, writer)))

    async with await asyncio.start_unix_server(join, path):
        yield
        await asyncio.gather(*joined)


def test_a_transport_that_is_added_carries_a_dongle(tmp_path: Path) -> None:
    open_unix: Callable[[str], Awaitable[Transport]] = example("developer.md", "open_unix")
    path = tmp_path / "board"

    async def story() -> None:
        with pytest.raises(TransportOpenError, match="does the program that listens there run"):
            await open_unix(str(path))
        async with dongle_on_tcp("native", payloads=some_payloads(5)) as (_, port):
            place = re.search(r":(\d+)\?", port)
            assert place
            async with socket_to(int(place[1]), path):
                radio = RadioUnderTest(
                    open_port=lambda: open_unix(str(path)), make_host=lambda: make_host("native", first_handle=1, network=None)
                )
                await radio.connect()
                assert await radio.wait(lambda: radio.n_payloads >= 5, timeout_s=60)
                await radio.disconnect()

    asyncio.run(story())


def test_a_transport_that_is_added_ends_when_the_other_end_does(tmp_path: Path) -> None:
    open_unix: Callable[[str], Awaitable[Transport]] = example("developer.md", "open_unix")

    async def story() -> None:
        ends: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
        async with await asyncio.start_unix_server(lambda _, writer: ends.put_nowait(writer), tmp_path / "board"):
            transport = await open_unix(str(tmp_path / "board"))
            end = await ends.get()
            end.write(b"last words")
            end.close()
            assert await transport.read() == b"last words"
            with pytest.raises(TransportClosedError, match="the other end closed the connection"):
                await transport.read()
            await transport.aclose()
            await end.wait_closed()

    asyncio.run(story())


def test_a_metric_that_is_added_is_one_and_bounds_the_default_from_below() -> None:
    measure = example("developer.md", "mean_profile_distances")
    rows, spells = walk_track(n_landmarks=12, n_walkers=6, duration_s=20.0, seed=1, is_ring=True)
    graph = build_components(table_of(rows), spells, moving_time=False, kernels=choose_kernels())[0]
    vertices = np.arange(graph.n_vertices)[::5]
    distances = measure(graph, vertices)
    default = distances_to(ProfileMetric(graph=graph, profiles=times_to(graph, graph.landmarks), norm=ProfileNorm.MAX), vertices, vertices)

    assert distances.shape == (len(vertices), len(vertices))
    assert not distances.diagonal().any()
    assert (distances == distances.T).all()
    assert (distances[:, None, :] <= (distances[:, :, None] + distances[None, :, :]) * (1 + 1e-12)).all()
    assert (distances <= default).all()
    assert distances.max() > 0


def test_what_the_gateway_counts_is_a_metric_without_further_work(tmp_path: Path) -> None:
    health = Health()
    example("developer.md", "note_retry")(health, waiting=3)
    text = expose(make_registry(Vitals(health=health, journal=tmp_path / "gateway.sqlite"))).decode()

    assert 'biobot_gateway_events_total{event="yours.retries",radio=""} 1.0' in text
    assert 'biobot_gateway_level{name="yours.waiting"} 3.0' in text


def test_a_program_follows_the_encounters_of_a_site() -> None:
    follow = example("integrator.md", "follow")
    port = free_port()
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    taken: queue.Queue[RecordBatch] = queue.Queue()
    with FakeGateway(port=port) as gateway, zenoh.open(config) as session:
        subscriber = follow(session, site=SITE, take=taken.put)
        batch = None
        for _ in range(300):  # a publication before the subscription is known there is not heard: the next one is
            gateway.publish([encounter(1)])
            with contextlib.suppress(queue.Empty):
                batch = taken.get(timeout=0.2)
                break
        subscriber.undeclare()

    assert batch is not None
    assert batch.records == (encounter(1),)


def test_every_other_block_of_python_runs() -> None:
    tried = {"developer.md", "integrator.md"}
    for page in sorted((ROOT / "docs").rglob("*.md")):
        for language, text in blocks(page):
            if language == "python" and page.name not in tried:
                exec(compile(text, str(page), "exec"), {"__name__": "example"})
