"""Which 64-bit address belongs to which short address, as far as an XBee has told (WIRE_FORMAT.md §8.4).

The base station knows nodes by short addresses alone. A module whose protocol has none (DigiMesh) says 0xFFFE instead: such a node is
*allotted* a short address of this table's own, the same one each time as long as no other node has it.
"""

from firmware_protocol.dialects.xbee_frames import BROADCAST64, UNKNOWN16, UNKNOWN64
from firmware_protocol.envelope import BROADCAST_ADDRESS
from firmware_protocol.units import ShortAddress

CAPACITY = 4096
"""Nodes that are remembered; of more, the one that was heard longest ago is forgotten."""

NOT_DELIVERED16 = 0xFFFD
"""Where a transmit status says that it went when it went nowhere."""

_N_ALLOTTED = 0xFFF0
"""Allotted addresses are 1 to this: 0 is the coordinator, and those from 0xFFF8 on have meanings of their own."""


class AddressTable:
    """See the module.

    Parameters
    ----------
    capacity
        Of short addresses, at least 1.
    """

    def __init__(self, *, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._eui64_of: dict[int, int] = {}
        """By short address, real or allotted; the one heard longest ago is first."""
        self._real16_of: dict[int, int] = {}
        """The short address that the network gave a node, by its 64-bit one."""
        self._allotted_of: dict[int, int] = {}
        self._has_allotted = False

    def __len__(self) -> int:
        """Return how many short addresses are known."""
        return len(self._eui64_of)

    def learn(self, *, eui64: int, address16: int) -> tuple[ShortAddress, bool]:
        """Take what a frame says of a node; return the short address to call it by, and whether the pair is new."""
        if eui64 == UNKNOWN64:
            return ShortAddress(address16), False
        if address16 in {UNKNOWN16, NOT_DELIVERED16}:
            known = self._real16_of.get(eui64, self._allotted_of.get(eui64))
            if known is not None:
                self._remember(known, eui64)
                return ShortAddress(known), False
            allotted = self._allot(eui64)
            self._remember(allotted, eui64)
            self._allotted_of[eui64] = allotted
            return ShortAddress(allotted), True
        is_news = self._eui64_of.get(address16) != eui64 or self._real16_of.get(eui64) != address16
        self._remember(address16, eui64)
        self._real16_of[eui64] = address16
        return ShortAddress(address16), is_news

    def destination(self, address: ShortAddress) -> tuple[int, int] | None:
        """Return the 64-bit and 16-bit destination for a short address; None: it is not known, and no network address either."""
        if address == BROADCAST_ADDRESS:
            return BROADCAST64, UNKNOWN16
        eui64 = self._eui64_of.get(address)
        if eui64 is not None:
            return eui64, self._real16_of.get(eui64, UNKNOWN16)
        if address == UNKNOWN16 or self._has_allotted:
            return None
        return UNKNOWN64, address

    def _remember(self, address: int, eui64: int) -> None:
        before = self._eui64_of.pop(address, None)
        if before is not None and before != eui64:
            self._unlink(address, before)
        self._eui64_of[address] = eui64
        while len(self._eui64_of) > self._capacity:
            oldest = next(iter(self._eui64_of))
            self._unlink(oldest, self._eui64_of.pop(oldest))

    def _unlink(self, address: int, eui64: int) -> None:
        for table in (self._real16_of, self._allotted_of):
            if table.get(eui64) == address:
                del table[eui64]

    def _allot(self, eui64: int) -> int:
        """Return a short address that no known node has; there is one, because there are more of them than the table holds."""
        self._has_allotted = True
        candidate = ((eui64 ^ eui64 >> 16 ^ eui64 >> 32 ^ eui64 >> 48) & 0xFFFF) % _N_ALLOTTED
        while candidate + 1 in self._eui64_of:
            candidate = (candidate + 1) % _N_ALLOTTED
        return candidate + 1
