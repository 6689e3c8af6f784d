"""What passes between a radio and the rest of the gateway, whatever its dialect."""

from dataclasses import dataclass
from enum import Enum

from msgspec import Struct

from firmware_protocol.envelope import RadioStatus
from firmware_protocol.units import RSSI_UNKNOWN, RssiDbm, ShortAddress


class RadioMessage(Struct, frozen=True, kw_only=True, gc=False):
    """A radio payload and the circumstances of its arrival."""

    radio: str
    source: ShortAddress
    rssi_dbm: RssiDbm
    lqi: int
    payload: bytes
    received_ns: int


def strongest(*strengths: RssiDbm) -> RssiDbm:
    """Return the strongest of some signals; one that is not known is none, unless all are."""
    return max(strengths, key=lambda rssi_dbm: (rssi_dbm != RSSI_UNKNOWN, rssi_dbm))


class Fate(Enum):
    """What became of a payload that was sent down."""

    SENT = "sent"
    NO_ACK = "no_ack"
    """Sent, but the biobot's radio did not acknowledge; it may have heard it."""
    NOT_SENT = "not_sent"
    """The dongle says that it did not go out."""
    UNKNOWN = "unknown"
    """The link or the dongle did not tell."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioOutcome:
    """Fate of a payload, and the reason where there is one."""

    fate: Fate
    reason: str = ""


def outcome_of(status: int) -> RadioOutcome:
    """Return what a RadioConfirm says; an unknown status says nothing.

    A busy channel is no proof that nothing went out: it may have been met by a repetition, after a copy whose acknowledgement was lost.
    """
    try:
        known = RadioStatus(status)
    except ValueError:
        return RadioOutcome(fate=Fate.UNKNOWN, reason=f"unknown radio status {status}")
    if known is RadioStatus.SENT:
        return RadioOutcome(fate=Fate.SENT)
    if known is RadioStatus.NO_ACK:
        return RadioOutcome(fate=Fate.NO_ACK, reason="no acknowledgement from the biobot's radio")
    if known is RadioStatus.CHANNEL_BUSY:
        return RadioOutcome(fate=Fate.UNKNOWN, reason="the channel was busy; an earlier copy may have gone out")
    if known is RadioStatus.OTHER:
        return RadioOutcome(fate=Fate.UNKNOWN, reason="the radio reports an unnamed fault")
    return RadioOutcome(fate=Fate.NOT_SENT, reason=known.name.lower())
