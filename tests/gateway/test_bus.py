"""Laws of the gateway's door to Zenoh, between two real sessions."""

import asyncio
import time
from pathlib import Path

import msgspec
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import CommanderBeat, CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.mission_orders import MissionAction, MissionAnswer, MissionOrder
from firmware_protocol.contract.presence import Kind, build_token_key
from firmware_protocol.contract.records import MissionPhase, Mode, Watermark, decode_record, encode_record
from firmware_protocol.contract.sessions import TlsTable
from firmware_protocol.errors import RecordError
from firmware_protocol.units import Nanoseconds
from gateway.bus import Bus
from gateway.bus_client import send_order
from gateway.bus_commands import STOPS, CommandAnswer, OrderAnswer, read_command
from gateway.bus_presence import CommanderDoor
from gateway.bus_session import open_client, open_service
from gateway.bus_standing import ServiceSession, StandingDeclarations
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from studies.ports import free_port
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config, a_request, peer_config
from tests.gateway.makers import a_mode_record
from tests.gateway.test_control_book import a_stage


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
                deadline_s = time.monotonic() + 60.0
                while not health.counters().get("bus.refused_queries") and time.monotonic() < deadline_s:
                    time.sleep(0.01)  # noqa: ASYNC251  # to hold the loop is the point
                ask(StimulationAction.STOP)
                while bus.n_waiting < 257 and time.monotonic() < deadline_s:
                    time.sleep(0.01)  # noqa: ASYNC251  # same
                assert health.counters()["bus.refused_queries"] > 0
                await until(lambda: any(request.action is StimulationAction.STOP for request in taken), what="the stop is handed over")
                assert taken[0].action is StimulationAction.STOP, "it goes first"
        finally:
            await asyncio.to_thread(bus.close)
            journal.close()

    asyncio.run(story())


@given(st.sampled_from(StimulationAction), st.one_of(st.text(max_size=100), st.none(), st.integers(0, 9)))
def test_a_stop_is_read_whoever_gives_it_and_no_other_command_is(action: StimulationAction, operator: object) -> None:
    said = {**msgspec.to_builtins(a_request(7, action)), "operator": operator}
    octets = msgspec.msgpack.encode(said)
    is_name = isinstance(operator, str) and 1 <= len(operator) <= 64
    if is_name or action in STOPS:
        request = read_command(octets)
        assert request.action is action
        assert request.operator == ((operator[:64] if isinstance(operator, str) else "") or "unknown")
    else:
        with pytest.raises(RecordError):
            read_command(octets)


@given(st.binary(max_size=60))
def test_what_is_no_command_is_refused_as_none(octets: bytes) -> None:
    with pytest.raises(RecordError):
        read_command(octets)


def test_orders_come_in_and_are_answered_and_a_query_to_all_gateways_reaches_this_one(tmp_path: Path) -> None:
    async def story() -> None:
        health, config = Health(), a_config(tmp_path)
        journal = Journal.open(tmp_path / "j", health=health)
        turned_away: list[bytes] = []

        def obey(order: MissionOrder, answer: OrderAnswer) -> None:
            answer.tell(MissionAnswer(order_id=order.order_id, gateway="base1", is_taken=True, phase=MissionPhase.PAUSED))

        def take(request: StimulationRequest, answer: CommandAnswer) -> None:
            answer.tell(a_stage(request, Stage.BIOBOT_CONFIRMED))

        bus = await asyncio.to_thread(Bus.open, config, health=health)
        bus.start(
            on_command=take,
            on_order=obey,
            on_turned_away=lambda octets, _reason: turned_away.append(octets),
            open_reader=journal.reader,
            journal=journal.journal_id,
        )
        order = MissionOrder(order_id="o1", action=MissionAction.PAUSE, operator="tester", issued_wall_ns=Nanoseconds(0))
        stop = a_request(7, StimulationAction.STOP)
        try:
            answer = await asyncio.to_thread(
                send_order, order, site="test", gateway=None, connect=config.listen, timeout_s=60.0, tls=TlsTable()
            )
            assert answer is not None
            assert (answer.order_id, answer.phase) == ("o1", MissionPhase.PAUSED)
            with zenoh.open(peer_config(config.listen[0])) as peer:
                everybody = build_key(site="test", stream=Stream.COMMAND, gateway=ANY)

                def ask(payload: bytes) -> list[bytes]:
                    replies = peer.get(everybody, payload=payload, timeout=60.0, consolidation=zenoh.ConsolidationMode.NONE)
                    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

                stages: list[bytes] = []
                while not stages:  # until the peer has found the gateway
                    stages = await asyncio.to_thread(ask, encode_record(stop))
                assert decode_record(stages[0], CommandStage).command_id == stop.command_id
                assert await asyncio.to_thread(ask, b"no command") == []
                assert turned_away == [b"no command"]
                orders = build_key(site="test", stream=Stream.ORDERS, gateway=ANY)
                replies = await asyncio.to_thread(lambda: list(peer.get(orders, payload=b"no order", timeout=60.0)))
                assert [reply.ok for reply in replies] == [None]
                assert turned_away == [b"no command", b"no order"]
        finally:
            await asyncio.to_thread(bus.close)
            journal.close()

    asyncio.run(story())


