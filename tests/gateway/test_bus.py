"""Laws of the gateway's door to Zenoh, between two real sessions."""

import asyncio
import time
from pathlib import Path

import zenoh

from firmware_protocol.contract.commands import StimulationAction, StimulationRequest
from firmware_protocol.contract.keys import Stream, build_key
from firmware_protocol.contract.records import Mode, Watermark, encode_record
from gateway.bus import Bus
from gateway.bus_commands import CommandAnswer
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config, a_request, peer_config
from tests.gateway.makers import a_mode_record


def test_a_stop_passes_where_as_many_commands_wait_as_may(tmp_path: Path) -> None:
    async def story() -> None:
        health = Health()
        config = a_config(tmp_path)
        journal = Journal.open(tmp_path / "j", health=health)
        bus = await asyncio.to_thread(Bus.open, config, health=health)
        taken: list[StimulationRequest] = []

        def take(request: StimulationRequest, _answer: CommandAnswer) -> None:
            taken.append(request)

        bus.start(on_command=take, open_reader=journal.reader, journal=journal.journal_id)
        key = build_key(site="test", stream=Stream.COMMAND, gateway="base1")
        try:
            with zenoh.open(peer_config(config.listen[0])) as peer:

                def ask(action: StimulationAction) -> None:
                    peer.get(key, lambda _: None, payload=encode_record(a_request(7, action)), timeout=10.0)

                while not taken:  # until the peer has found the gateway
                    await asyncio.to_thread(ask, StimulationAction.TURN_LEFT)
                    await asyncio.sleep(0.02)
                taken.clear()
                # From here on the loop is held, so that commands wait, until Zenoh's thread has refused one.
                for _ in range(300):
                    ask(StimulationAction.START)
                deadline_s = time.monotonic() + 10.0
                while not health.counters().get("bus.refused_queries") and time.monotonic() < deadline_s:
                    time.sleep(0.01)  # noqa: ASYNC251  # to hold the loop is the point
                ask(StimulationAction.STOP)
                while bus.n_waiting < 257 and time.monotonic() < deadline_s:
                    time.sleep(0.01)  # noqa: ASYNC251  # same
                assert health.counters()["bus.refused_queries"] > 0
                await until(lambda: any(request.action is StimulationAction.STOP for request in taken), what="the stop is handed over")
        finally:
            await asyncio.to_thread(bus.close)
            journal.close()

    asyncio.run(story())


def test_a_mapper_that_says_how_far_it_has_come_is_remembered_over_a_restart(tmp_path: Path) -> None:
    async def story() -> None:
        config, path = a_config(tmp_path), tmp_path / "j"
        health = Health()
        journal = Journal.open(path, health=health)
        running = asyncio.ensure_future(journal.run())
        for number in range(3):
            await journal.append(JournalWrite(records=(a_mode_record(sequence=number, node=1, mode=Mode.S),)))
        bus = await asyncio.to_thread(Bus.open, config, health=health)
        bus.start(
            on_command=lambda _request, _answer: None,
            open_reader=journal.reader,
            journal=journal.journal_id,
            on_watermark=journal.note_watermark,
        )
        key = build_key(site="test", stream=Stream.WATERMARK, gateway="base1", mapper="m1")
        of_another = Watermark(mapper="m1", journal="another", offset=9)
        mark = Watermark(mapper="m1", journal=journal.journal_id, offset=2)
        with zenoh.open(peer_config(config.listen[0])) as peer:

            def say() -> bool:
                for payload in (b"no record", encode_record(of_another), encode_record(mark)):
                    peer.put(key, payload)
                return bool(journal.watermarks)

            await until(say, what="the gateway has heard the mapper")
        assert dict(journal.watermarks) == {"m1": 2}
        await until(lambda: not journal._new_watermarks, what="it is written down")
        running.cancel()
        await asyncio.wait({running})
        await asyncio.to_thread(bus.close)
        journal.close()
        again = Journal.open(path, health=health)
        assert dict(again.watermarks) == {"m1": 2}
        again.close()

    asyncio.run(story())
