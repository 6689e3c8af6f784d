"""What the gateway says of itself over HTTP, asked with a real client on a real port."""

import asyncio
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import msgspec
import pytest
import zenoh
from prometheus_client.parser import text_string_to_metric_families

from firmware_protocol.contract.records import EncounterRecord
from firmware_protocol.units import BootId, Nanoseconds, NodeId
from gateway.config import MonitorTable
from gateway.errors import MonitorError
from gateway.health import DURATION_BOUNDS_S, Health, RadioState
from gateway.monitor.server import Monitor
from gateway.vitals import DiskUse, Vitals
from studies.ports import free_port
from tests.gateway.fake_radio import a_dongle, on_pty, until
from tests.gateway.harness import a_config, running

ROOT = Path(__file__).parents[2]


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def an_encounter(revision: int, *, error_ns: int) -> EncounterRecord:
    return EncounterRecord(
        gateway="base1",
        journal="feed",
        offset=1,
        boot=BootId(1),
        sequence=0,
        revision=revision,
        wall_anchor_ns=Nanoseconds(0),
        node_a=NodeId(1),
        node_b=NodeId(2),
        t_start_ns=Nanoseconds(0),
        t_end_ns=Nanoseconds(1),
        error_ns=Nanoseconds(error_ns),
        is_reciprocal=True,
    )


def get(port: int, path: str, method: str = "GET") -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        connection.request(method, path)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


class Desk:
    """A monitor that answers, and the vitals behind it."""

    def __init__(self, tmp_path: Path) -> None:
        self.clock = Clock()
        self.health = Health()
        self.vitals = Vitals(health=self.health, journal=tmp_path / "j.sqlite", connect=("tcp/router:7447",), clock=self.clock)
        self.monitor = Monitor.start(host="127.0.0.1", port=0, vitals=self.vitals)

    def ask(self, path: str, method: str = "GET") -> tuple[int, str]:
        port = urlsplit(self.monitor.url).port
        assert port is not None
        return get(port, path, method)

    def told(self, path: str, key: str) -> tuple[int, list[str]]:
        status, text = self.ask(path)
        return status, json.loads(text)[key]

    def samples(self) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
        status, text = self.ask("/metrics")
        assert status == 200
        families = list(text_string_to_metric_families(text))
        assert all(family.documentation for family in families)
        ours = [family for family in families if family.name.startswith("biobot_gateway_")]
        assert len({family.name for family in ours}) == len(ours)
        return {(one.name, tuple(sorted(one.labels.items()))): one.value for family in ours for one in family.samples}


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.monitor.close()


def test_what_is_missing_is_told_until_it_is_there(desk: Desk) -> None:
    assert desk.told("/healthz", "faults") == (200, []), "alive, if not of use yet"
    status, missing = desk.told("/readyz", "missing")
    assert (status, [one.split(":")[0] for one in missing]) == (
        503,
        ["the journal is not open yet", "the bus is not open yet", "no radio is up"],
    )
    desk.vitals.head_offset, desk.vitals.n_links = 7, 0
    desk.health.set_radio("serial:/dev/a", RadioState.DOWN, reason="there is no /dev/a")
    assert desk.told("/readyz", "missing")[1] == [
        "nobody is connected on the bus: no router or gateway answers at tcp/router:7447",
        "no radio is up: serial:/dev/a is down (there is no /dev/a)",
    ]
    desk.vitals.why_alone = "tcp/router:7447: nobody listens there"
    assert desk.told("/readyz", "missing")[1][0] == "nobody is connected on the bus: tcp/router:7447: nobody listens there"
    desk.vitals.n_links = 1
    desk.health.set_radio("tcp:b:1", RadioState.UP)
    assert desk.told("/readyz", "missing") == (200, [])
    desk.vitals.is_stopping = True
    assert desk.told("/readyz", "missing") == (503, ["the gateway is stopping"])


