"""What the numbers in XBee frames mean: delivery, association, events and products (WIRE_FORMAT.md §8.3).

From Digi's user guides 90002002 (S2C Zigbee), 90001539 (XBee 3 Zigbee) and 90002277 (DigiMesh): "Transmit Status", "Modem Status", "AI",
"HV". A number of a newer firmware is not in a table and has no meaning here.
"""

from typing import NamedTuple

from firmware_protocol.envelope import RadioStatus


class Delivery(NamedTuple):
    """What a delivery status says of a payload."""

    outcome: RadioStatus
    text: str


DELIVERY = {
    0x00: Delivery(RadioStatus.SENT, "delivered"),
    0x01: Delivery(RadioStatus.NO_ACK, "the next hop did not acknowledge"),
    0x02: Delivery(RadioStatus.CHANNEL_BUSY, "the channel was never clear"),
    0x03: Delivery(RadioStatus.NO_ACK, "a sleeping node never asked for it, or the module found no spectrum"),
    0x15: Delivery(RadioStatus.UNKNOWN_ADDRESS, "no such endpoint"),
    0x18: Delivery(RadioStatus.QUEUE_FULL, "the module has no free buffer"),
    0x21: Delivery(RadioStatus.NO_ACK, "the node did not acknowledge"),
    0x22: Delivery(RadioStatus.UNKNOWN_ADDRESS, "the module is in no network"),
    0x23: Delivery(RadioStatus.UNKNOWN_ADDRESS, "the address is the module's own"),
    0x24: Delivery(RadioStatus.UNKNOWN_ADDRESS, "the address is not known in the network"),
    0x25: Delivery(RadioStatus.UNKNOWN_ADDRESS, "no route to the node"),
    0x26: Delivery(RadioStatus.NO_ACK, "no neighbour was heard passing the broadcast on"),
    0x2B: Delivery(RadioStatus.UNKNOWN_ADDRESS, "no such entry in the binding table"),
    0x2C: Delivery(RadioStatus.QUEUE_FULL, "the module has no free buffer or timer"),
    0x2D: Delivery(RadioStatus.OTHER, "a broadcast was to be encrypted end to end"),
    0x2E: Delivery(RadioStatus.OTHER, "end-to-end encryption was asked for, but EE = 0"),
    0x31: Delivery(RadioStatus.OTHER, "an internal error of the module"),
    0x32: Delivery(RadioStatus.QUEUE_FULL, "the module has no free buffer or timer"),
    0x34: Delivery(RadioStatus.OTHER, "there is no secure session"),
    0x35: Delivery(RadioStatus.OTHER, "encryption failed"),
    0x74: Delivery(RadioStatus.TOO_LONG, "the payload is longer than the network carries"),
    0x75: Delivery(RadioStatus.NO_ACK, "a sleeping node never asked for it"),
    0xBB: Delivery(RadioStatus.OTHER, "the key is not authorised"),
}
"""Delivery status of 0x8B frames. Where it is not certain that nothing went out, the outcome is one that does not claim so."""

OUTCOME = {
    RadioStatus.SENT: 0x00,
    RadioStatus.NO_ACK: 0x21,
    RadioStatus.CHANNEL_BUSY: 0x02,
    RadioStatus.UNKNOWN_ADDRESS: 0x24,
    RadioStatus.QUEUE_FULL: 0x32,
    RadioStatus.TOO_LONG: 0x74,
    RadioStatus.OTHER: 0x31,
}
"""The other way round: the delivery status that a module would give."""

NO_NETWORK = 0x22

OF_MODULE = frozenset({NO_NETWORK, 0x2D, 0x2E, 0x31, 0x34, 0x35, 0x74, 0xBB})
"""Delivery statuses that tell of the module or its settings, rather than of one biobot."""

