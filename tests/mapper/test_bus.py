"""Bus and intake against a real Zenoh publisher on loopback: everything arrives, nothing twice, whatever gets lost on the way."""

import asyncio
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.contract.keys import Stream
from firmware_protocol.contract.records import JournalRecord, Mode, encode_record
from firmware_protocol.units import NodeId
from mapper.arrivals import decode_arrival
from mapper.bus import Bus
from mapper.changes import Topic
from mapper.command_log import Command, Outcome, has_ended
from mapper.commands import Wish
from mapper.errors import BiobotNotFoundError, BusError, CommandNotFoundError, CommandRefusedError
from mapper.store import Store
from mapper.watermarks import Watermarks
from studies.ports import free_port
from tests.mapper.fake_gateway import SITE, FakeGateway, batch, encounter, mode
from tests.mapper.mapper_side import DEADLINE_S, Side, mapper_side, until


def level(head: int, *, journal: str = "journal1") -> Callable[[Store], bool]:
    return lambda store: store.watermark(gateway="gateway1", journal=journal) >= head


@given(st.text(max_size=80), st.binary(max_size=80) | st.booleans())
def test_no_key_and_no_bytes_raise_past_the_decoder(key: str, payload: bytes | bool) -> None:
    prefix = "biobot/@v1/local/"
    deep = b"\x81\xa1x" + b"\x91" * 5000
    for text in (key, f"{prefix}{key}", f"{prefix}status/gw/{'9' * 5000}", f"{prefix}encounters/gw", f"{prefix}status/gw/7"):
        for body in (payload, deep):
            assert not isinstance(decode_arrival(text, body), BaseException)


def test_every_published_record_is_stored_once_though_most_were_never_received() -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            everything: list[JournalRecord] = [encounter(n) for n in range(1, 3001)]
            gateway.journal_records(everything[:2000])
            async with mapper_side(port) as side:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                # Live: some batches are lost, some come twice, some late.
                for first in range(0, 2000, 50):
                    if first % 150 == 0:
                        gateway.publish(everything[first : first + 50])
                        gateway.publish(everything[first : first + 50])
                gateway.publish_status()
                await side.until(level(2000))
                assert await side.n_encounters() == 2000
                gateway.journal_records(everything[2000:])
                gateway.publish(everything[2500:])
                await side.until(level(3000))
                assert await side.n_encounters() == 3000
                page = await side.records.call(Store.encounters, after=0, limit=5000)
                assert sorted(record.sequence for record in page.records) == list(range(1, 3001))
                assert side.intake.counters["new"] == 3000
                assert side.intake.counters["repaired"] > 0

    asyncio.run(story())


def test_a_mapper_that_comes_late_and_a_gateway_that_comes_late_both_end_level() -> None:
    async def story() -> None:
        port = free_port()
        async with mapper_side(port) as side:
            with FakeGateway(port=port) as gateway:
                gateway.journal_records([encounter(1), mode(2, node=9, t_ns=(0, None))])
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish_status()
                await side.until(level(2))
                await until(lambda: side.fleet.gateway_of(NodeId(9)) == "gateway1")
                views = side.fleet.gateways(now_ns=time.monotonic_ns())
                assert [(view.name, view.is_alive) for view in views] == [("gateway1", True)]
            await until(lambda: not side.fleet.gateways(now_ns=time.monotonic_ns())[0].is_alive)
            # The same gateway after its journal was lost: another journal, its offsets begin anew.
            with FakeGateway(port=port, journal="journal2") as gateway:
                gateway.journal_records([encounter(1, sequence=77, journal="journal2"), encounter(2, sequence=78, journal="journal2")])
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish_status()
                await side.until(level(2, journal="journal2"))
            assert await side.n_encounters() == 3

    asyncio.run(story())


