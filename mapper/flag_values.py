"""What is typed after the flags of the command line, as values; what is unfit becomes a sentence that argparse tells."""

import argparse
import re
from collections.abc import Sequence

MAX_CLASSES = 16
"""As `mapper.routes` has it, which takes numpy to import."""

_MAX_ID = 2**63 - 1
_MAX_SHIFT_S = 4e9  # as times of the files
_NEGATIVE = re.compile(r"-([0-9]+\.?[0-9]*|\.[0-9]+)[eE][+-]?[0-9]+|-(inf|infinity|nan)", re.ASCII | re.IGNORECASE)


def read_number_of_classes(text: str) -> int:
    """Read how many kinds of routes are wanted."""
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= MAX_CLASSES):
        raise argparse.ArgumentTypeError(f"{text!r}; wanted a whole number from 1 to {MAX_CLASSES}")
    return int(text)


def read_id_list(text: str) -> tuple[int, ...]:
    """Read ids of biobots, comma-separated."""
    parts = [part.strip() for part in text.split(",")]
    wrong = [part for part in parts if not (part.isascii() and part.isdigit() and len(part) <= len(str(_MAX_ID)) and int(part) <= _MAX_ID)]
    if wrong:
        raise argparse.ArgumentTypeError(f"{wrong[0]!r} is no id; wanted whole numbers from 0 to 2^63-1, as 3,17,20")
    return tuple(int(part) for part in parts)


def read_seconds(text: str) -> tuple[float, ...]:
    """Read seconds, comma-separated."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if not found or not all(abs(one) <= _MAX_SHIFT_S for one in found):
        raise argparse.ArgumentTypeError(f"{text!r}; wanted seconds for each input, at most {_MAX_SHIFT_S:g} either way, as 0,-12.5")
    return found


def join_negative_numbers(given: Sequence[str]) -> list[str]:
    """Write ``--flag -1e2`` as ``--flag=-1e2``: argparse takes a negative number with an exponent for a flag of its own."""
    joined: list[str] = []
    for part in given:
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and _NEGATIVE.fullmatch(part):
            joined[-1] += f"={part}"
        else:
            joined.append(part)
    return joined
