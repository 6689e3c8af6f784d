"""The table of alerts in the store's file."""

import sqlite3
from collections.abc import Iterable

import msgspec

from mapper.alert_book import Alert
from mapper.store import Store


def read_alerts(store: Store) -> list[Alert]:
    """Return all by id; what cannot be read is left out.

    Raises
    ------
    StoreError
        The file cannot be read.
    """

    def read(database: sqlite3.Connection) -> list[bytes]:
        return [body for (body,) in database.execute("SELECT body FROM alert ORDER BY id").fetchall()]

    return [alert for body in store.read(read) if (alert := _decode(body)) is not None]


def change_alerts(store: Store, *, put: Iterable[Alert], drop: Iterable[int]) -> None:
    """Write some as they stand, and take some out.

    Raises
    ------
    StoreError
        The file cannot be written; nothing of it was done.
    """
    with store.transaction() as database:
        rows = [(alert.id, msgspec.msgpack.encode(alert)) for alert in put]
        database.executemany("INSERT OR REPLACE INTO alert (id, body) VALUES (?, ?)", rows)
        database.executemany("DELETE FROM alert WHERE id = ?", [(number,) for number in drop])


def _decode(body: bytes) -> Alert | None:
    try:
        return msgspec.msgpack.decode(body, type=Alert)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