def test_offsets_that_the_gateway_does_not_have_are_given_up_after_asking_again_once_the_disk_takes_it(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            gateway.journal_records([encounter(n) for n in (1, 2, 6, 7)])
            async with mapper_side(port, store=tmp_path / "store") as side:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                # A disk that is full for this one write and for none before it.
                full = "BEFORE UPDATE ON source WHEN new.watermark = 7 BEGIN SELECT RAISE(ABORT, 'database or disk is full'); END"
                await side.records.call(lambda store: store._db.execute(f"CREATE TEMP TRIGGER full {full}"))
                gateway.publish_status()
                await until(lambda: "make room on the disk" in (side.intake.store_fault or ""))
                assert side.intake.counters["given_up"] == 0
                await side.records.call(lambda store: store._db.execute("DROP TRIGGER full"))
                await side.until(level(7))
                assert side.intake.counters["given_up"] == 3
                (fault,) = side.intake.losses.values()
                assert "cannot be had from its journal" in fault
                assert side.intake.store_fault is None
                assert sum(request.from_offset == 3 for request in gateway.history_requests) >= 3

    asyncio.run(story())


def test_no_two_mappers_are_alive_under_one_name() -> None:
    async def story() -> None:
        port = free_port()
        async with AsyncExitStack() as stack:

            async def join(*, connect: tuple[str, ...] = (), listen: tuple[str, ...] = ()) -> Bus:
                bus = await Bus.open(site=SITE, connect=connect, listen=listen)
                stack.push_async_callback(bus.aclose)
                return bus

            await join(listen=(f"tcp/127.0.0.1:{port}",))
            first, second, third = [await join(connect=(f"tcp/127.0.0.1:{port}",)) for _ in range(3)]
            await first.claim("m1", settle_s=0.5)
            with pytest.raises(BusError, match="'m1' is alive at site 'local' already; give this one another --name"):
                await second.claim("m1", settle_s=10, patience_s=0.3)
            waiting = asyncio.create_task(third.claim("m1", settle_s=0.5))
            await first.aclose()
            await waiting  # as after one that was killed: its name is free in the end

    asyncio.run(story())


def test_rubbish_on_the_bus_is_counted_and_changes_nothing() -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port) as side:
                streams = (Stream.ENCOUNTERS, Stream.STATUS, Stream.EVENTS)
                await until(lambda: all(gateway.has_listener(stream) for stream in streams))
                foreign = encode_record(batch([encounter(1, gateway="gateway2")], gateway="gateway2"))
                rubbish = [b"", b"\xff" * 100, b"\x81\xa1a", msgspec.msgpack.encode({"gateway": "gateway1"}), foreign]
                for payload in rubbish:
                    for stream in streams:
                        gateway.publish_bytes(stream, payload)
                gateway.journal_records([encounter(1)])
                gateway.publish([encounter(1)])
                await side.until(level(1))
                assert await side.n_encounters() == 1
                await until(lambda: side.bus.counters["unfit"] == 3 * len(rubbish))

    asyncio.run(story())


def test_states_reach_the_fleet_and_the_newest_wins() -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port) as side:
                await until(lambda: gateway.is_heard and side.fleet.is_on_bus(gateway.name))
                seen = side.changes.versions
                gateway.publish_status()
                gateway.publish_node(2**64 - 1, mode=Mode.S, battery_mv=3600, heard_ns=20)
                gateway.publish_node(2**64 - 1, mode=Mode.CRW, battery_mv=9999, heard_ns=10)
                gateway.publish_node(4, heard_ns=1)
                await until(lambda: side.fleet.gateway_of(NodeId(4)) is not None)
                biobots = side.fleet.biobots(now_ns=time.monotonic_ns())
                assert [(view.node, view.battery_mv, view.is_reachable) for view in biobots] == [(4, 3900, True), (2**64 - 1, 3600, True)]
                assert side.changes.versions[Topic.BIOBOTS] > seen[Topic.BIOBOTS]

    asyncio.run(story())


async def stop(side: Side, node: int = 5, *, ttl_ms: int = 5000, command_id: str | None = None) -> Command:
    return await give(side, Wish(node=NodeId(node), action=StimulationAction.STOP, operator="anna", ttl_ms=ttl_ms, command_id=command_id))


async def give(side: Side, wish: Wish) -> Command:
    command = await side.desk.submit(wish)
    await side.desk.log.wait(lambda: has_ended(command), of=[command], timeout_s=DEADLINE_S)
    return command


