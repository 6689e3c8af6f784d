"""What a probe found at a port, and what to do about it."""

from dataclasses import dataclass, field
from enum import Enum


class Verdict(Enum):
    """Whether the port can be used."""

    ANSWERS = "answers"
    BOOT_LOADER = "boot_loader"
    """A dongle is there, but its firmware does not run."""
    UNSUPPORTED = "unsupported"
    """A dongle is there that speaks what the gateway does not."""
    SILENT = "silent"
    NOT_OPENED = "not_opened"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What was found at one port.

    Parameters
    ----------
    port
        As it was named.
    spec
        What to give to ``--port``; empty where there is nothing to use.
    firmware
        In the dongle's words, as far as it told.
    facts
        What else it told: PAN, channel, addresses.
    advice
        What to do next, where something is to be done.
    """

    port: str
    verdict: Verdict
    family: str = ""
    baud: int | None = None
    firmware: str = ""
    facts: dict[str, str] = field(default_factory=dict)
    spec: str = ""
    advice: str = ""


CC253X_STUCK = (
    "it stays in its serial boot loader, though it was told to start its firmware: unplug it and plug it in again; if it comes back to "
    "this it has no firmware: flash Z-Stack ZNP firmware"
)
CC26X2_STUCK = (
    "it waits in the boot loader of its ROM: unplug it and plug it in again without pressing its button; --intrusive restarts it from "
    "here. If it comes back to this it has no firmware: flash Z-Stack 3 coordinator firmware"
)
MENU_STUCK = (
    "it shows a boot loader's menu: choose `run` there (often key 2) with a terminal program, or load firmware, to an XBee with Digi's XCTU"
)
EZSP_UNSUPPORTED = (
    "it speaks EZSP (Silicon Labs, as Sonoff Dongle-E and Home Assistant ZBT dongles do), which this gateway does not: use a CC2652 or "
    "CC2531 dongle with Z-Stack, an XBee in API mode, or a dongle with native firmware"
)
XBEE_TRANSPARENT = (
    "an XBee in transparent mode, as it comes from the factory: this gateway's xbee dialect switches it to API mode when it opens it; "
    "for good, set AP to 2 and write it with WR"
)
ECHO = "it sends back what it is sent: a loop-back plug, a modem in command mode, or an adapter with nothing at its other end"
NOBODY = (
    "nothing answered at any speed: is it plugged in and powered, is it a coordinator, does another cable work? "
    "--intrusive also tries reset lines and the command mode of an XBee"
)
NOT_TOLD = "another kind of device that talks, or a dongle that is busy or whose line is bad; ask again, with baud= if its speed is known"
NOT_EXPLAINED = "another kind of device, or another speed"
PERHAPS_TRANSPARENT = (
    "; or an XBee in transparent mode, as it comes from the factory, that passes on what it hears: "
    "probe --intrusive looks for its command mode"
)
CAN_ADAPTER = (
    "a CAN adapter that speaks ASCII (slcan, as CANable, CANtact and CANUSB do); put in the bit rate of your bus and the coordinator's "
    "unit number, then `probe` that port to ask the coordinator"
)
