"""Parameters of a virtual XBee: what each may be, what runs now, and what is in its memory.

From Digi's user guide 90002002 (XBee/XBee-PRO S2C Zigbee), "AT commands".
"""

from collections.abc import Mapping
from dataclasses import dataclass

from firmware_protocol.dialects.xbee_frames import AT_BAD_COMMAND, AT_BAD_PARAMETER, AT_ERROR, AT_OK

_LONGEST_NAME = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A number that may be set; ``size`` is how many bytes an answer gives it."""

    size: int
    default: int
    least: int = 0
    most: int


PARAMETERS = {
    "AP": Parameter(size=1, default=0, most=2),
    "AO": Parameter(size=1, default=0, most=3),
    "BD": Parameter(size=4, default=3, most=0x3D0900),
    "BH": Parameter(size=1, default=0, most=0x1E),
    "CE": Parameter(size=1, default=0, most=1),
    "CT": Parameter(size=2, default=0x64, least=2, most=0x28F),
    "DH": Parameter(size=4, default=0, most=0xFFFF_FFFF),
    "DL": Parameter(size=4, default=0, most=0xFFFF_FFFF),
    "EE": Parameter(size=1, default=0, most=1),
    "EO": Parameter(size=1, default=0, most=0xFF),
    "GT": Parameter(size=2, default=0x3E8, least=1, most=0xCE4),
    "ID": Parameter(size=8, default=0, most=0xFFFF_FFFF_FFFF_FFFF),
    "JN": Parameter(size=1, default=0, most=1),
    "JV": Parameter(size=1, default=0, most=1),
    "NH": Parameter(size=1, default=0x1E, most=0xFF),
    "NJ": Parameter(size=1, default=0xFF, most=0xFF),
    "NO": Parameter(size=1, default=0, most=3),
    "NT": Parameter(size=2, default=0x3C, least=0x20, most=0xFF),
    "SC": Parameter(size=2, default=0x7FFF, least=1, most=0xFFFF),
    "SD": Parameter(size=1, default=3, most=7),
    "SM": Parameter(size=1, default=0, most=6),
    "SN": Parameter(size=2, default=1, least=1, most=0xFFFF),
    "SP": Parameter(size=2, default=0x20, least=0x20, most=0xAF0),
    "ZS": Parameter(size=1, default=0, most=2),
}
NETWORK = frozenset({"CE", "ID", "SC"})
"""A change of these makes the module leave its network and look for another."""
READ_ONLY = frozenset({"AI", "CH", "DB", "HV", "MY", "NP", "OI", "OP", "SH", "SL", "VR"})


class XBeeSettings:
    """See the module.

    Parameters
    ----------
    memory
        What an earlier owner has written, by command, over what is set at the factory.
    name
        ``NI``.
    """

    def __init__(self, memory: Mapping[str, int], *, name: bytes) -> None:
        self._memory = _factory() | {command: value.to_bytes(PARAMETERS[command].size, "big") for command, value in memory.items()}
        self._memory["NI"] = name
        self._running = dict(self._memory)

    def number(self, command: str) -> int:
        """Return a parameter that runs now."""
        return int.from_bytes(self._running[command], "big")

    def read(self, command: str) -> bytes | None:
        """Return the value of a parameter as an answer gives it, or None where it is none that can be set."""
        return self._running.get(command)

    def change(self, command: str, value: bytes) -> int:
        """Set a parameter; return the status of the answer."""
        if command in READ_ONLY:
            return AT_ERROR
        if command == "NI":
            if not 1 <= len(value) <= _LONGEST_NAME or not all(0x20 <= byte < 0x7F for byte in value):
                return AT_BAD_PARAMETER
            self._running["NI"] = value
            return AT_OK
        parameter = PARAMETERS.get(command)
        if parameter is None:
            return AT_BAD_COMMAND
        number = int.from_bytes(value, "big")
        if not parameter.least <= number <= parameter.most:
            return AT_BAD_PARAMETER
        self._running[command] = number.to_bytes(parameter.size, "big")
        return AT_OK

    def write(self) -> None:
        """Keep what runs now, over a loss of power (``WR``)."""
        self._memory = dict(self._running)

    def reload(self) -> None:
        """Start from memory, as after a reset."""
        self._running = dict(self._memory)

    def restore(self) -> None:
        """Run what is set at the factory (``RE``); memory stays as it is."""
        self._running = _factory()


def _factory() -> dict[str, bytes]:
    values = {command: parameter.default.to_bytes(parameter.size, "big") for command, parameter in PARAMETERS.items()}
    return values | {"NI": b" "}
