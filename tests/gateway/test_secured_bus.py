"""Laws of the secured bus, between real sessions over TLS on loopback: who may does, who may not does nothing."""

import asyncio
import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import pytest
import zenoh

from firmware_protocol.contract.access import Role
from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.presence import Kind, build_token_key
from firmware_protocol.contract.records import GatewayStatus, Watermark, decode_record, encode_record
from firmware_protocol.contract.sessions import TlsTable
from firmware_protocol.units import BootId, Nanoseconds
from gateway.bus import Bus
from gateway.bus_client import read_status
from gateway.bus_session import ConnectionWatch, open_service
from gateway.connecting import diagnose
from gateway.errors import BusError
from gateway.health import Health
from gateway.journal import Journal
from gateway.site_watch import SiteWatch
from gateway.tls_files import check_tls_files
from studies.ports import free_port
from tests.gateway.certified import Certified
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config

STATUS = GatewayStatus(gateway="base1", journal="j", boot=BootId(1), head_offset=0, wall_ns=Nanoseconds(0), radios={}, counters={})
EVENT = GatewayEvent(gateway="base1", wall_ns=Nanoseconds(0), level="info", kind="test.event", facts={})


class Heard:
    """All that a session hears of one key."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.payloads: list[bytes] = []
        self._subscriber = session.declare_subscriber(key, lambda sample: self.payloads.append(sample.payload.to_bytes()))


@contextmanager
def open_as(certified: Certified, common_name: str, port: int) -> Iterator[zenoh.Session]:
    with open_service(listen=[], connect=[f"tls/127.0.0.1:{port}"], tls=certified.tls(common_name)) as session:
        yield session


async def has_routed(session: zenoh.Session) -> None:
    await until(lambda: bool(session.info.routers_zid()), what="the session has its router")


def answers_of(session: zenoh.Session, key: str) -> list[str]:
    replies = session.get(key, timeout=2.0)
    return [reply.ok.payload.to_string() if reply.ok is not None else "error" for reply in replies]


def test_each_role_does_what_its_row_allows_and_nothing_else(tmp_path: Path) -> None:
    """A gateway under another's name, a viewer and an operator out of bounds, others of another site and on no roster: all in vain."""

    async def story() -> None:
        certified = Certified(tmp_path / "ca")
        names = ("demo/gateway/base1", "demo/gateway/rogue", "demo/mapper/map1", "demo/viewer/bob", "demo/operator/al", "other/viewer/eve")
        for name in names:
            certified.tls(name)
        port = free_port()
        config = msgspec.structs.replace(
            a_config(tmp_path), site="demo", listen=(), connect=(f"tls/127.0.0.1:{port}",), tls=certified.tls("demo/gateway/base1")
        )
        health = Health()
        journal = Journal.open(tmp_path / "j", health=health)
        commands: list[object] = []
        with ExitStack() as stack:
            bus = await asyncio.to_thread(Bus.open, config, health=health)  # it is there before its router
            stack.callback(journal.close)
            stack.callback(bus.close)
            watermarks: list[tuple[str, int]] = []
            bus.start(
                on_command=lambda request, _: commands.append(request),
                open_reader=journal.reader,
                journal=journal.journal_id,
                on_watermark=lambda mapper, offset: watermarks.append((mapper, offset)),
            )
            bus.set_radio("serial:/dev/tty*A", is_up=True)
            stack.enter_context(certified.router(port))
            certified.tls("demo/viewer/late")  # after the router has read its roster
            session = {name: stack.enter_context(open_as(certified, name, port)) for name in (*names[1:], "demo/viewer/late")}
            for one in session.values():
                await has_routed(one)
            status_key = build_key(site="demo", stream=Stream.STATUS, gateway="base1")
            event_key = build_key(site="demo", stream=Stream.EVENTS, gateway=ANY)
            heard = {name: Heard(one, event_key) for name, one in session.items()}
            statuses = Heard(session["demo/viewer/bob"], build_key(site="demo", stream=Stream.STATUS, gateway=ANY))
            welcome = ("demo/mapper/map1", "demo/viewer/bob", "demo/operator/al")

            def all_hear() -> bool:
                bus.publish_event(EVENT)
                bus.publish_gateway_status(STATUS)
                return all(heard[name].payloads for name in welcome) and bool(statuses.payloads)

            await until(all_hear, what="mapper, viewer and operator hear the gateway")
            assert decode_record(heard["demo/viewer/bob"].payloads[0], GatewayEvent) == EVENT
            live = SiteWatch.open(site="demo", gateway=None, connect=config.connect, tls=certified.tls("demo/viewer/bob"))
            stack.callback(live.close)
            await until(lambda: all_hear() and STATUS in live.take(), what="the status view hears the gateway")
            # A record of history and a refusal of a command are answers too; no answer at all means that the router let nothing through.
            history, command = (build_key(site="demo", stream=stream, gateway="base1") for stream in (Stream.HISTORY, Stream.COMMAND))
            assert answers_of(session["demo/mapper/map1"], history)
            assert answers_of(session["demo/mapper/map1"], command)
            assert answers_of(session["demo/operator/al"], command)
            assert not answers_of(session["demo/operator/al"], history)
            for name in ("demo/viewer/bob", "demo/gateway/rogue", "other/viewer/eve", "demo/viewer/late"):
                assert not answers_of(session[name], history), name
                assert not answers_of(session[name], command), name
            # A mapper's watermarks come under its own name alone.
            for name, offset in (("map2", 9), ("map1", 7)):
                key = build_key(site="demo", stream=Stream.WATERMARK, gateway="base1", mapper=name)
                watermark = Watermark(mapper=name, journal=journal.journal_id, offset=offset)
                session["demo/mapper/map1"].put(key, encode_record(watermark))
            await until(lambda: bool(watermarks), what="the watermark comes")
            assert watermarks == [("map1", 7)]
            # Nobody but base1 is heard under its name, and nobody answers for it.
            for name, one in session.items():
                one.put(status_key, b"forged by " + name.encode())
                one.put(event_key.replace(ANY, "base1"), b"forged by " + name.encode())
            forgers = [one for name, one in session.items() if name != "demo/mapper/map1"]
            forged = [one.declare_queryable(history, lambda query: query.reply(history, b"forged")) for one in forgers]
            n_before = len(statuses.payloads)
            await until(lambda: all_hear() and len(statuses.payloads) > n_before + 5, what="what was put after the forgeries arrives")
            for name, listener in (*heard.items(), ("demo/viewer/bob", statuses)):
                assert {payload for payload in listener.payloads if b"forged" in payload} <= {b"forged by " + name.encode()}, (
                    name
                )  # its own
            assert "forged" not in answers_of(session["demo/mapper/map1"], history)
            assert {*heard["other/viewer/eve"].payloads, *heard["demo/viewer/late"].payloads} <= {
                b"forged by other/viewer/eve",
                b"forged by demo/viewer/late",
            }
            assert len(forged) == len(forgers)
            # Liveliness: the gateway and its radio are seen by the mapper, and gone with them.
            radio_key = build_token_key(site="demo", kind=Kind.RADIO, name="base1", radio="serial:/dev/tty*A")
            mapper = session["demo/mapper/map1"]

            def radios() -> list[str]:
                found = mapper.liveliness().get(build_token_key(site="demo", kind=Kind.RADIO, name=ANY, radio=ANY), timeout=2.0)
                return [str(reply.ok.key_expr) for reply in found if reply.ok is not None]

            await until(lambda: radios() == [radio_key], what="the radio's token is seen")
            session["demo/gateway/rogue"].liveliness().declare_token(build_token_key(site="demo", kind=Kind.GATEWAY, name="base2"))
            bus.set_radio("serial:/dev/tty*A", is_up=False)
            await until(lambda: radios() == [], what="the radio's token is gone")
            gateways = mapper.liveliness().get(build_token_key(site="demo", kind=Kind.GATEWAY, name=ANY), timeout=2.0)
            assert [str(reply.ok.key_expr) for reply in gateways if reply.ok] == [
                build_key(site="demo", stream=Stream.ALIVE, gateway="base1")
            ]

    asyncio.run(story())


