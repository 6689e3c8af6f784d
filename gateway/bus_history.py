"""Answers to history queries, from a thread of their own."""

import sqlite3
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import zenoh

from firmware_protocol.contract.records import EncodedBatch, HistoryRequest, decode_record, encode_record
from firmware_protocol.errors import RecordError
from gateway.bus_query import payload_of, refuse
from gateway.health import Health
from gateway.log import EventLog

_log = EventLog(__name__)

_MAX_WAITING = 16


class HistoryDoor:
    """Takes history queries on Zenoh's threads, and answers one after the other."""

    def __init__(self, *, key: str, health: Health, answer: Callable[[HistoryRequest], Iterator[EncodedBatch]]) -> None:
        self._key = key
        self._health = health
        self._answer_with = answer
        self._places = threading.BoundedSemaphore(_MAX_WAITING)
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="history")

    def take(self, query: zenoh.Query) -> None:
        """Runs on a thread of Zenoh."""
        try:
            request = decode_record(payload_of(query), HistoryRequest)
        except RecordError as error:
            refuse(query, str(error), health=self._health)
            return
        if not self._places.acquire(blocking=False):
            refuse(query, f"{_MAX_WAITING} history queries wait already; try again", health=self._health)
            return
        self._executor.submit(self._answer, query, request)

    def close(self) -> None:
        """Finish the answer under way; those that wait get none."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _answer(self, query: zenoh.Query, request: HistoryRequest) -> None:
        try:
            with query:
                for batch in self._answer_with(request):
                    query.reply(self._key, encode_record(batch))
        except zenoh.ZError as error:
            _log.debug("bus.history_lost", reason=str(error))
        except sqlite3.Error as error:
            self._health.count("bus.failed_history")
            _log.error("bus.history_failed", reason=str(error))
        finally:
            self._places.release()
