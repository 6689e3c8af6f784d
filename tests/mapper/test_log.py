"""Events as a person and as a machine read them."""

import io
import json
import logging
from collections.abc import Iterator

import pytest

from mapper.log import EventLog, set_up_logging


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def _restored_root() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


def test_off_a_terminal_every_event_is_one_json_object() -> None:
    stream = io.StringIO()
    set_up_logging(level="debug", stream=stream)
    log = EventLog("mapper.test")
    log.debug("map.begun", encounters=3)
    log.info("map.done", seconds=0.5)
    log.warning("map.late", path=b"\xff")
    log.error("map.failed", reason="two\nlines")
    entries = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert [(entry["level"], entry["event"]) for entry in entries] == [
        ("DEBUG", "map.begun"),
        ("INFO", "map.done"),
        ("WARNING", "map.late"),
        ("ERROR", "map.failed"),
    ]
    assert entries[0]["encounters"] == 3
    assert entries[3]["reason"] == "two\nlines"


@pytest.mark.parametrize("stream", [io.StringIO(), _Terminal()])
def test_an_exception_is_logged_with_its_place(stream: io.StringIO) -> None:
    set_up_logging(stream=stream)
    try:
        int("x")
    except ValueError:
        logging.getLogger("foreign").exception("worker.died")
    assert "worker.died" in stream.getvalue()
    assert "invalid literal" in stream.getvalue()


def test_on_a_terminal_an_event_is_a_line_with_its_fields() -> None:
    stream = _Terminal()
    set_up_logging(level="INFO", stream=stream)
    EventLog("mapper.test").debug("not.shown")
    EventLog("mapper.test").info("map.done", seconds=0.5, holes=2)
    (line,) = stream.getvalue().splitlines()
    assert line.endswith("INFO    map.done seconds=0.5 holes=2")
