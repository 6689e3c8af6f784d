"""The operator's pins: in memory for those who look, in the store for the next start."""

from typing import Final

from mapper.changes import Changes, Topic
from mapper.named_pins import NamedPin
from mapper.pin_table import drop_pin, put_pin, read_pins
from mapper.request_errors import PinNotFoundError, PinRefusedError
from mapper.store_thread import StoreThread

MAX_PINS: Final = 200


class PinBoard:
    """All pins by name. `restore` reads what was kept."""

    def __init__(self, *, records: StoreThread, changes: Changes) -> None:
        self._records = records
        self._changes = changes
        self._pins: dict[str, NamedPin] = {}

    @property
    def pins(self) -> tuple[NamedPin, ...]:
        """All pins by name."""
        return tuple(self._pins[name] for name in sorted(self._pins))

    def get(self, name: str) -> NamedPin:
        """Return one pin.

        Raises
        ------
        PinNotFoundError
            There is none of that name.
        """
        if name not in self._pins:
            raise PinNotFoundError(name=name)
        return self._pins[name]

    async def restore(self) -> None:
        """Read the pins in the store.

        Raises
        ------
        StoreError
            The file cannot be read.
        """
        self._pins = {pin.name: pin for pin in await self._records.call(read_pins)}

    async def put(self, pin: NamedPin) -> bool:
        """Keep a pin, in the place of the one of its name; say whether it is a new one.

        Raises
        ------
        PinRefusedError
            There are as many as may be.
        StoreError
            The store cannot be written; all is as before.
        """
        is_new = pin.name not in self._pins
        if is_new and len(self._pins) >= MAX_PINS:
            raise PinRefusedError(name=pin.name, reason=f"there are {MAX_PINS} pins, the limit", next_step="remove one that is not needed")
        await self._records.call(put_pin, pin)
        self._pins[pin.name] = pin
        self._changes.bump(Topic.PINS)
        return is_new

    async def drop(self, name: str) -> None:
        """Forget a pin; raises what `get` and `put` raise."""
        self.get(name)
        await self._records.call(drop_pin, name)
        self._pins.pop(name, None)
        self._changes.bump(Topic.PINS)