def test_a_command_is_followed_through_its_stages_to_its_outcome() -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            async with mapper_side(port) as side:
                with pytest.raises(BiobotNotFoundError):
                    await give(side, Wish(node=NodeId(5), action=StimulationAction.START, operator="anna"))
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish_node(5)
                await until(lambda: side.fleet.gateway_of(NodeId(5)) is not None)
                command = await stop(side, command_id="once")
                assert [stage.stage for stage in command.stages] == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED]
                assert command.outcome is Outcome.BIOBOT_CONFIRMED
                assert await stop(side, command_id="once") is command
                assert len(gateway.commands) == 1
                with pytest.raises(CommandRefusedError, match="another command"):
                    await give(side, Wish(node=NodeId(5), action=StimulationAction.START, operator="anna", ttl_ms=1, command_id="once"))
                gateway.answer = lambda _request: (Stage.REFUSED,)
                refused = await stop(side)
                assert (refused.outcome, refused.reason) == (Outcome.REFUSED, "too soon after the train before")
                gateway.answer = lambda _request: (Stage.ACCEPTED,)
                assert (await stop(side)).outcome is Outcome.UNKNOWN
                assert [command.outcome for command in side.desk.log.recent(limit=2)] == [Outcome.UNKNOWN, Outcome.REFUSED]
                assert side.desk.log.get("once") is command
                with pytest.raises(CommandNotFoundError):
                    side.desk.log.get("never sent")

    asyncio.run(story())


def test_a_command_to_a_gateway_that_is_away_is_undelivered() -> None:
    async def story() -> None:
        port = free_port()
        async with mapper_side(port) as side:
            with FakeGateway(port=port) as gateway:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish_node(5)
                await until(lambda: side.fleet.gateway_of(NodeId(5)) is not None)
            await until(lambda: not side.bus.is_connected)
            command = await stop(side)
            assert (command.outcome, command.stages) == (Outcome.UNDELIVERED, [])

    asyncio.run(story())


def test_endpoints_that_cannot_be_are_refused_with_their_text() -> None:
    async def story() -> None:
        with pytest.raises(BusError, match="rubbish"):
            await Bus.open(site=SITE, connect=("rubbish",), listen=())
        port = free_port()
        with FakeGateway(port=port), pytest.raises(BusError, match="already in use"):
            await Bus.open(site=SITE, connect=(), listen=(f"tcp/127.0.0.1:{port}",))

    asyncio.run(story())


def test_what_left_the_journal_before_it_came_is_counted_as_expired_and_nothing_else(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        everything: list[JournalRecord] = [encounter(n) for n in range(1, 101)]
        with FakeGateway(port=port) as gateway:
            gateway.journal_records(everything)
            async with mapper_side(port, store=tmp_path / "store") as side:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish(everything[:20])
                gateway.publish(everything[49:60])  # beyond the gap
                await side.until(lambda store: store.n_encounters == 31)
                gateway.drop_before(71)
                gateway.publish_status()
                await side.until(level(100))
                assert await side.n_encounters() == 20 + 11 + 30
                assert side.intake.counters["expired"] == 29 + 10
                assert side.intake.counters["given_up"] == 0
                (fault,) = side.intake.losses.values()
                assert "61 to 70" in fault
                assert "[retention]" in fault
                assert all(request.from_offset >= 61 for request in gateway.history_requests[1:]), "not asked for in vain"
        port = free_port()
        with FakeGateway(port=port) as gateway:
            gateway.journal_records(everything)
            gateway.drop_before(71)
            async with mapper_side(port, store=tmp_path / "new") as side:
                await until(lambda: side.bus.is_connected and gateway.is_heard)
                gateway.publish_status()
                await side.until(level(100))
                assert side.intake.counters["expired"] == 70
                assert side.intake.losses == {}, "a store that begins late has missed the beginning: no fault"

    asyncio.run(story())


def test_a_mapper_tells_its_gateway_what_it_has_on_disk_and_no_more(tmp_path: Path) -> None:
    async def story() -> None:
        port = free_port()
        with FakeGateway(port=port) as gateway:
            places: tuple[tuple[Path | None, str], ...] = ((tmp_path / "store", "m1"), (None, "m2"))
            for store, name in places:
                async with mapper_side(port, store=store) as side:
                    await until(lambda: gateway.is_heard)
                    gateway.publish([encounter(n) for n in (1, 2, 3, 5)])
                    await side.until(lambda store: store.n_encounters == 4)
                    telling = asyncio.create_task(Watermarks(bus=side.bus, records=side.records, name=name, period_s=0.05).run())
                    if store is not None:
                        await until(lambda: bool(gateway.watermarks))
                    else:
                        await asyncio.sleep(0.3)
                    telling.cancel()
            assert {(mark.mapper, mark.journal, mark.offset) for mark in gateway.watermarks} == {("m1", "journal1", 3)}

    asyncio.run(story())
