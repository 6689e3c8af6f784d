"""The flags of how insects move, for every command that makes them walk."""

import argparse

from simulator.motion import WallLaw


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags; all keys of the table ``motion`` can be given in TOML or by variables."""
    laws = [law.value for law in WallLaw]
    parser.add_argument("--wall-law", dest="motion.wall_law", choices=laws, help="what insects do at walls (default: the preset's)")
    parser.add_argument("--persistence", dest="motion.persistence", type=float, metavar="G", help="mean cosine of turns, 0 to 0.999")
    parser.add_argument("--levy", dest="motion.levy_exponent", type=float, metavar="MU", help="power-law legs with this exponent")
    parser.add_argument("--levy-exponent", dest="motion.levy_exponent", type=float, help=argparse.SUPPRESS)  # as messages name it
