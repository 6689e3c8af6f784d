"""`biobot-mapper serve` as a process: it starts, stops, is killed and started again, and says clearly what it cannot do."""

import json
import logging
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from firmware_protocol.contract.records import EncounterRecord
from mapper.__main__ import main
from mapper.changes import Topic
from mapper.rips_engines import name_engine
from studies.ports import free_port
from tests.mapper.fake_gateway import FakeGateway, encounter
from tests.mapper.ring import ring_records
from tests.mapper.serving import STOP_S, serving, until

DEADLINE_S = 60.0


def get(url: str) -> Any:
    return httpx.get(url, timeout=60).json()


@pytest.fixture
def own_logging() -> Iterator[None]:
    """Put back what ``serve`` sets up for a whole process."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


def is_running(pid: int) -> bool:
    """Say whether a process runs; one that has ended may still be listed, if nobody asked how it ended."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"


def test_killed_and_started_again_it_has_every_record_once_and_makes_the_map_anew(tmp_path: Path) -> None:
    port = free_port()
    store = ["--store", str(tmp_path / "records.db")]
    records = ring_records()
    half = len(records) // 2
    wanted = sum(isinstance(record, EncounterRecord) for record in records)
    with FakeGateway(port=port) as gateway:
        gateway.journal_records(records[:half])
        with serving(tmp_path, connect=port, arguments=store) as (url, process):
            until(lambda: get(url + "readyz")["is_connected"])
            gateway.publish_status()
            until(lambda: get(url + "healthz")["n_encounters"] > 0)
            process.send_signal(signal.SIGKILL)
            process.wait()
        gateway.journal_records(records[half:])
        with serving(tmp_path, connect=port, arguments=store) as (url, _process):
            until(lambda: get(url + "readyz")["is_connected"])
            gateway.publish_status()
            until(lambda: get(url + "healthz")["n_encounters"] == wanted)
            until(lambda: httpx.get(url + "api/v1/map", timeout=60).status_code == httpx.codes.OK)
            until(lambda: get(url + "api/v1/map")["n_encounters"] == wanted)
            assert get(url + "api/v1/map")["betti_numbers"] == [1, 1]
            # The first life's records were read from the file, not asked for again.
            assert get(url + "healthz")["counters"]["new"] < len(records)


