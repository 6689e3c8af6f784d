"""What the statuses of a Z-Stack dongle say of a payload, in our words (WIRE_FORMAT.md §9.5)."""

from firmware_protocol.envelope import RadioStatus
from firmware_protocol.znp.numbers import ZnpStatus

_OUTCOMES: dict[int, RadioStatus] = {
    ZnpStatus.SUCCESS: RadioStatus.SENT,
    ZnpStatus.APS_NO_ACK: RadioStatus.NO_ACK,
    ZnpStatus.NWK_NO_ACK: RadioStatus.NO_ACK,
    ZnpStatus.MAC_NO_ACK: RadioStatus.NO_ACK,
    ZnpStatus.MAC_TRANSACTION_EXPIRED: RadioStatus.NO_ACK,
    ZnpStatus.MAC_CHANNEL_ACCESS_FAILURE: RadioStatus.CHANNEL_BUSY,
    ZnpStatus.NWK_NO_ROUTE: RadioStatus.UNKNOWN_ADDRESS,
    ZnpStatus.NWK_UNKNOWN_DEVICE: RadioStatus.UNKNOWN_ADDRESS,
    ZnpStatus.MEMORY_ERROR: RadioStatus.QUEUE_FULL,
    ZnpStatus.BUFFER_FULL: RadioStatus.QUEUE_FULL,
    ZnpStatus.MAC_MEMORY_ERROR: RadioStatus.QUEUE_FULL,
    ZnpStatus.MAC_NO_RESOURCES: RadioStatus.QUEUE_FULL,
    ZnpStatus.APS_TABLE_FULL: RadioStatus.QUEUE_FULL,
    ZnpStatus.NWK_TABLE_FULL: RadioStatus.QUEUE_FULL,
    ZnpStatus.MAC_TRANSACTION_OVERFLOW: RadioStatus.QUEUE_FULL,
    ZnpStatus.MAC_FRAME_TOO_LONG: RadioStatus.TOO_LONG,
}


def radio_status_of(status: int) -> RadioStatus:
    """Return what a status of AF_DATA_REQUEST or AF_DATA_CONFIRM says in our words (WIRE_FORMAT.md §9.5)."""
    return _OUTCOMES.get(status, RadioStatus.OTHER)
