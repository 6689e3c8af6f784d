"""Answers to those who ask which recordings there are, from a thread of their own."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import zenoh

from firmware_protocol.contract.recordings import RecordingList
from firmware_protocol.contract.records import encode_record
from gateway.bus_query import refuse
from gateway.health import Health
from gateway.log import EventLog

_log = EventLog(__name__)

_MAX_WAITING: Final = 8


class RecordingsDoor:
    """Takes queries on Zenoh's threads, and answers one after the other."""

    def __init__(self, *, key: str, health: Health, answer: Callable[[], RecordingList]) -> None:
        self._key = key
        self._health = health
        self._answer_with = answer
        self._places = threading.BoundedSemaphore(_MAX_WAITING)
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="recordings")

    def take(self, query: zenoh.Query) -> None:
        """Runs on a thread of Zenoh."""
        if not self._places.acquire(blocking=False):
            refuse(query, f"{_MAX_WAITING} wait for a list of recordings already; try again", health=self._health)
            return
        self._executor.submit(self._answer, query)

    def close(self) -> None:
        """Finish the answer under way; those that wait get none."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            with query:
                query.reply(self._key, encode_record(self._answer_with()))
        except (zenoh.ZError, OSError) as error:
            _log.debug("bus.recordings_lost", reason=str(error))
        finally:
            self._places.release()
