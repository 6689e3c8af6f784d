"""Which 64-bit address belongs to which short address, as far as an XBee has told (WIRE_FORMAT.md §8.4).

The base station knows nodes by short addresses alone. A module whose protocol has none (DigiMesh) says 0xFFFE instead: such a node is
*allotted* a short address of this table's own, the same one for as long as the table remembers it. Addresses are allotted in turn, so that
one which was forgotten is not another node's soon. The table belongs to a radio, not to an opening of its port.
"""

from firmware_protocol.dialects.xbee_frames import BROADCAST64, COORDINATOR64, UNKNOWN16, UNKNOWN64
from firmware_protocol.envelope import BROADCAST_ADDRESS
from firmware_protocol.units import LAST_NODE_ADDRESS, ShortAddress

CAPACITY = 4096
"""Nodes that are remembered; of more, the one that was heard longest ago is forgotten."""

NOT_DELIVERED16 = 0xFFFD
"""Where a transmit status says that it went when it went nowhere."""

_NO_NODE64 = frozenset({UNKNOWN64, BROADCAST64, COORDINATOR64})

_N_ALLOTTED = 0xFFF0
"""Allotted addresses are 1 to this: 0 is the coordinator, and those from 0xFFF8 on have meanings of their own."""


class AddressTable:
    """See the module.

    Parameters
    ----------
    capacity
        Of short addresses, at least 1.
    first_allotted
        Where allotting begins: anywhere else than in an earlier process, for somebody may remember an address of that.
    """

    def __init__(self, *, capacity: int = CAPACITY, first_allotted: int = 0) -> None:
        self.has_short_addresses = True
        """The network gives its nodes short addresses; where it does not, one that is not known here is nobody's."""
        self._capacity = capacity
        self._eui64_of: dict[int, int] = {}
        """By short address, real or allotted; the one heard longest ago is first."""
        self._real16_of: dict[int, int] = {}
        """The short address that the network gave a node, by its 64-bit one."""
        self._allotted_of: dict[int, int] = {}
        self._next_allotted = first_allotted % _N_ALLOTTED

    def __len__(self) -> int:
        """Return how many short addresses are known."""
        return len(self._eui64_of)

    def learn(self, *, eui64: int, address16: int) -> tuple[ShortAddress, bool]:
        """Take what a frame says of a node; return the short address to call it by, and whether the pair is new."""
        if eui64 in _NO_NODE64:
            return ShortAddress(address16), False
        if address16 > LAST_NODE_ADDRESS:
            known = self._real16_of.get(eui64, self._allotted_of.get(eui64))
            if known is not None:
                self._remember(known, eui64)
                return ShortAddress(known), False
            allotted = self._allot()
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
        if address > LAST_NODE_ADDRESS or not self.has_short_addresses:
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

    def _allot(self) -> int:
        """Return a short address that no known node has; there is one, because there are more of them than the table holds."""
        while self._next_allotted + 1 in self._eui64_of:
            self._next_allotted = (self._next_allotted + 1) % _N_ALLOTTED
        allotted = self._next_allotted + 1
        self._next_allotted = allotted % _N_ALLOTTED
        return allotted
