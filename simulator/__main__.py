"""Command line of the simulator: ``run`` writes a run's files, ``serve`` and ``replay`` stand in for dongles, ``render`` draws."""

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.nearest_word import CommandParser
from simulator import motion_flags
from simulator.arenas import arena_flags
from simulator.config import RunConfig
from simulator.config_sources import load_config
from simulator.errors import InterruptedRunError, ParameterError, ScenarioError, SimulationError
from simulator.log import set_up_logging
from simulator.radios import radio_flags

_EXIT_FAILED, _EXIT_USAGE, _EXIT_INTERRUPTED = 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit status is 0 done, 1 failed, 2 bad usage or configuration."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = _make_parser(given)
    args = parser.parse_args(given)
    try:
        status = _dispatch(args, parser)
        sys.stdout.flush()
    except ConfigurationError as error:
        return _complain(error.problems, status=_EXIT_USAGE)
    except (ScenarioError, ParameterError) as error:
        return _complain([str(error)], status=_EXIT_USAGE)
    except InterruptedRunError as error:
        return _complain([str(error)], status=_EXIT_INTERRUPTED)
    except SimulationError as error:
        return _complain([str(error)], status=_EXIT_FAILED)
    except BrokenPipeError:
        # Whoever read our output is gone; keep the interpreter from complaining about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _EXIT_FAILED
    except KeyboardInterrupt:
        return _complain(["interrupted"], status=_EXIT_INTERRUPTED)
    return status


def _dispatch(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    # numpy, scipy and shapely take a second: usage errors and --help do not wait for them.
    if args.command == "serve":
        from simulator import serve  # noqa: PLC0415

        return serve.main(args)
    if args.command == "render":
        from simulator.pictures import render  # noqa: PLC0415

        return render.main(args)
    if args.command == "replay":
        from simulator import replay  # noqa: PLC0415

        return replay.main(args)
    if args.command == "scenarios":
        from simulator.listing import list_scenarios  # noqa: PLC0415

        print(list_scenarios(as_json=args.json))
        return 0
    if args.command == "resume":
        from simulator.run import resume  # noqa: PLC0415

        set_up_logging()
        resume(args.snapshot_file, out=args.out, force=args.force)
        return 0
    if args.command == "run" or args.check_config:
        config = load_config(RunConfig, args)
        if args.check_config:
            from simulator.arenas.scenarios import find_scenario  # noqa: PLC0415
            from simulator.presets import find_preset  # noqa: PLC0415
            from simulator.radios.radio import choose_radio  # noqa: PLC0415

            find_preset(config.preset)
            choose_radio(config)
            if config.scenario is not None:
                find_scenario(config.scenario)
            print(f"{args.config or 'defaults and environment'}: the configuration is valid")
            return 0
        from simulator.run import run  # noqa: PLC0415

        set_up_logging()
        # A run has nothing to drain: a polite kill leaves no half-written files behind, as Ctrl-C does.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        run(config)
        return 0
    parser.print_usage(sys.stderr)
    return _complain(["give a command: run, resume, serve, replay, render or scenarios"], status=_EXIT_USAGE)


def _make_parser(given: Sequence[str]) -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="biobot-sim", description="Simulated insects with backpacks: whole runs as files, or live behind a virtual dongle."
    )
    _add_common(parser, is_command=False)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    run = commands.add_parser(
        "run", usage="%(prog)s [OPTION ...]", help="walk a whole run as fast as possible and write encounters, modes and truth"
    )
    _add_common(run, is_command=True)
    _add_run_arguments(run)
    resume = commands.add_parser(
        "resume", usage="%(prog)s [OPTION ...] SNAPSHOT", help="finish a run that was interrupted, from its snapshot"
    )
    _add_common(resume, is_command=True)
    resume.add_argument("snapshot_file", type=Path, metavar="SNAPSHOT", help="file that 'run --snapshot' wrote; it is kept up to date")
    resume.add_argument("--out", metavar="DIR", help="directory for the results (default: the run's)")
    resume.add_argument("--force", action="store_true", help="write into a directory that is not empty")
    serve = commands.add_parser(
        "serve", usage="%(prog)s [OPTION ...]", help="walk in real time behind a virtual coordinator, for a gateway to listen to"
    )
    _add_common(serve, is_command=True)
    if "serve" in given:
        from simulator import serve as serve_module  # noqa: PLC0415  # the other commands need none of its imports

        serve_module.add_arguments(serve)
    render = commands.add_parser(
        "render", usage="%(prog)s [OPTION ...] DIR", help="make pictures, films or a page of a run that is on disk"
    )
    _add_common(render, is_command=True)
    if "render" in given:
        from simulator.pictures import render as render_module  # noqa: PLC0415  # same

        render_module.add_arguments(render)
    replay = commands.add_parser(
        "replay", usage="%(prog)s [OPTION ...] DIR|FILE.csv", help="let a recorded run happen again behind a virtual coordinator"
    )
    _add_common(replay, is_command=True)
    if "replay" in given:
        from simulator import replay as replay_module  # noqa: PLC0415  # as above

        replay_module.add_arguments(replay)
    scenarios = commands.add_parser("scenarios", help="list scenarios and presets")
    _add_common(scenarios, is_command=True)
    scenarios.add_argument("--json", action="store_true", help="as JSON, with the source of every value")
    return parser


