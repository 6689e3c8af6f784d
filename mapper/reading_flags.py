"""Flags that say how a log is to be read, and who stands still in it. Nothing here waits for numpy."""

import argparse
from math import isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapper.reading import ReadingOptions, Role

_NS_PER_S = 1e9
_MAX_GAP_S = 1e9
_MAX_ID = 2**63 - 1
_UNITS = ("s", "ms", "us", "ns", "min", "h", "d")


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags; what is wrong with one is bad usage."""
    about = "say columns t_start, t_end or t, duration; id1, id2"
    parser.add_argument("--columns", type=_columns, metavar="ROLE=NAME", help=about)
    parser.add_argument("--time-unit", choices=_UNITS, metavar="U", help="of numbers: s (default), ms, us, ns, min, h, d")
    parser.add_argument("--gap-s", type=_gap, metavar="S", help="sightings of a pair within S are one contact")
    parser.add_argument("--stationary", type=_ids, metavar="ID,ID", help="nodes that stood still all the time; or @FILE")
    about = "find these (default: if nothing tells who they are)"
    parser.add_argument("--find-stationary", action=argparse.BooleanOptionalAction, help=about)


def reading_options(args: argparse.Namespace) -> "ReadingOptions":
    """Return what the flags say of the file."""
    from mapper.reading import ReadingOptions, TimeUnit  # noqa: PLC0415  # numpy: not for --help

    return ReadingOptions(
        columns=args.columns or {},
        time_unit=None if args.time_unit is None else TimeUnit(args.time_unit),
        gap_ns=None if args.gap_s is None else round(args.gap_s * _NS_PER_S),
    )


def _columns(text: str) -> "dict[Role, str]":
    from mapper.reading import parse_columns  # noqa: PLC0415  # see reading_options

    try:
        return parse_columns(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _gap(text: str) -> float:
    try:
        gap_s = float(text)
    except ValueError:
        gap_s = -1.0
    if not (isfinite(gap_s) and 0 <= gap_s <= _MAX_GAP_S):
        raise argparse.ArgumentTypeError(f"{text!r} is no gap; wanted seconds from 0 to {_MAX_GAP_S:g}, as 60")
    return gap_s


def _ids(text: str) -> tuple[str, ...]:
    parts = tuple(part.strip() for part in text.split(","))
    if "" in parts:
        raise argparse.ArgumentTypeError(f"an id in {text!r} is empty; wanted ids parted by commas, as 3,17,north-door, or @FILE")
    for part in parts:
        if part.isascii() and part.isdigit() and int(part[:40]) > _MAX_ID:
            raise argparse.ArgumentTypeError(f"{part!r} is no id; wanted whole numbers up to 2^63-1, or names")
    return parts