ASSOCIATION = {
    0x00: "in a network",
    0x03: "the coordinator that was found does not let nodes join",
    0x04: "the coordinator that was found uses beacons, which the module cannot",
    0x05: "the network that was found has another PAN id",
    0x06: "the network that was found is on another channel",
    0x0C: "the coordinator did not answer the request to join",
    0x13: "the module has left its network",
    0x21: "no network was found on the channels of SC",
    0x22: "no network was found that fits SC and ID",
    0x23: "a network was found, but it does not let nodes join",
    0x24: "no network lets nodes join",
    0x25: "the module should not try to join now",
    0x27: "joining failed, most often because the security settings differ",
    0x2A: "the coordinator could not start a network",
    0x2B: "looking for a coordinator that exists already",
    0x2C: "leaving the network failed",
    0xAB: "the node asked to join did not answer",
    0xAC: "secure joining failed: the network key came unprotected",
    0xAD: "secure joining failed: no network key came",
    0xAF: "secure joining failed: the link key is a wrong one",
    0xFF: "looking for a network, or starting one",
}
"""Values of ``AI``."""

ASSOCIATED = 0x00

HARDWARE_RESET = 0x00
WATCHDOG_RESET = 0x01
COORDINATOR_STARTED = 0x06
RESTARTS = frozenset({HARDWARE_RESET, WATCHDOG_RESET, COORDINATOR_STARTED})
"""Events after which the module must be opened again."""
MAY_HAVE_NO_NETWORK = frozenset({0x03, 0x3F, 0x40})
"""Events after which it is to be asked at once whether it has its network."""


class Happening(NamedTuple):
    """What an event of the module is for a log; levels as in ``CoordinatorSaid``."""

    level: int
    text: str


EVENTS = {
    HARDWARE_RESET: Happening(2, "the module was reset"),
    WATCHDOG_RESET: Happening(2, "the module's watchdog reset it"),
    0x02: Happening(1, "the module has joined a network"),
    0x03: Happening(2, "the module has left its network"),
    0x04: Happening(2, "a configuration error, or synchronisation was lost"),
    0x05: Happening(2, "the coordinator was realigned"),
    COORDINATOR_STARTED: Happening(1, "the coordinator has started a network"),
    0x07: Happening(1, "the network key has changed"),
    0x0B: Happening(0, "the network woke up"),
    0x0C: Happening(0, "the network went to sleep"),
    0x0D: Happening(3, "the supply voltage is too high; the module will not transmit"),
    0x11: Happening(2, "the settings were changed while joining"),
    0x32: Happening(1, "a Bluetooth client has connected"),
    0x33: Happening(1, "a Bluetooth client has disconnected"),
    0x3B: Happening(1, "a secure session has begun"),
    0x3C: Happening(1, "a secure session has ended"),
    0x3D: Happening(2, "a secure session was refused"),
    0x3E: Happening(2, "another network has the same PAN id, and CR = 0 leaves it so"),
    0x3F: Happening(2, "the coordinator has changed its PAN id because of a conflict"),
    0x40: Happening(2, "the coordinator has changed this router's PAN id because of a conflict"),
    0x42: Happening(2, "the network watchdog has expired three times"),
    0x43: Happening(1, "nodes may join now"),
    0x44: Happening(1, "nodes may no longer join"),
    0x45: Happening(1, "a change of the network key has begun"),
    0x80: Happening(2, "an error of the radio stack"),
}
"""Modem status of 0x8A frames."""

PRODUCTS = {
    0x17: "XBee 802.15.4 (S1)",
    0x18: "XBee-PRO 802.15.4 (S1)",
    0x19: "XBee ZB (S2)",
    0x1A: "XBee-PRO ZB (S2)",
    0x1E: "XBee-PRO ZB (S2B)",
    0x21: "XBee-PRO S2C",
    0x22: "XBee S2C",
    0x2D: "XBee-PRO S2C",
    0x2E: "XBee S2C",
    0x30: "XBee-PRO S2C",
    0x32: "XBee-PRO S2D",
    0x33: "XBee S2D",
    0x34: "XBee-PRO S2D",
    0x35: "XBee S2D",
    0x41: "XBee 3",
    0x42: "XBee 3",
    0x43: "XBee 3",
}
"""First byte of ``HV``."""


def describe_association(value: int) -> str:
    """Return what a value of ``AI`` means."""
    return ASSOCIATION.get(value, f"association state 0x{value:02x}, which is not known here")


def describe_product(hardware: int) -> str:
    """Return the product that a value of ``HV`` names."""
    return PRODUCTS.get(hardware >> 8, f"XBee of hardware 0x{hardware:04x}")
