"""What is told of a stop that nobody answered: how often it was really sent, and why no more often. Pure."""

from collections.abc import Sequence

from firmware_protocol.units import NodeId

_NAMED = 10
_LOOK = "look at the animal"


def no_answer(*, n_sent: int, n_broadcasts: int = 0, why_unsent: str = "") -> str:
    """Return the reason of a stop of one biobot that has no answer.

    Parameters
    ----------
    n_sent
        Frames to this biobot alone that were given to radios.
    n_broadcasts
        Frames to everybody that were.
    why_unsent
        Why a radio took none, the last time that it was to; empty: all took theirs.
    """
    frames = [_count(n_sent, "stop"), _count(n_broadcasts, "broadcast")]
    told = " and ".join(one for one in frames if one)
    missing = f"; {why_unsent}" if why_unsent else ""
    return f"no answer to {told}{missing}; {_LOOK}" if told else f"nothing could be sent{missing}; {_LOOK}"


def name_some(nodes: Sequence[NodeId]) -> str:
    """Return the numbers of the first ten, and how many more there are."""
    more = f" and {len(nodes) - _NAMED} more" if len(nodes) > _NAMED else ""
    return ", ".join(map(str, nodes[:_NAMED])) + more


def _count(number: int, what: str) -> str:
    return "" if not number else f"{number} {what}" if number == 1 else f"{number} {what}s"
