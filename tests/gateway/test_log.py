"""Events as a person, a machine and journald read them."""

import asyncio
import io
import json
import logging
import os
import threading
from collections.abc import Iterator

import pytest

from gateway.log import MAX_REPEATS, REPEAT_WINDOW_S, EventLog, log_what_nobody_caught, set_up_logging

log = EventLog("gateway.test")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture(autouse=True)
def restored() -> Iterator[None]:
    root, ours, hook = logging.getLogger(), logging.getLogger("gateway"), threading.excepthook
    kept = root.handlers[:], root.level, ours.level
    yield
    root.handlers[:] = kept[0]
    root.setLevel(kept[1])
    ours.setLevel(kept[2])
    threading.excepthook = hook


def entries(stream: io.StringIO) -> list[dict[str, object]]:
    return [json.loads(line) for line in stream.getvalue().splitlines()]


@pytest.mark.parametrize(("log_format", "is_json"), [("auto", False), ("json", True), ("text", False)])
def test_the_format_is_as_told_and_text_on_a_terminal_otherwise(log_format: str, is_json: bool) -> None:
    stream = Terminal()
    set_up_logging(log_format=log_format, stream=stream)
    log.info("radio.up", radio="a")
    assert stream.getvalue().startswith("{") is is_json
    plain = io.StringIO()
    set_up_logging(stream=plain)
    log.info("radio.up", radio="a")
    (entry,) = entries(plain)
    assert (entry["event"], entry["radio"], entry["level"]) == ("radio.up", "a", "INFO")


def test_what_is_said_too_often_is_left_out_and_its_number_told_for_each_radio() -> None:
    stream, clock = io.StringIO(), Clock()
    set_up_logging(stream=stream, clock=clock)
    for _ in range(MAX_REPEATS + 85):
        log.warning("radio.noise", radio="a")
    log.warning("radio.noise", radio="b")
    log.info("node.seen")
    said = entries(stream)
    assert [entry.get("radio") for entry in said] == ["a"] * MAX_REPEATS + ["b", None]
    clock.now_s = REPEAT_WINDOW_S
    log.info("node.seen")
    told, _ = entries(stream)[len(said) :]
    assert (told["event"], told["of"], told["radio"], told["n"], told["level"]) == ("log.left_out", "radio.noise", "a", 85, "WARNING")
    log.warning("radio.noise", radio="a")
    assert entries(stream)[-1]["event"] == "radio.noise", "a new window"


def test_other_libraries_warnings_have_the_same_form_and_their_chatter_is_left_out() -> None:
    stream = io.StringIO()
    set_up_logging(stream=stream)
    logging.getLogger("another.library").info("chatter")
    logging.getLogger("another.library").error("it broke", exc_info=OSError(5, "gone"))
    (entry,) = entries(stream)
    assert (entry["event"], entry["text"], entry["error"]) == ("log.another.library", "it broke", "OSError: [Errno 5] gone")


def test_under_journald_each_line_begins_with_its_priority(tmp_path: object) -> None:
    reading, writing = os.pipe()
    place = os.fstat(writing)
    with os.fdopen(reading) as lines, os.fdopen(writing, "w") as stream:
        set_up_logging(stream=stream, environment={"JOURNAL_STREAM": f"{place.st_dev}:{place.st_ino}"})
        log.error("journal.fault", reason="full")
        log.info("journal.recovered")
        set_up_logging(stream=stream, environment={"JOURNAL_STREAM": "1:1"})
        log.info("elsewhere")
        stream.close()
        first, second, third = lines.readlines()
    assert (first[:4], second[:4], third[:1]) == ("<3>{", "<6>{", "{")


def test_what_nobody_caught_is_an_event() -> None:
    stream = io.StringIO()
    set_up_logging(stream=stream)

    def burst() -> None:
        raise ValueError("in a thread")

    async def live() -> None:
        log_what_nobody_caught(log)
        asyncio.get_running_loop().call_soon(burst)
        await asyncio.sleep(0)
        thread = threading.Thread(target=burst, name="t1")
        thread.start()
        await asyncio.to_thread(thread.join)

    asyncio.run(live())
    loop, thread = entries(stream)
    assert (loop["event"], loop["error"]) == ("loop.unhandled", "ValueError: in a thread")
    assert (thread["event"], thread["thread"], thread["error"]) == ("thread.ended", "t1", "ValueError: in a thread")
    assert "burst" in str(thread["trace"])
