"""Logs as events with facts, on stderr: readable on a terminal, one JSON object a line otherwise.

An event that comes again and again is left out after ``MAX_REPEATS`` lines in ``REPEAT_WINDOW_S``, for each radio by itself; how many
were left out is said with the first line after the window. Under systemd each line begins with its syslog priority (sd-daemon(3)), which
journald takes off again, so that ``journalctl --priority warning`` finds it. What other libraries log from WARNING on comes in the same
form.
"""

import asyncio
import json
import logging
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, TextIO

_ROOT = "gateway"
_FACTS = "biobot_facts"

REPEAT_WINDOW_S = 10.0
MAX_REPEATS = 20

_MAX_KINDS = 1024
"""Events that are kept account of at the same time; there are some dozens, and as many more as there are radios."""

_PRIORITIES = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


class EventLog:
    """Log named events with their facts: ``log.info("radio.up", radio=name)``."""

    __slots__ = ("_logger",)

    def __init__(self, name: str) -> None:
        self._logger = logging.getLogger(name)

    def debug(self, event: str, **facts: object) -> None:
        """Log what happens with every frame or message."""
        if self._logger.isEnabledFor(logging.DEBUG):
            self._write(logging.DEBUG, event, facts)

    def info(self, event: str, **facts: object) -> None:
        """Log a change of state."""
        self._write(logging.INFO, event, facts)

    def warning(self, event: str, **facts: object) -> None:
        """Log a fault that the gateway heals by itself."""
        self._write(logging.WARNING, event, facts)

    def error(self, event: str, **facts: object) -> None:
        """Log what a person must act on."""
        self._write(logging.ERROR, event, facts)

    def _write(self, level: int, event: str, facts: dict[str, object]) -> None:
        self._logger.log(level, event, extra={_FACTS: facts})


def set_up_logging(
    *,
    level: str = "INFO",
    log_format: str = "auto",
    stream: TextIO | None = None,
    environment: Mapping[str, str] | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Send the gateway's events of this level and above to stderr, and warnings of other libraries too.

    Parameters
    ----------
    log_format
        text, json, or auto: text where the stream is a terminal.
    environment
        Where ``JOURNAL_STREAM`` is looked for; None: this process's.
    clock
        Seconds that only grow, for the limit of repetitions.
    """
    target = sys.stderr if stream is None else stream
    is_text = log_format == "text" or (log_format == "auto" and target.isatty())
    formatter: logging.Formatter = _ReadableFormatter() if is_text else _JsonFormatter()
    if _is_journal(target, os.environ if environment is None else environment):
        formatter = _PriorityFormatter(formatter)
    handler = logging.StreamHandler(target)
    handler.setFormatter(formatter)
    handler.addFilter(_RepeatLimit(clock=clock, tell=_past_filters(handler)))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger(_ROOT).setLevel(level)


def log_what_nobody_caught(log: EventLog) -> None:
    """Have exceptions that end a thread, or that no task waits for, become events; call it in the running loop."""

    def on_loop(_loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        log.error("loop.unhandled", reason=context.get("message"), **({} if error is None else describe(error)))

    def on_thread(args: threading.ExceptHookArgs) -> None:
        name = args.thread.name if args.thread is not None else "?"
        log.error("thread.ended", thread=name, **describe(args.exc_value or args.exc_type()))

    asyncio.get_running_loop().set_exception_handler(on_loop)
    threading.excepthook = on_thread


def describe(error: BaseException) -> dict[str, str]:
    """Return an exception as facts of an event."""
    trace = "".join(traceback.format_exception(error))
    return {"error": f"{type(error).__name__}: {error}", "trace": trace}


@dataclass(slots=True)
class _Repeats:
    """One kind of event in its window."""

    until_s: float
    n_lines: int = 0
    n_left_out: int = 0
    level: int = logging.INFO


class _RepeatLimit(logging.Filter):
    """Leaves out what is said too often, and says how often it was."""

    def __init__(self, *, clock: Callable[[], float], tell: Callable[[logging.LogRecord], object]) -> None:
        super().__init__()
        self._clock = clock
        self._tell = tell
        self._kinds: dict[tuple[str, object], _Repeats] = {}
        self._lock = threading.RLock()

    def filter(self, record: logging.LogRecord) -> bool:
        with self._lock:
            now_s = self._clock()
            ended = [(kind, window) for kind, window in self._kinds.items() if window.until_s <= now_s]
            for kind, window in ended:
                del self._kinds[kind]
                if window.n_left_out:
                    self._tell(_left_out(kind, window))
            kind = (_event_of(record), _facts_of(record).get("radio"))
            if kind not in self._kinds and len(self._kinds) >= _MAX_KINDS:
                return True
            window = self._kinds.setdefault(kind, _Repeats(now_s + REPEAT_WINDOW_S, level=record.levelno))
            window.n_lines += 1
            window.n_left_out += window.n_lines > MAX_REPEATS
            return window.n_lines <= MAX_REPEATS


def _past_filters(handler: logging.Handler) -> Callable[[logging.LogRecord], None]:
    def emit(record: logging.LogRecord) -> None:
        handler.acquire()
        try:
            handler.emit(record)
        finally:
            handler.release()

    return emit


def _left_out(kind: tuple[str, object], window: _Repeats) -> logging.LogRecord:
    event, radio = kind
    facts: dict[str, object] = {"of": event, "n": window.n_left_out, "within_s": REPEAT_WINDOW_S}
    record = logging.LogRecord(_ROOT, window.level, "", 0, "log.left_out", None, None)
    setattr(record, _FACTS, facts if radio is None else {**facts, "radio": radio})
    return record


def _is_journal(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Whether the stream goes to journald: ``JOURNAL_STREAM`` is then its device and inode (systemd.exec(5))."""
    try:
        place = os.fstat(stream.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return environment.get("JOURNAL_STREAM") == f"{place.st_dev}:{place.st_ino}"


def _facts_of(record: logging.LogRecord) -> dict[str, object]:
    """Return an event's facts; what another library logged has its text and its exception."""
    facts: dict[str, object] | None = getattr(record, _FACTS, None)
    if facts is not None:
        return facts
    error = record.exc_info[1] if record.exc_info else None
    return {"text": record.getMessage(), **({} if error is None else describe(error))}


def _event_of(record: logging.LogRecord) -> str:
    return record.getMessage() if hasattr(record, _FACTS) else f"log.{record.name}"


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        moment = datetime.fromtimestamp(record.created, tz=UTC).isoformat(timespec="milliseconds")
        line: dict[str, object] = {"time": moment, "level": record.levelname, "event": _event_of(record), **_facts_of(record)}
        return json.dumps(line, default=str)


class _ReadableFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        moment = datetime.fromtimestamp(record.created, tz=UTC).astimezone()
        facts = " ".join(f"{key}={value}" for key, value in _facts_of(record).items())
        return f"{moment:%H:%M:%S} {record.levelname:<7} {_event_of(record)} {facts}".rstrip()


class _PriorityFormatter(logging.Formatter):
    def __init__(self, inner: logging.Formatter) -> None:
        super().__init__()
        self._inner = inner

    def format(self, record: logging.LogRecord) -> str:
        priority = _PRIORITIES.get(record.levelno, 6)
        return "\n".join(f"<{priority}>{line}" for line in self._inner.format(record).splitlines())