def test_a_journal_that_takes_nothing_a_disk_and_a_loop_that_hang_are_faults(desk: Desk) -> None:
    desk.vitals.journal_fault = "database or disk is full"
    status, (fault,) = desk.told("/healthz", "faults")
    assert status == 503
    assert "takes nothing: database or disk is full" in fault
    desk.vitals.journal_fault = None
    assert desk.told("/healthz", "faults") == (200, [])
    desk.clock.now_s += 6.0
    status, (fault,) = desk.told("/healthz", "faults")
    assert (status, "event loop has not moved for 6 s" in fault) == (503, True)
    assert desk.told("/readyz", "missing")[1][0] == fault
    desk.vitals.beat()
    desk.vitals.disk = DiskUse(journal_bytes=1, free_bytes=2**20)
    assert desk.told("/healthz", "warnings") == (200, ["only 1 MiB are free where the journal lies; make room"])


def test_numbers_have_proper_names_and_are_those_that_were_counted(desk: Desk) -> None:
    radio = desk.health.of_radio('serial:/dev/a "quoted"\\')
    radio.count("radio.bytes_in", 100)
    radio.count("link.lost.silent", 2)
    desk.health.set_radio('serial:/dev/a "quoted"\\', RadioState.UP)
    desk.health.count("journal.commits", 3)
    desk.health.count("command.accepted")
    desk.health.set_level("encounters.in_memory", 5)
    for duration_s in (0.0005, 0.001, 0.3, 11.0):
        desk.health.observe("journal.commit", duration_s)
    desk.vitals.disk = DiskUse(journal_bytes=10, free_bytes=20)
    desk.vitals.watermarks = {"desk": 4}
    desk.vitals.take_records([an_encounter(0, error_ns=5_000_000), an_encounter(1, error_ns=20_000_000)], 9)

    found = desk.samples()

    of_radio = (("radio", 'serial:/dev/a "quoted"\\'),)
    assert found["biobot_gateway_radio_up", of_radio] == 1
    assert found["biobot_gateway_radio_received_bytes_total", of_radio] == 100
    assert found["biobot_gateway_events_total", (("event", "link.lost.silent"), *of_radio)] == 2
    assert found["biobot_gateway_events_total", (("event", "command.accepted"), ("radio", ""))] == 1
    assert found["biobot_gateway_journal_commits_total", ()] == 3
    assert found["biobot_gateway_encounters_total", ()] == 1
    assert found["biobot_gateway_encounter_corrections_total", ()] == 1
    assert found["biobot_gateway_queue_length", (("queue", "encounters_in_memory"),)] == 5
    assert (found["biobot_gateway_journal_bytes", ()], found["biobot_gateway_disk_free_bytes", ()]) == (10, 20)
    assert found["biobot_gateway_journal_head_offset", ()] == 9
    assert found["biobot_gateway_mapper_lag_records", (("mapper", "desk"),)] == 5
    assert found["biobot_gateway_journal_commit_seconds_bucket", (("le", "0.001"),)] == 2
    assert found["biobot_gateway_journal_commit_seconds_bucket", (("le", "0.5"),)] == 3
    assert found["biobot_gateway_journal_commit_seconds_bucket", (("le", "+Inf"),)] == 4
    assert found["biobot_gateway_journal_commit_seconds_count", ()] == 4
    assert found["biobot_gateway_encounter_error_bound_seconds_bucket", (("le", "0.025"),)] == 1
    assert sum(name == "biobot_gateway_journal_commit_seconds_bucket" for name, _ in found) == len(DURATION_BOUNDS_S) + 1


def test_only_what_there_is_is_answered_and_only_to_those_who_read(desk: Desk) -> None:
    assert desk.ask("/")[0] == 404
    assert desk.ask("/metrics", "POST")[0] == 405
    assert desk.ask("/readyz", "HEAD") == (503, "")


def test_it_answers_while_the_gateways_loop_hangs_and_holds_nothing_up(desk: Desk) -> None:
    """The loop is blocked by a socket that nobody writes to; only the monitor's answer lets it go on."""
    mine, other = socket.socketpair()

    def ask_then_release() -> None:
        answers.append(desk.ask("/healthz")[0])
        other.send(b"x")

    answers: list[int] = []

    async def hang() -> bytes:
        asker = threading.Thread(target=ask_then_release)
        asker.start()
        byte = mine.recv(1)
        asker.join()
        return byte

    with mine, other:
        mine.settimeout(60)
        assert asyncio.run(hang()) == b"x"
    assert answers == [200]