def test_a_commander_whose_going_was_not_seen_is_gone_once_its_token_is_not_told_again(tmp_path: Path) -> None:
    async def story() -> None:
        heard: list[str] = []

        class Ear:
            def came(self, name: str) -> None:
                heard.append(f"{name} came")

            def went(self, name: str) -> None:
                heard.append(f"{name} went")

            def beat(self, name: str, *, number: int, at_ns: int) -> None:
                assert at_ns > 0
                heard.append(f"{name} beat {number}")

        endpoint = a_config(tmp_path).listen
        door = CommanderDoor(loop=asyncio.get_running_loop(), health=Health(), listener=Ear())
        names = ("ann", "bob")
        tokens = [build_token_key(site="test", kind=Kind.COMMANDER, name=name) for name in names]
        pattern = build_token_key(site="test", kind=Kind.COMMANDER, name=ANY)
        with open_service(listen=endpoint, connect=(), tls=TlsTable()) as session:

            def watch() -> zenoh.Subscriber[None]:
                door.begin_anew()
                return session.liveliness().declare_subscriber(pattern, door.take_token, history=True)

            subscriber = watch()
            beats = session.declare_subscriber(build_key(site="test", stream=Stream.BEAT, gateway=ANY), door.take_beat)
            with open_client(connect=endpoint, tls=TlsTable()) as commander:
                early = session.declare_subscriber(
                    build_key(site="test", stream=Stream.BEAT, gateway="bob"), lambda _: heard.append("early")
                )
                while "early" not in heard:  # until the gateway's subscriber is known there
                    commander.put(build_key(site="test", stream=Stream.BEAT, gateway="bob"), encode_record(CommanderBeat(number=7)))
                    await asyncio.sleep(0.01)
                early.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
                assert set(heard) == {"early"}, "a beat alone makes nobody a commander"
                held = [commander.liveliness().declare_token(token) for token in tokens]
                await until(lambda: {"ann came", "bob came", "bob beat 1"} <= set(heard), what="both are there, and one was heard before")
                for payload in (b"no beat", encode_record(CommanderBeat(number=3))):
                    commander.put(build_key(site="test", stream=Stream.BEAT, gateway="ann"), payload)
                await until(lambda: "ann beat 3" in heard, what="a beat is heard")
                subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
                held[1].undeclare()  # type: ignore[no-untyped-call]  # same
                everyone = session.liveliness()
                await until(lambda: not list(everyone.get(tokens[1], timeout=0.2)), what="the token is gone")
                assert "bob went" not in heard
                subscriber = watch()
                await until(lambda: "bob went" in heard, what="its going is noticed")
                assert "ann went" not in heard
            await until(lambda: "ann went" in heard, what="the session's end is noticed")
            for declared in (beats, subscriber):
                declared.undeclare()  # type: ignore[no-untyped-call]  # same

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


def test_what_was_declared_and_taken_back_before_there_was_a_session_is_made_once() -> None:
    """A radio that flaps while nobody is there to connect to."""

    async def story() -> None:
        port, made = free_port(), 0

        def make(session: zenoh.Session) -> zenoh.LivelinessToken:
            nonlocal made
            made += 1
            return session.liveliness().declare_token("test/radio")

        session = ServiceSession(listen=(), connect=(f"tcp/127.0.0.1:{port}",), tls=TlsTable())
        standing = StandingDeclarations(session)
        for _ in range(20):
            standing.declare("radio", make)
            standing.undeclare("radio")
        standing.declare("radio", make)
        with open_service(listen=(f"tcp/127.0.0.1:{port}",), connect=(), tls=TlsTable()) as router:
            everyone = router.liveliness()
            await until(lambda: bool(list(everyone.get("test/radio", timeout=0.5))), what="the token is seen")
            assert made == 1
            standing.undeclare("radio")
            await until(lambda: not list(everyone.get("test/radio", timeout=0.5)), what="the token is gone")
            standing.close()
            session.close()

    asyncio.run(story())
