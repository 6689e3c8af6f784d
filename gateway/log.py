"""Logs as events with facts, on stderr: readable on a terminal, one JSON object a line otherwise."""

import json
import logging
import sys
from datetime import UTC, datetime

_ROOT = "gateway"
_FACTS = "biobot_facts"


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


def set_up_logging(*, level: str = "INFO") -> None:
    """Send the gateway's events of this level and above to stderr."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_ReadableFormatter() if sys.stderr.isatty() else _JsonFormatter())
    logger = logging.getLogger(_ROOT)
    logger.handlers = [handler]
    logger.setLevel(level)
    logger.propagate = False


def _facts_of(record: logging.LogRecord) -> dict[str, object]:
    facts: dict[str, object] = getattr(record, _FACTS, {})
    return facts


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        moment = datetime.fromtimestamp(record.created, tz=UTC).isoformat(timespec="milliseconds")
        line: dict[str, object] = {"time": moment, "level": record.levelname, "event": record.getMessage(), **_facts_of(record)}
        return json.dumps(line, default=str)


class _ReadableFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        moment = datetime.fromtimestamp(record.created, tz=UTC).astimezone()
        facts = " ".join(f"{key}={value}" for key, value in _facts_of(record).items())
        return f"{moment:%H:%M:%S} {record.levelname:<7} {record.getMessage()} {facts}".rstrip()
