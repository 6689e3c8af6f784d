"""What the acceptance check is to do, and how patient it is."""

from dataclasses import dataclass, field

from firmware_protocol.units import NodeId


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How long things are waited for [s], and how often they are tried.

    Parameters
    ----------
    open_s, radio_s, reply_s
        For the dongle to open, for the radio to say what became of a payload, and for a biobot to answer.
    first_payload_s
        For the first biobot to be heard.
    repeat_s
        For a message to be repeated: the second copy comes after 1 s (WIRE_FORMAT.md §5.1), a quarter more with jitter.
    silence_s
        How long a message stays away to count as acknowledged: longer than the wait before a third copy.
    broadcast_s
        For the answers to a broadcast.
    throughput_s
        How long as much is sent as goes.
    n_round_trips
        Time sync requests whose round trip is measured.
    """

    open_s: float = 15.0
    radio_s: float = 10.0
    reply_s: float = 5.0
    first_payload_s: float = 30.0
    repeat_s: float = 5.0
    silence_s: float = 3.0
    broadcast_s: float = 2.0
    throughput_s: float = 3.0
    n_round_trips: int = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What to check.

    Parameters
    ----------
    node
        The biobot to talk to; None: the first that is heard.
    stimulates
        Also start and stop that biobot: a living animal. The command line insists on its number.
    soak_s
        At last, ask for the time for so long without a break; 0: not at all.
    """

    node: NodeId | None = None
    stimulates: bool = False
    soak_s: float = 0.0
    patience: Patience = field(default_factory=Patience)