def test_slow_kernels_are_told_once_and_named_by_the_health(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BIOBOT_KERNELS", "plain")
    with serving(tmp_path, connect=free_port()) as (url, _process):
        engines = get(url + "healthz")["engines"]
    assert engines == {"kernels": "plain", "persistence": name_engine()}
    events = [json.loads(line) for line in (tmp_path / "mapper.log").read_text().splitlines() if line.startswith("{")]
    (told,) = [event for event in events if event["event"] == "kernels.plain"]
    assert told["level"] == "WARNING"
    assert "BIOBOT_KERNELS" in told["reason"]


def test_kernels_that_are_demanded_and_unknown_are_refused_before_anything_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_logging: None, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BIOBOT_KERNELS", "fast")
    store = tmp_path / "records.db"
    assert main(["serve", "--store", str(store), "--port", "0"]) == 2
    assert "BIOBOT_KERNELS is 'fast'; set it to auto, compiled, plain, or not at all" in capsys.readouterr().err
    assert not store.exists()


def test_stopped_and_started_again_it_serves_the_last_map_before_a_gateway_is_there(tmp_path: Path) -> None:
    port = free_port()
    store = ["--store", str(tmp_path / "records.db")]
    records = ring_records()
    wanted = sum(isinstance(record, EncounterRecord) for record in records)
    with FakeGateway(port=port) as gateway, serving(tmp_path, connect=port, arguments=store) as (url, _process):
        gateway.journal_records(records)
        until(lambda: get(url + "readyz")["is_connected"])
        gateway.publish_status()
        until(lambda: get(url + "api/v1/map/status")["n_encounters"] == wanted)
        before = httpx.get(url + "api/v1/map", timeout=60)
    with serving(tmp_path, connect=port, arguments=store) as (url, _process):
        after, status = httpx.get(url + "api/v1/map", timeout=60), get(url + "api/v1/map/status")
        assert (after.headers["etag"], after.content) == (before.headers["etag"], before.content)
        assert (status["n_known"], status["n_waiting"], status["behind_s"], status["is_computing"]) == (wanted, 0, 0, False)
    with serving(tmp_path, connect=port, arguments=[*store, "--window-s", "10"]) as (url, _process):
        until(lambda: httpx.get(url + "api/v1/map", timeout=60).status_code == httpx.codes.OK)
        document = get(url + "api/v1/map")
        assert document["window_s"] == 10
        assert document["n_encounters"] + document["n_before"] == wanted


def test_event_streams_tell_of_changes_and_do_not_hold_up_the_stop(tmp_path: Path) -> None:
    port = free_port()
    with FakeGateway(port=port) as gateway, serving(tmp_path, connect=port) as (url, process):
        until(lambda: get(url + "readyz")["is_connected"])
        with httpx.stream("GET", url + "api/v1/events", timeout=DEADLINE_S) as stream:
            lines = stream.iter_lines()
            first = next(json.loads(line[6:]) for line in lines if line.startswith("data: "))
            assert set(first) == {str(topic) for topic in Topic}
            gateway.journal_records([encounter(1), encounter(2)])
            gateway.publish([encounter(1), encounter(2)])
            seen = next(
                change for line in lines if line.startswith("data: ") and (change := json.loads(line[6:]))["records"] > first["records"]
            )
            assert seen["biobots"] >= first["biobots"]
            process.send_signal(signal.SIGTERM)
            assert list(lines) is not None
            assert process.wait(STOP_S) == 0
    assert "graceful shutdown exceeded" not in (tmp_path / "mapper.log").read_text()


def test_no_process_is_left_behind(tmp_path: Path) -> None:
    port = free_port()
    with FakeGateway(port=port) as gateway:
        gateway.journal_records(ring_records())
        with serving(tmp_path, connect=port) as (url, process):
            until(lambda: get(url + "readyz")["is_connected"])
            gateway.publish_status()
            until(lambda: httpx.get(url + "api/v1/map", timeout=60).status_code == httpx.codes.OK)
            threads = Path(f"/proc/{process.pid}/task").iterdir()
            children = [int(pid) for thread in threads for pid in (thread / "children").read_text().split()]
            assert children
    until(lambda: not any(is_running(pid) for pid in children))


@pytest.mark.usefixtures("own_logging")
def test_an_address_in_use_is_said_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(["serve", "--port", str(port)]) == 1
    said = capsys.readouterr().err
    assert said.splitlines() == [
        f"biobot-mapper: error: cannot listen on 127.0.0.1:{port}: address already in use; choose another --port, or 0 for a free one"
    ]


@pytest.mark.usefixtures("own_logging")
@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["--host", "0.0.0.0", "--port", "0"], 1, "--allow-remote"),
        (["--host", "203.0.113.9", "--port", "0"], 1, "--allow-remote"),
        (["--host", "no such host", "--port", "0"], 1, "choose another --host"),
        (["--host", "203.0.113.9", "--port", "0", "--allow-remote"], 1, "cannot listen on 203.0.113.9:0"),
        (["--port", "70000"], 2, "serve.port is 70000"),
        (["--port", "0", "--min-interval-s", "0"], 2, "serve.min_interval_s is 0.0"),
        (["--port", "0", "--window-s", "0"], 2, "serve.window_s is 0.0"),
        (["--port", "0", "--window-s", "nan"], 2, "window_s is nan"),
        (["--port", "0", "--window-s", "inf"], 2, "serve.window_s is inf"),
        (["--port", "0", "--site", "a/b"], 2, "a site name has"),
        (["--port", "0", "--connect", "nonsense"], 2, "such as tcp/127.0.0.1:7447"),
        (["--port", "0", "--store", "/"], 1, "is a directory"),
        (["--port", "0", "--store", "/proc/none/records.db"], 1, "there is no directory"),
        (["--port", "0", "--url-file", "/proc/none/url"], 1, "cannot write"),
    ],
)
def test_what_cannot_be_is_said_without_a_traceback(
    arguments: list[str], status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", *arguments]) == status
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said
