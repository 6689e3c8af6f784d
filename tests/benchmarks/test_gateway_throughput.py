"""How many radio messages a second go through the whole gateway.

Budget: 2,000 radio messages/s from TCP to a Zenoh peer with the journal on disk, all acknowledged, on two idle cores: one for
the dongle's process and one for gateway and peer. All is offered at once, so backpacks repeat what waits for more than 1 s.
Run with ``pytest tests/benchmarks -s``.
"""

import asyncio
import multiprocessing
import resource
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from firmware_protocol.messages import EncounterBatch, EncounterEntry
from firmware_protocol.units import Milliseconds, NodeId, RssiDbm
from tests.gateway.fake_radio import a_dongle, on_tcp, until
from tests.gateway.harness import a_config, listening, running

_N_NODES = 100


def _serve(n_messages: int, pipe: Connection) -> None:
    async def story() -> None:
        dongle = a_dongle(*range(1, _N_NODES + 1))
        async with on_tcp(dongle) as port:
            pipe.send(port)
            await asyncio.to_thread(pipe.recv)
            for backpack in dongle.backpacks.values():
                backpack.say_hello()
                backpack.say_status()
            await until(lambda: all(one.is_level for one in dongle.backpacks.values()), what="all are known", timeout_s=60)
            pipe.send("known")
            begin_s = time.monotonic()
            for at in range(n_messages):
                backpack = dongle.backpacks[NodeId(at % _N_NODES + 1)]
                peers = [NodeId((backpack.node + 4 * (at // _N_NODES) + k) % _N_NODES + 1) for k in range(4)]
                entries = tuple(
                    EncounterEntry(
                        peer=peer if peer != backpack.node else NodeId(_N_NODES + 1),
                        start_ms=Milliseconds(backpack.now_ms - 300),
                        duration_ms=Milliseconds(250),
                        rssi_dbm=RssiDbm(-60),
                        is_ongoing=False,
                    )
                    for peer in peers
                )
                backpack.say(EncounterBatch(entries=entries))
                if at % 500 == 0:
                    await asyncio.sleep(0)
            await until(lambda: all(one.is_level for one in dongle.backpacks.values()), what="all is acknowledged", timeout_s=120)
            pipe.send(time.monotonic() - begin_s)

    asyncio.run(story())


@pytest.mark.parametrize("n_messages", [2_000, 8_000, 20_000])
def test_two_thousand_messages_a_second_go_through(tmp_path: Path, n_messages: int) -> None:
    here, there = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_serve, args=(n_messages, there))
    process.start()

    async def story() -> float:
        port = await asyncio.to_thread(here.recv)
        config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
        with listening(config) as peer:
            async with running(config):
                await peer.hear()
                here.send("go")
                await asyncio.to_thread(here.recv)
                before = resource.getrusage(resource.RUSAGE_SELF)
                elapsed_s = await asyncio.to_thread(here.recv)
                after = resource.getrusage(resource.RUSAGE_SELF)
                await until(lambda: peer.gateway_statuses[-1].counters["encounter.reports"] == 4 * n_messages, what="all is counted")
                head_offset = peer.gateway_statuses[-1].head_offset
                await until(lambda: len(peer.records) == head_offset, what="all arrives at the peer")
                cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
                n_heard = peer.gateway_statuses[-1].counters["radio.messages_in"]
                new, heard = n_messages / elapsed_s, n_heard / elapsed_s
                cost_us = cpu_s / n_heard * 1e6
                # A benchmark's report.
                print(f"\n{n_messages} messages: {new:,.0f}/s, with repeats {heard:,.0f}/s, {cost_us:.0f} us of CPU each with this peer")  # noqa: T201
                return float(heard)

    try:
        heard = asyncio.run(story())
    finally:
        process.terminate()
        process.join()
    assert heard >= 2_000
