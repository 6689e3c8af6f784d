"""The flags that say where insects walk; ``run`` and ``serve`` share them."""

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of scenario and arena."""
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--scenario", metavar="NAME", help="an arena by name (see: biobot-sim scenarios)")
    place.add_argument("--arena", metavar="FILE", help="an arena as .geojson, .svg or black-and-white .png, in the preset's unit of length")
    parser.add_argument("--arena-scale", type=float, metavar="X", help="length of one unit, or pixel, of the arena file (default: 1)")
    parser.add_argument(
        "--arena-then",
        action="append",
        metavar="S:FILE",
        help="the arena is this one from S seconds after the landmarks are set; repeatable",
    )
    parser.add_argument("--arena-simplify", type=float, metavar="X", help="leave out corners; walls move by at most this")
