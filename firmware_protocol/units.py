"""Identities and units that cross a border between packages."""

from typing import NewType

NodeId = NewType("NodeId", int)
"""Number of a biobot, unique in its site: 16 bits on the air (WIRE_FORMAT.md §1), any unsigned 64-bit integer in records and files."""

EVERYBODY = NodeId(0xFFFF)
"""The number that no biobot has (WIRE_FORMAT.md §1): a command to it is one to all."""

ShortAddress = NewType("ShortAddress", int)
"""16-bit ZigBee network address of a node, valid until it joins again."""

LAST_NODE_ADDRESS = ShortAddress(0xFFF7)
"""Largest short address of one node; those above are broadcast addresses or reserved (ZigBee specification 05-3474-21, 3.6.5)."""

BROADCAST = ShortAddress(0xFFFF)
"""All nodes (WIRE_FORMAT.md §4.3)."""

BootId = NewType("BootId", int)
"""Counts the starts of a backpack (16 bits on the wire) or names the start of a gateway (wall clock [s] when it began)."""

Nanoseconds = NewType("Nanoseconds", int)
"""An instant or a duration [ns]; which clock an instant belongs to is said by its field's name."""

Milliseconds = NewType("Milliseconds", int)
"""Ticks of a backpack's clock [ms since its boot]."""

RssiDbm = NewType("RssiDbm", int)
"""Received signal strength [dBm]."""

RSSI_UNKNOWN = RssiDbm(127)
"""Stands for a signal strength that was not told [dBm]; no radio hears anything so strong."""

NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000
