"""Numbers of a Z-Stack network processor: commands, status bytes, states, items of its memory (WIRE_FORMAT.md §9.2).

As TI's "Z-Stack Monitor and Test API" (SWRA198, revision 1.14) and "Z-Stack API" (SWRA195) give them; those that matter here.
"""

from enum import IntEnum


class Command(IntEnum):
    """Requests of the base station, ``cmd0 << 8 | cmd1``; an answer has bit 14 set as well (``ANSWER``)."""

    SYS_RESET_REQ = 0x4100
    SYS_PING = 0x2101
    SYS_VERSION = 0x2102
    SYS_GET_EXTADDR = 0x2104
    SYS_OSAL_NV_ITEM_INIT = 0x2107
    SYS_OSAL_NV_READ = 0x2108
    SYS_OSAL_NV_WRITE = 0x2109
    SYS_OSAL_NV_DELETE = 0x2112
    SYS_OSAL_NV_LENGTH = 0x2113
    SYS_NV_LENGTH = 0x2132
    SYS_NV_READ = 0x2133
    AF_REGISTER = 0x2400
    AF_DATA_REQUEST = 0x2401
    ZDO_MGMT_PERMIT_JOIN_REQ = 0x2536
    ZDO_STARTUP_FROM_APP = 0x2540
    ZDO_EXT_NWK_INFO = 0x2550
    UTIL_GET_DEVICE_INFO = 0x2700
    UTIL_ASSOC_FIND_DEVICE = 0x2749
    APP_CNF_BDB_START_COMMISSIONING = 0x2F05
    APP_CNF_BDB_SET_CHANNEL = 0x2F08
    APP_CNF_BDB_SET_TC_REQUIRE_KEY_EXCHANGE = 0x2F09


ANSWER = 0x4000
"""What makes an answer's command of its request's."""


class ZnpStatus(IntEnum):
    """Status bytes that Z-Stack gives, of those that matter here (Z-Stack API, "ZStatus_t")."""

    SUCCESS = 0x00
    FAILURE = 0x01
    INVALID_PARAMETER = 0x02
    NV_ITEM_UNINITIALIZED = 0x09
    NV_OPERATION_FAILED = 0x0A
    MEMORY_ERROR = 0x10
    BUFFER_FULL = 0x11
    MAC_MEMORY_ERROR = 0x13
    MAC_NO_RESOURCES = 0x1A
    APS_FAIL = 0xB1
    APS_TABLE_FULL = 0xB2
    APS_NO_ACK = 0xB7
    APS_DUPLICATE_ENTRY = 0xB8
    NWK_INVALID_REQUEST = 0xC2
    NWK_TABLE_FULL = 0xC7
    NWK_UNKNOWN_DEVICE = 0xC8
    NWK_NO_ACK = 0xCC
    NWK_NO_ROUTE = 0xCD
    MAC_CHANNEL_ACCESS_FAILURE = 0xE1
    MAC_FRAME_TOO_LONG = 0xE5
    MAC_NO_ACK = 0xE9
    MAC_TRANSACTION_EXPIRED = 0xF0
    MAC_TRANSACTION_OVERFLOW = 0xF1


class DeviceState(IntEnum):
    """States of the device that matter here; anything else is a device that is no coordinator or has no network."""

    HOLD = 0x00
    COORDINATOR_STARTING = 0x08
    COORDINATOR = 0x09


class NvItem(IntEnum):
    """Items of the non-volatile memory (Z-Stack ``ZComDef.h``)."""

    EXTADDR = 0x0001
    STARTUP_OPTION = 0x0003
    NIB = 0x0021
    BDB_IS_ON_NETWORK = 0x0055
    PANID = 0x0083
    CHANLIST = 0x0084
    LOGICAL_TYPE = 0x0087
    ZDO_DIRECT_CB = 0x008F
    HOST_CONFIGURED = 0x0F00
    """Of the application's own range; hosts of Z-Stack 1.2 by custom write ``HOST_CONFIGURED_VALUE`` here once a network is formed."""


HOST_CONFIGURED_VALUE = 0x55
CLEAR_CONFIG = 0x01
CLEAR_STATE = 0x02
"""Bits of ``STARTUP_OPTION``: the next start writes the stack's items anew; it forgets the network."""

COORDINATOR_TYPE = 0
"""Value of ``LOGICAL_TYPE``."""

BDB_FORMATION = 0x04
"""Commissioning mode of ``APP_CNF_BDB_START_COMMISSIONING``: form a network."""

# --- ours: where biobots meet their base station (WIRE_FORMAT.md §9.3) ---

BIOBOT_ENDPOINT = 0xB1
"""Of the base station and of every backpack; endpoints of applications are 1 to 240."""
BIOBOT_PROFILE = 0xCB10
"""Out of 0xC000 to 0xFFFF, which ZigBee leaves to makers' own profiles."""
BIOBOT_CLUSTER = 0x0001
"""Its messages are the radio payloads of WIRE_FORMAT.md §5 and §6, as they are."""