@pytest.mark.parametrize("fault", ["out of date", "other authority", "we know another authority", "other host", "nobody"])
def test_a_refusal_has_its_reason(fault: str, tmp_path: Path) -> None:
    certified = Certified(tmp_path / "ca")
    other = Certified(tmp_path / "other")
    mine, theirs = certified.tls("demo/gateway/base1"), other.tls("demo/gateway/base1")
    outdated = Certified(tmp_path / "old", now=datetime.now(UTC) - timedelta(days=100)).tls("demo/gateway/base1", days=10)
    port = free_port()
    host = "127.0.0.2" if fault == "other host" else "127.0.0.1"
    endpoint = f"tls/{host}:{port}"
    tls, words = {
        "out of date": (msgspec.structs.replace(outdated, ca=mine.ca), "out of date"),
        "other authority": (msgspec.structs.replace(theirs, ca=mine.ca), "authority"),
        "we know another authority": (msgspec.structs.replace(mine, ca=theirs.ca), "authority"),
        "other host": (mine, "another host"),
        "nobody": (mine, "nobody listens"),
    }[fault]
    with ExitStack() as stack:
        if fault != "nobody":
            stack.enter_context(certified.router(port, host=host))
        assert words in diagnose(endpoint, tls)


def test_who_shows_no_certificate_is_refused_and_told_so(tmp_path: Path) -> None:
    certified = Certified(tmp_path / "ca")
    port = free_port()
    tls = TlsTable(ca=certified.tls("*/router/main").ca)
    with certified.router(port), pytest.raises(BusError, match="wants a certificate, and none was shown"):
        read_status(site="demo", gateway=None, connect=[f"tls/127.0.0.1:{port}"], timeout_s=1.0, tls=tls)


def test_why_nobody_is_connected_is_logged_once_and_so_is_that_somebody_is(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The reason is looked for again and again; it is told again only when it is another one."""

    async def story() -> None:
        certified = Certified(tmp_path / "ca")
        tls = certified.tls("demo/gateway/base1", days=20)
        port = free_port()
        health = Health()
        connect = [f"tls/127.0.0.1:{port}"]

        def told(event: str) -> int:
            return sum(record.getMessage() == event for record in caplog.records)

        with open_service(listen=[], connect=connect, tls=tls) as session:
            facts = check_tls_files(tls, roles=(Role.GATEWAY,), site="demo", name="base1").facts
            watch = ConnectionWatch(
                n_links=lambda: len(session.info.transports()),
                connect=connect,
                tls=tls,
                facts=facts,
                health=health,
                patience_s=0.0,
                ask_again_s=0.0,
            )
            try:
                await until(lambda: watch.missing is not None, what="it is known why nobody is connected")
                await until(lambda: health.counters()["bus.unconnected_looks"] >= 3, what="the reason has been looked for again")
                assert watch.missing is not None
                assert "nobody listens" in watch.missing
                with certified.router(port):
                    await until(lambda: watch.missing is None, what="the router is found")
                    await until(lambda: told("bus.connected") == 1, what="that is told")
                assert told("bus.unconnected") == 1
                assert told("tls.expiring") == 1
                assert health.counters()["tls.days_left"] == 19
            finally:
                watch.close()

    with caplog.at_level(logging.INFO, logger="gateway"):
        asyncio.run(story())
