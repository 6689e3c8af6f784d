"""What the bytes on a line to a dongle say, seen from beside it: frame by frame, in both directions, in every dialect.

Unlike a ``Host``, which takes part, this only looks: it knows no session and forgets nothing of use, so that bytes give the same result
whether they are heard live, read from a file, or begin in the middle.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from firmware_protocol.framing.interface import FrameDecoder, FrameFault
from firmware_protocol.message_codec import decode_downlink, decode_uplink
from firmware_protocol.messages import Downlink, MessageFault, Uplink, UplinkHeader
from firmware_protocol.units import RssiDbm, ShortAddress

Fields = Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioPayload:
    """What a frame carries from or to the air.

    Parameters
    ----------
    address
        Of the node: the source of what came in, the destination of what goes out.
    rssi_dbm, lqi
        How it was heard; None where the dialect does not tell, and of what goes out.
    """

    address: ShortAddress
    data: bytes
    rssi_dbm: RssiDbm | None = None
    lqi: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkFacts:
    """What a frame tells of the dongle's network; None where it does not."""

    pan_id: int | None = None
    channel: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Dissection:
    """A frame, or what was found instead of one.

    Parameters
    ----------
    name
        What its dialect calls it: ``DATA``, ``receive packet``, ``AF_INCOMING_MSG``.
    fields
        What else it says, by name.
    fault
        Why it is no frame, or a frame of no use; empty where all is well.
    """

    is_outgoing: bool
    name: str
    fields: Fields = field(default_factory=dict)
    payload: RadioPayload | None = None
    network: NetworkFacts | None = None
    fault: str = ""


class FrameCutter(Protocol):
    """Cuts one direction of a CAN line into its frames, for captures."""

    def feed(self, chunk: bytes) -> list[tuple[bytes, str]]:
        """Take the next bytes; return each frame in the form of LINKTYPE_CAN_SOCKETCAN, or nothing, and its fault where it has one."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """How a dialect's line is looked at.

    Parameters
    ----------
    make_decoder
        Makes the framing's decoder for one direction.
    dissect
        Says what a frame body means, and given True, one to the dongle; never raises.
    delimiter
        The byte that ends every frame, and stands nowhere else; None where there is none.
    text
        What a whole write to the dongle looks like that is text and no frame; None: there is none.
    make_cutter
        Makes what cuts one direction into CAN frames; None where the line is no CAN bus.
    """

    make_decoder: Callable[[], FrameDecoder]
    dissect: Callable[[bytes, bool], Dissection]
    delimiter: bytes | None = None
    text: re.Pattern[bytes] | None = None
    make_cutter: Callable[[], FrameCutter] | None = None


@dataclass(slots=True)
class LineDissector:
    """Both directions of one line; bytes may be cut anywhere."""

    dialect: Dialect
    _decoders: dict[bool, FrameDecoder] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget half a frame: the port was opened."""
        self._decoders = {is_outgoing: self.dialect.make_decoder() for is_outgoing in (False, True)}

    def pieces(self, chunk: bytes) -> list[bytes]:
        """Cut a chunk so that no piece goes on behind the end of a frame: fed one by one, they show which bytes each frame had."""
        if self.dialect.delimiter is None:
            return [chunk[at : at + 1] for at in range(len(chunk))]
        *ended, rest = chunk.split(self.dialect.delimiter)
        return [one + self.dialect.delimiter for one in ended] + ([rest] if rest else [])

    def feed(self, chunk: bytes, *, is_outgoing: bool) -> list[Dissection]:
        """Take the next bytes of a direction; return the frames and faults that they complete."""
        if is_outgoing and self.dialect.text is not None and self.dialect.text.fullmatch(chunk):
            return [Dissection(is_outgoing=True, name="text", fields={"says": chunk.decode("latin-1").rstrip("\r")})]
        return [
            Dissection(is_outgoing=is_outgoing, name="fault", fault=f"frame.{body.value}")
            if isinstance(body, FrameFault)
            else self.dialect.dissect(body, is_outgoing)
            for body in self._decoders[is_outgoing].feed(chunk)
        ]


Message = tuple[UplinkHeader | int, Uplink | Downlink]
"""A header, or a downlink's sequence number, and what follows it."""


def decode_payload(payload: RadioPayload, *, is_outgoing: bool) -> Message | MessageFault:
    """Return the message in a radio payload, or why it is none."""
    return decode_downlink(payload.data) if is_outgoing else decode_uplink(payload.data)