def test_a_port_in_use_and_a_strange_address_are_told(desk: Desk) -> None:
    port = urlsplit(desk.monitor.url).port
    assert port is not None
    with pytest.raises(MonitorError, match=r"address already in use; give monitor.listen another port"):
        Monitor.start(host="127.0.0.1", port=port, vitals=desk.vitals)
    with pytest.raises(MonitorError, match=r"is no address of this machine"):
        Monitor.start(host="no-such-host.invalid", port=0, vitals=desk.vitals)


def test_counts_of_radios_are_kept_apart_and_summed() -> None:
    health = Health()
    health.count("radio.faults")
    health.of_radio("a").count("radio.faults", 2)
    health.of_radio("b").count("radio.faults", 4)
    health.of_radio("a").set_radio("a", RadioState.UP)
    health.of_radio("a").set_level("waiting", 9)
    assert health.counters() == {"radio.faults": 7, "waiting": 9}
    assert health.radio_counters() == {"a": {"radio.faults": 2}, "b": {"radio.faults": 4}}
    assert health.radios() == {"a": "up"}


def test_a_radios_since_is_when_its_state_began() -> None:
    health = Health()
    health.set_radio("a", RadioState.DOWN, reason="one")
    since = health.radio_conditions()["a"].since_wall_ns
    health.set_radio("a", RadioState.DOWN, reason="two")
    again = health.radio_conditions()["a"]
    assert (again.since_wall_ns, again.reason) == (since, "two")
    health.set_radio("a", RadioState.UP)
    assert health.radio_conditions()["a"].reason == ""


def test_it_becomes_ready_by_itself_when_dongle_and_router_come(tmp_path: Path) -> None:
    async def story() -> None:
        port, router = free_port(), f"tcp/127.0.0.1:{free_port()}"
        config = msgspec.structs.replace(
            a_config(tmp_path, f"serial:{tmp_path / 'dongle'}"), connect=(router,), monitor=MonitorTable(listen=f"127.0.0.1:{port}")
        )
        dongle = a_dongle(1, 2)
        async with running(config) as service:
            await until(lambda: len(service._vitals.missing()) == 2, what="it says that both are missing")
            settings = zenoh.Config()
            for key, value in {"mode": '"router"', "scouting/multicast/enabled": "false", "listen/endpoints": json.dumps([router])}.items():
                settings.insert_json5(key, value)
            with zenoh.open(settings):
                async with on_pty(dongle, tmp_path / "dongle"):
                    await until(lambda: not service._vitals.missing(), what="both were picked up")
                    dongle.backpacks[NodeId(1)].say_encounter(NodeId(2), ago_ms=5000, duration_ms=1000)
                    await until(lambda: dongle.backpacks[NodeId(1)].is_level, what="the report is acknowledged")
                    ready, _ = await asyncio.to_thread(get, port, "/readyz")
                    _, text = await asyncio.to_thread(get, port, "/metrics")
        assert ready == 200
        found = {one.name: one.value for family in text_string_to_metric_families(text) for one in family.samples}
        assert found["biobot_gateway_encounters_total"] == 1
        assert found["biobot_gateway_acknowledgement_seconds_count"] >= 1
        assert found["biobot_gateway_journal_commit_seconds_count"] >= 1
        assert found["biobot_gateway_bus_links"] == 1

    asyncio.run(story())


@pytest.mark.e2e
def test_a_gateway_without_router_and_dongle_runs_says_so_to_all_and_stops(tmp_path: Path) -> None:
    """READY=1, STATUS= and signs of life go to a real datagram socket."""
    port = free_port()
    command = [sys.executable, "-m", "gateway", "run", "--port", "serial:/dev/not-there", "--listen", f"tcp/127.0.0.1:{free_port()}"]
    command += ["--connect", f"tcp/127.0.0.1:{free_port()}", "--monitor", f"127.0.0.1:{port}"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "600000"}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as gateway:
            heard: list[str] = []
            while not {"READY=1", "WATCHDOG=1"} <= set(heard) or not any("0 of 1 radios up" in one for one in heard):
                heard.append(manager.recv(4096).decode())
            status, text = get(port, "/readyz")
            gateway.send_signal(signal.SIGTERM)
            assert gateway.wait(timeout=60) == 0
            while heard[-1] != "STOPPING=1":
                heard.append(manager.recv(4096).decode())
    assert status == 503
    assert [one.split(":")[0] for one in json.loads(text)["missing"]] == ["nobody is connected on the bus", "no radio is up"]
