"""Who an XBee says it is, from its answers to the questions of an opening (WIRE_FORMAT.md §8.4, §8.6)."""

from firmware_protocol.dialects.interface import CoordinatorIdentified
from firmware_protocol.dialects.xbee_frames import UNKNOWN16
from firmware_protocol.dialects.xbee_meanings import describe_product
from firmware_protocol.dialects.xbee_opening import Answers
from firmware_protocol.envelope import CoordinatorHello

DEFAULT_LONGEST = 84
"""RF data of a ZigBee unicast without APS security, where the module does not tell by ``NP``."""


def has_short_addresses(answers: Answers) -> bool:
    """Return whether the protocol of a module's network has them: ZigBee does, which ``OI`` tells, and 802.15.4 where ``MY`` is one."""
    return "OI" in answers.values or answers.number("MY", default=UNKNOWN16) < UNKNOWN16


def identify(answers: Answers) -> CoordinatorIdentified:
    """Return who a module says it is."""
    firmware, hardware = answers.number("VR", default=0), answers.number("HV", default=0)
    # OI is the 16-bit PAN id in use; protocols that have none call by ID alone, whose low half is then what is on the air.
    pan_id = answers.number("OI", default=answers.number("ID", default=0) & 0xFFFF)
    hello = CoordinatorHello(
        firmware=firmware & 0xFFFF,
        eui64=answers.number("SH", default=0) << 32 | answers.number("SL", default=0),
        pan_id=pan_id & 0xFFFF,
        channel=answers.number("CH", default=0) & 0xFF,
        max_radio_payload=min(answers.number("NP", default=DEFAULT_LONGEST), 0xFF),
    )
    name = answers.values.get("NI", b"").decode("utf-8", "replace").strip()
    role = "coordinator" if answers.number("CE", default=0) else "router or end device"
    mode = 2 if answers.is_escaped else 1
    kind = describe_product(hardware)
    called = f' "{name}"' if name else ""
    address = "" if answers.number("MY", default=UNKNOWN16) == UNKNOWN16 else f" at 0x{answers.number('MY', default=0):04X}"
    text = f"{kind}{called}, firmware {firmware:X}, hardware {hardware:04X}, {role}{address}, API mode {mode}"
    return CoordinatorIdentified(hello=hello, description=text)