def _add_common(parser: argparse.ArgumentParser, *, is_command: bool) -> None:
    """Add the options of every command; on a command they default to nothing, so as not to undo those given before it."""
    parser.add_argument("--version", action="version", version=f"%(prog)s {version('biobot-gateway')}")
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE.toml",
        default=argparse.SUPPRESS if is_command else None,
        help="read the configuration from this file; flags and BIOBOT_SIM__... variables override it",
    )
    parser.add_argument(
        "--check-config",
        action="store_true",
        default=argparse.SUPPRESS if is_command else False,
        help="only check the configuration, then exit",
    )


def _add_run_arguments(run: argparse.ArgumentParser) -> None:
    arena_flags.add_arguments(run)
    run.add_argument("--preset", metavar="NAME", help="parameters of insects (default: paper-units)")
    run.add_argument("--biobots", type=int, metavar="N", help="how many insects (default: the preset's)")
    run.add_argument("--landmarks", type=int, metavar="N", help="how many of them stand still as landmarks")
    run.add_argument("--duration", dest="duration_s", type=float, metavar="S", help="seconds to explore (default: the preset's)")
    run.add_argument("--duration-s", dest="duration_s", type=float, help=argparse.SUPPRESS)  # the key's name, as messages have it
    run.add_argument("--seed", type=int, metavar="N", help="same seed, same run; required")
    radio_flags.add_arguments(run)
    run.add_argument("--out", metavar="DIR", help="directory for results, made if missing; required")
    run.add_argument("--force", action="store_true", default=None, help="write into a directory that is not empty")
    run.add_argument("--position-samples", type=int, metavar="N", help="write all places at so many instants (default: 201)")
    run.add_argument("--snapshot", metavar="FILE", help="keep the run in this file, for 'resume' after a signal")
    run.add_argument("--snapshot-every", dest="snapshot_every_s", type=float, metavar="S", help="also each S seconds of the run")
    run.add_argument("--snapshot-every-s", dest="snapshot_every_s", type=float, help=argparse.SUPPRESS)
    run.add_argument("--watch", action="store_true", default=None, help="show the insects in the terminal while they walk")
    run.add_argument("--watch-speed", type=float, metavar="X", help="and no faster than X seconds of the run in one of ours")
    motion_flags.add_arguments(run)


def _complain(problems: Sequence[str], *, status: int) -> int:
    for problem in problems:
        print(f"biobot-sim: {problem}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
