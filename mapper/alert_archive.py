"""Alerts in the store."""

import sqlite3
from collections.abc import Iterable

import msgspec

from mapper.alert_book import Alert
from mapper.store_file import transaction, translate


class AlertArchive:
    """Alerts in a database; its thread is the store's."""

    def __init__(self, database: sqlite3.Connection, *, path: str) -> None:
        self._db = database
        self._path = path

    def every(self) -> list[Alert]:
        """Return all by id; what cannot be read is left out.

        Raises
        ------
        StoreError
            The file cannot be read.
        """
        try:
            rows = self._db.execute("SELECT body FROM alert ORDER BY id").fetchall()
        except sqlite3.Error as error:
            raise translate(error, path=self._path) from error
        return [alert for (body,) in rows if (alert := _decode(body)) is not None]

    def change(self, *, put: Iterable[Alert], drop: Iterable[int]) -> None:
        """Write some as they stand, and take some out.

        Raises
        ------
        StoreError
            The file cannot be written; nothing of it was done.
        """
        with transaction(self._db, path=self._path):
            self._db.executemany(
                "INSERT OR REPLACE INTO alert (id, body) VALUES (?, ?)", [(alert.id, msgspec.msgpack.encode(alert)) for alert in put]
            )
            self._db.executemany("DELETE FROM alert WHERE id = ?", [(number,) for number in drop])


def _decode(body: bytes) -> Alert | None:
    try:
        return msgspec.msgpack.decode(body, type=Alert)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
