"""Flags for radios and sensing; each sets the key of its name, and all further keys of RadioKeys are for TOML and the environment."""

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to a command that makes encounters."""
    parser.add_argument("--sensing", choices=("ideal", "beacon"), help="exact encounters, or those that beacons show (default: ideal)")
    parser.add_argument("--beacon-period-s", type=float, metavar="S", help="time between beacons (default: 1)")
    parser.add_argument(
        "--enter-dbm",
        type=float,
        metavar="DBM",
        help="beacons as strong as this open an encounter (default: the median at the detection radius)",
    )
    parser.add_argument(
        "--exit-dbm", type=float, metavar="DBM", help="and those as strong as this keep it (default: the median at 1.15 detection radii)"
    )
    parser.add_argument("--radio", metavar="NAME", help="preset of the radio: ideal, indoor or rubble (default: ideal)")
    parser.add_argument("--csma", action=argparse.BooleanOptionalAction, default=None, help="packets share one channel, wait and collide")
