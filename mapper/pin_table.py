"""The table of pins in the store's file."""

import sqlite3

from mapper.named_pins import NamedPin
from mapper.store import Store


def read_pins(store: Store) -> tuple[NamedPin, ...]:
    """Return all pins by name.

    Raises
    ------
    StoreError
        The file cannot be read.
    """

    def read(database: sqlite3.Connection) -> tuple[NamedPin, ...]:
        rows = database.execute("SELECT name, place, x, y FROM pin ORDER BY name").fetchall()
        return tuple(NamedPin(name=name, place=place, x=x, y=y) for name, place, x, y in rows)

    return store.read(read)


def put_pin(store: Store, pin: NamedPin) -> None:
    """Keep a pin, in the place of the one of its name.

    Raises
    ------
    StoreError
        The file cannot be written; all is as before.
    """
    with store.transaction() as database:
        values = (pin.name, pin.place, pin.x, pin.y)
        database.execute("INSERT OR REPLACE INTO pin (name, place, x, y) VALUES (?, ?, ?, ?)", values)


def drop_pin(store: Store, name: str) -> None:
    """Forget a pin; raises what `put_pin` raises."""
    with store.transaction() as database:
        database.execute("DELETE FROM pin WHERE name = ?", (name,))
