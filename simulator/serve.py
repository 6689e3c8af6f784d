"""``biobot-sim serve``: its flags, and what becomes of a run's results."""

import argparse
import asyncio
import contextlib
import sys
from pathlib import Path

from simulator import radio_flags
from simulator.clock import WallClock
from simulator.config_sources import load_config
from simulator.errors import ParameterError
from simulator.line import EXAMPLES, parse_line
from simulator.log import EventLog, set_up_logging
from simulator.output import OutputDirectory
from simulator.presets import find_preset
from simulator.radio import choose_radio
from simulator.scenarios import find_scenario
from simulator.serve_config import ServeConfig
from simulator.service import Service
from simulator.setting import choose_setting

log = EventLog(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``serve``."""
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--scenario", metavar="NAME", help="an arena by name (see: biobot-sim scenarios)")
    place.add_argument("--arena", metavar="FILE.geojson", help="a Polygon or MultiPolygon in the preset's unit of length")
    parser.add_argument(
        "--link", metavar="SPEC", help="what the gateway opens: pty:PATH, tcp:HOST:PORT or serial:DEVICE, each with ?baud=N"
    )
    parser.add_argument("--preset", metavar="NAME", help="parameters of insects and radios (default: paper-units)")
    parser.add_argument("--biobots", type=int, metavar="N", help="how many insects (default: the preset's)")
    parser.add_argument("--seed", type=int, metavar="N", help="same seed, same insects")
    parser.add_argument("--duration", dest="duration_s", type=float, metavar="S", help="end after this many seconds (default: on a signal)")
    parser.add_argument(
        "--speed",
        "--speed-factor",
        dest="speed_factor",
        type=float,
        metavar="X",
        help="insects are X times faster than life; all else keeps real time",
    )
    parser.add_argument("--drain-s", type=float, metavar="S", help="wait this long for the last acknowledgements (default: 3)")
    parser.add_argument("--loss", type=float, metavar="P", help="probability that a radio payload is lost (default: 0)")
    parser.add_argument("--report-period-s", type=float, metavar="S", help="an encounter waits this long for company (default: 1)")
    parser.add_argument("--neighbours-period-s", type=float, metavar="S", help="how often neighbours are told (default: 5)")
    radio_flags.add_arguments(parser)
    parser.add_argument("--boot", type=int, metavar="N", help="count of starts the backpacks tell (default: from the wall clock)")
    parser.add_argument("--out", metavar="DIR", help="directory for truth, reports and run.json; made if missing")
    parser.add_argument("--force", action="store_true", default=None, help="write into a directory that is not empty")
    parser.add_argument("--ready-file", metavar="FILE", help="holds the line's address while it is up")


def main(args: argparse.Namespace) -> int:
    """Serve until the end; return the exit status.

    Raises
    ------
    ConfigurationError, SimulationError
        The configuration is faulty, or line or output cannot be had.
    """
    config = load_config(ServeConfig, args)
    if args.check_config:
        find_preset(config.preset)
        choose_radio(config, loss=config.loss)
        if config.scenario is not None:
            find_scenario(config.scenario)
        sys.stdout.write(f"{args.config or 'defaults and environment'}: the configuration is valid\n")
        return 0
    setting = choose_setting(config)
    if config.link is None:
        raise ParameterError(name="link", got=None, wanted=f"the line that the gateway opens: {EXAMPLES}")
    set_up_logging()
    with contextlib.ExitStack() as stack:
        output = stack.enter_context(OutputDirectory(Path(config.out), force=config.force)) if config.out is not None else None
        service = Service(config, setting, line=parse_line(config.link), clock=WallClock())
        asyncio.run(service.run())
        if output is not None:
            output.commit(service.files())
            log.info("serve.written", out=config.out)
    return 0
