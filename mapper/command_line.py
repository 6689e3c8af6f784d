"""Commands of the mapper, their flags and outputs.

``run`` maps a file, ``route`` finds ways around its obstacles, ``merge`` maps several as one, ``serve`` keeps a map up to date,
``tokens`` says who may command, ``feasibility`` foretells what a map will show, ``warm-up`` sees to what they need, ``config`` prints what
a configuration file may say.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.nearest_word import CommandParser
from mapper.config import MapperConfig, ServiceConfig, load_mapper_config, make_recipe
from mapper.errors import MapError, OutOfMemoryError, TooFewEncountersError
from mapper.flag_values import join_negative_numbers, read_id_list, read_number_of_classes, read_seconds
from mapper.output_files import STANDARD, check_outputs, is_standard_output, write_output
from mapper.reading_flags import add_reading_arguments, reading_options
from mapper.types import MapResult, Method, MetricKind

if TYPE_CHECKING:
    from mapper.pins import Pinned

_EXIT_FAILED, _EXIT_USAGE = 1, 2
_TITLE = (
    "Configuration of biobot-mapper: every key with its default. Variables such as BIOBOT_MAPPER__SERVE__PORT win over this file, flags "
    "over both. Keep what you change; `biobot-mapper serve --config FILE --check-config` tells all that is wrong with it."
)

_NO_ROOM = ("failed to map segment", "annot allocate memory", "error return without exception set")
"""What the dynamic loader says where a library finds no memory, and the interpreter where it has none left to say so."""


def run_command_line(given: Sequence[str]) -> int:
    """Run the command line; the exit status is 0 done, 1 failed, 2 bad usage or configuration."""
    try:
        parser = _make_parser(given)
        args = parser.parse_args(join_negative_numbers(given))
        status = _dispatch(args, parser)
        sys.stdout.flush()
    except ConfigurationError as error:
        return _complain(error.problems, status=_EXIT_USAGE)
    except MapError as error:
        return _complain(str(error).splitlines(), status=_EXIT_FAILED)
    except MemoryError:
        return _complain([str(OutOfMemoryError(n_encounters=None))], status=_EXIT_FAILED)
    except (ImportError, SystemError) as error:  # something is imported when it is wanted, and there is no room for it
        if not any(words in str(error) for words in _NO_ROOM):
            raise
        return _complain([str(OutOfMemoryError(n_encounters=None))], status=_EXIT_FAILED)
    except BrokenPipeError:
        # Whoever read our output is gone; keep the interpreter from complaining about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _EXIT_FAILED
    return status


def _dispatch(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    if args.check_config:
        return _check_configuration(args)
    if args.command == "serve":
        from mapper.service import main as serve  # noqa: PLC0415  # zenoh and the web server are for `serve` alone

        return serve(args)
    commands: dict[str, Callable[[], int]] = {
        "run": lambda: _run(args, parser),
        "route": lambda: _route(args, parser),
        "merge": lambda: _merge(args, parser),
        "feasibility": lambda: _foretell(args),
        "warm-up": lambda: _warm_up(args),
        "config": lambda: _print_config(args),
        "tokens": lambda: _tokens(args, parser),
    }
    if args.command in commands:
        return commands[args.command]()
    parser.print_usage(sys.stderr)
    return _complain(["give a command: run, route, merge, serve, tokens, feasibility, warm-up or config"], status=_EXIT_USAGE)


def _check_configuration(args: argparse.Namespace) -> int:
    """Check file, environment and the flags of the command, all of them before any fault is told."""
    from mapper.feasibility_report import check_given  # noqa: PLC0415  # see _run
    from mapper.kernels import choose_kernels  # noqa: PLC0415  # see _run
    from mapper.service_checks import check_service, service_obstacles  # noqa: PLC0415  # see _run
    from mapper.time_limits import make_limits  # noqa: PLC0415  # see _run

    flags = _recipe_flags(args)
    if args.command == "serve":
        flags |= {f"serve.{name}": getattr(args, name, None) for name in ServiceConfig.__struct_fields__}

    def check_sources() -> None:
        check = partial(check_service, tries_places=True)
        config = load_mapper_config(args.config, environment=os.environ, flags=flags, check=check)
        for obstacle in service_obstacles(config) if args.command == "serve" else ():
            print(f"biobot-mapper: warning: {obstacle}", file=sys.stderr)

    checks: list[Callable[[], object]] = [check_sources, choose_kernels]
    if args.command == "run":
        checks.append(lambda: make_limits(window_s=args.window_s, from_s=args.from_s, until_s=args.until_s))
    if args.command == "feasibility":
        checks.append(lambda: check_given(args))
    problems: list[str] = []
    for check in checks:
        try:
            check()
        except ConfigurationError as error:
            problems += error.problems
    if problems:
        raise ConfigurationError(problems)
    print(f"{args.config or 'defaults and environment'}: the configuration is valid")
    return 0


def _run(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    if args.encounters is None:
        parser.error("run: give the file of contacts")
    config = load_mapper_config(args.config, environment=os.environ, flags=_recipe_flags(args))
    # numpy and scipy take half a second: usage errors and --help do not wait for them.
    from mapper.encounter_csv import read_modes  # noqa: PLC0415
    from mapper.kernels import choose_kernels  # noqa: PLC0415
    from mapper.log_map import map_log  # noqa: PLC0415
    from mapper.map_sketch import sketch_map  # noqa: PLC0415
    from mapper.pins import know_places, place_pins, read_pins  # noqa: PLC0415
    from mapper.pipeline import MIN_ENCOUNTERS  # noqa: PLC0415
    from mapper.places import rows_to_place  # noqa: PLC0415
    from mapper.reading import read_ids, read_log, read_time  # noqa: PLC0415
    from mapper.time_limits import make_limits  # noqa: PLC0415

    inputs = _given(args.encounters, args.modes, args.pins)
    if inputs.count(STANDARD) > 1:
        parser.error("run: standard input can be given for one file")
    check_outputs(_given(args.json, args.svg, args.png, args.geojson), [*inputs, *_given(args.config)])
    pins = read_pins(args.pins) if args.pins is not None else None
    limits = make_limits(window_s=args.window_s, from_s=args.from_s, until_s=args.until_s)
    kernels = choose_kernels()
    log = read_log(args.encounters, reading_options(args))
    table, facts = limits.clip(log.table)
    if len(table) < MIN_ENCOUNTERS:
        n_outside = int(facts["n_before"] or 0) + int(facts["n_after"] or 0)
        raise TooFewEncountersError(n_encounters=len(table), minimum=MIN_ENCOUNTERS, where=str(args.encounters), n_outside=n_outside)
    spells = None if args.modes is None else read_modes(args.modes, number_of=log.names.number_of, time_of=read_time)
    stationary = None if args.stationary is None else read_ids(args.stationary)
    if kernels.shortfall is not None:
        print(f"biobot-mapper: warning: {kernels.shortfall}", file=sys.stderr)
    try:
        result = map_log(
            log,
            table,
            make_recipe(config.recipe),
            spells=spells,
            stationary=stationary,
            searches=args.find_stationary,
            kernels=kernels,
            also_place=rows_to_place([pin.place for pin in pins or ()], table, number_of=log.names.number_of),
        )
    except MemoryError as error:
        raise OutOfMemoryError(n_encounters=len(table)) from error
    pinned = None
    if pins is not None:
        pinned = place_pins(pins, sketch_map(result))
        result = replace(result, assumptions=know_places(result.assumptions, pinned))
    for warning in (*result.warnings, *(() if pinned is None else pinned.warnings)):
        print(f"biobot-mapper: warning: {warning}", file=sys.stderr)
    _write_outputs(result, facts, args, part=limits.describe(), pinned=pinned)
    return 0


def _route(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    if args.source is None or args.begin is None or args.end is None:
        parser.error("route: give a file of encounters or a map, --from and --to")
    config = load_mapper_config(args.config, environment=os.environ, flags=_recipe_flags(args))
    from mapper.route_command import run  # noqa: PLC0415  # see _run

    return run(args, make_recipe(config.recipe))


def _merge(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    if not args.inputs:
        parser.error("merge: give recordings or maps: CSV files, directories of runs, or JSON files of biobot-mapper run")
    config = load_mapper_config(args.config, environment=os.environ, flags=_recipe_flags(args))
    from mapper.merge_command import merge  # noqa: PLC0415  # see _run

    check_outputs(_given(args.json, args.svg, args.png, args.geojson), _given(*args.inputs, *args.modes, args.config))
    result, facts = merge(args, make_recipe(config.recipe))
    for warning in result.warnings:
        print(f"biobot-mapper: warning: {warning}", file=sys.stderr)
    _write_outputs(result, facts, args, part=f"{len(args.inputs)} recordings or maps as one", pinned=None)
    return 0


def _foretell(args: argparse.Namespace) -> int:
    from mapper.feasibility_report import report, to_json  # noqa: PLC0415  # see _run

    check_outputs(_given(args.json), _given(args.encounters, args.config))
    text, document = report(args)
    if args.json is not None:
        write_output(args.json, to_json(document).encode())
    if args.json is None or not is_standard_output(args.json):
        print(text)
    return 0


def _warm_up(args: argparse.Namespace) -> int:
    from mapper.warm_up import warm_up  # noqa: PLC0415  # see _run

    warmth = warm_up()
    if not args.quiet:
        print(*warmth.lines(), sep="\n")
    elif warmth.shortfall is not None:
        print(f"biobot-mapper: warning: {warmth.shortfall}", file=sys.stderr)
    return 0


def _tokens(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    from mapper.access.command import tokens  # noqa: PLC0415  # see _run

    return tokens(args, parser)


def _print_config(args: argparse.Namespace) -> int:
    from msgspec.json import schema  # noqa: PLC0415  # for this command alone

    from firmware_protocol.configuration_text import default_toml  # noqa: PLC0415  # same

    text = json.dumps(schema(MapperConfig), indent=2) + "\n" if args.what == "schema" else default_toml(MapperConfig, title=_TITLE)
    print(text, end="")
    return 0


def _given(*paths: Path | None) -> list[Path]:
    return [path for path in paths if path is not None]


def _write_outputs(
    result: MapResult, facts: Mapping[str, object], args: argparse.Namespace, *, part: str | None, pinned: "Pinned | None"
) -> None:
    from mapper.geojson import describe_frame, summarize_frame, to_geojson  # noqa: PLC0415  # see _run
    from mapper.map_file import merging_facts  # noqa: PLC0415  # see _run
    from mapper.render import render_map  # noqa: PLC0415  # see _run
    from mapper.report import summarize, to_json_object  # noqa: PLC0415  # see _run

    if args.svg is not None:
        write_output(args.svg, render_map(result, image_format="svg", part=part, pinned=pinned))
    if args.png is not None:
        write_output(args.png, render_map(result, image_format="png", part=part, pinned=pinned))
    if args.json is not None:
        frame = {"operator_frame": None if pinned is None else describe_frame(result, pinned)}
        text = json.dumps({**to_json_object(result), **merging_facts(result), **frame, **facts}, allow_nan=False) + "\n"
        write_output(args.json, text.encode())
    if args.geojson is not None:
        write_output(args.geojson, (json.dumps(to_geojson(result, pinned=pinned), allow_nan=False) + "\n").encode())
    if not any(map(is_standard_output, _given(args.json, args.svg, args.png, args.geojson))):
        print(summarize(result, part=part))
        if pinned is not None:
            print(summarize_frame(pinned))


def _make_parser(given: Sequence[str]) -> argparse.ArgumentParser:
    about = "From encounters between walking biobots to a map of the space they walked."
    parser = CommandParser(prog="biobot-mapper", description=about)
    _add_common(parser, default=None)
    commands = parser.add_subparsers(dest="command", metavar="{run,route,merge,serve,tokens,feasibility,warm-up,config}")
    about = "Make a map of a log of contacts."
    run = commands.add_parser("run", help="make a map of a log of contacts", usage="%(prog)s FILE [options]", description=about)
    _add_common(run, default=argparse.SUPPRESS)
    _add_run_arguments(run)
    about = (
        "Find routes around obstacles between two places: the shortest of each kind, where ways of one kind can be drawn into each other."
    )
    route = commands.add_parser("route", help="find routes around obstacles between two places", description=about)
    _add_common(route, default=argparse.SUPPRESS)
    _add_route_arguments(route)
    about = "Make one map of several recordings: successive windows of a swarm that moves on, or sites that share landmarks or biobots."
    merge = commands.add_parser("merge", help="make one map of several recordings", description=about)
    _add_common(merge, default=argparse.SUPPRESS)
    _add_merge_arguments(merge)
    serve = commands.add_parser("serve", help="keep a live map and serve it", description="Keep a live map and serve it over HTTP.")
    _add_common(serve, default=argparse.SUPPRESS)
    if "serve" in given:
        from mapper.service import add_arguments  # noqa: PLC0415  # zenoh and the web server are for `serve` alone

        add_arguments(serve)
    about = "Make, list and revoke the tokens by which persons may look at the live map and command."
    tokens = commands.add_parser("tokens", help="say who may look and command", description=about)
    _add_common(tokens, default=argparse.SUPPRESS)
    if "tokens" in given:
        from mapper.access.command import add_arguments as add_token_arguments  # noqa: PLC0415  # see _run

        add_token_arguments(tokens)
    about = "Say how many encounters a plan gives, what obstacles a map will show and when, and what to change."
    feasibility = commands.add_parser("feasibility", help="say what a map will show, before anybody walks", description=about)
    _add_common(feasibility, default=argparse.SUPPRESS)
    if "feasibility" in given:
        from mapper.feasibility_report import add_arguments as add_plan_arguments  # noqa: PLC0415  # see _run

        add_plan_arguments(feasibility)
    about = "Make a map of a known ring: what a map needs is then there and cached, and is named."
    warm = commands.add_parser("warm-up", help="see that all is there, so that the first map is quick", description=about)
    _add_common(warm, default=argparse.SUPPRESS)
    warm.add_argument("--quiet", action="store_true", help="say nothing unless something is wrong or slow")
    about = "Print a configuration file of all keys with their defaults, or its schema."
    config = commands.add_parser("config", help="print a configuration file of all keys, or its schema", description=about)
    _add_common(config, default=argparse.SUPPRESS)
    config.add_argument("what", choices=["print-default", "schema"], help="as TOML with comments, or as JSON Schema for editors")
    return parser


def _add_common(parser: argparse.ArgumentParser, *, default: str | None) -> None:
    """Add the options of every command; on a command they default to nothing, so as not to undo those given before it."""
    parser.add_argument("--version", action="version", version=f"%(prog)s {version('biobot-gateway')}")
    parser.add_argument("--config", type=Path, metavar="FILE.toml", default=default, help="read the configuration from this file")
    check = argparse.SUPPRESS if default is not None else False
    parser.add_argument("--check-config", action="store_true", default=check, help="only check the configuration, then exit")


def _add_run_arguments(run: argparse.ArgumentParser) -> None:
    run.add_argument("encounters", type=Path, nargs="?", help="contacts (docs/your-own-data.md); - is standard input")
    run.add_argument("--modes", type=Path, metavar="FILE", help="CSV with the columns t_start_s,t_end_s,id,mode,cause")
    add_reading_arguments(run)
    run.add_argument("--from-s", type=float, metavar="T", help="leave out what was over at this time of the file")
    run.add_argument("--until-s", type=float, metavar="T", help="leave out what had not begun at this time of the file")
    run.add_argument("--window-s", type=float, metavar="S", help="leave out what was over S before the newest encounter's end")
    run.add_argument("--pins", type=Path, metavar="FILE", help="TOML, JSON or CSV: known places that fix the map in your own frame")
    _add_map_arguments(run)


def _add_merge_arguments(merge: argparse.ArgumentParser) -> None:
    merge.add_argument(
        "inputs",
        type=Path,
        nargs="*",
        metavar="INPUT",
        help="CSV of encounters, directory with encounters.csv and modes.csv, or JSON of a map",
    )
    merge.add_argument(
        "--modes", type=Path, action="append", default=[], metavar="FILE", help="CSV of modes; once for each CSV of encounters, in order"
    )
    merge.add_argument("--shift-s", type=read_seconds, metavar="S,S", help="add to the times of each recording: clocks that differ")
    merge.add_argument("--stationary", type=read_id_list, metavar="ID,ID", help="biobots that stood still all the time")
    _add_map_arguments(merge)


def _add_map_arguments(run: argparse.ArgumentParser) -> None:
    """Add what all commands that make a map take: the recipe, and where results go."""
    _add_recipe_arguments(run)
    run.add_argument("--json", type=Path, metavar="FILE", help="write the map as JSON; - is standard output, then without the summary")
    run.add_argument("--svg", type=Path, metavar="FILE", help="write a picture; - as above")
    run.add_argument("--png", type=Path, metavar="FILE", help="write a picture; - as above")
    run.add_argument("--geojson", type=Path, metavar="FILE", help="write the map as GeoJSON; - as above")


def _add_route_arguments(route: argparse.ArgumentParser) -> None:
    route.add_argument("source", type=Path, nargs="?", metavar="ENCOUNTERS|MAP.json", help="CSV of encounters, or what run --json wrote")
    forms = "landmark:ID[@T], biobot:ID@T, point:INDEX, or xy:X,Y[,COMPONENT]; T in seconds"
    route.add_argument("--from", dest="begin", metavar="PLACE", help=forms)
    route.add_argument("--to", dest="end", metavar="PLACE", help="as --from")
    route.add_argument(
        "--classes", type=read_number_of_classes, default=3, metavar="K", help="routes of so many kinds (default: %(default)s)"
    )
    route.add_argument("--json", type=Path, nargs="?", const=STANDARD, metavar="FILE", help="write JSON; without FILE to standard output")
    route.add_argument("--modes", type=Path, metavar="FILE", help="CSV with the columns t_start_s,t_end_s,id,mode,cause")
    add_reading_arguments(route)
    _add_recipe_arguments(route)


def _add_recipe_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--speed-mps", type=float, metavar="V", help="walking speed [m/s]: lengths are then metres, else seconds")
    parser.add_argument("--method", choices=[str(method) for method in Method], help="the whole recipe (default: default)")
    metrics = [str(metric) for metric in MetricKind]
    parser.add_argument("--metric", choices=metrics, help="how encounters are compared (default: by the method)")


def _recipe_flags(args: argparse.Namespace) -> dict[str, object]:
    return {f"recipe.{name}": getattr(args, name, None) for name in ("method", "metric", "speed_mps")}


def _complain(lines: Sequence[str], *, status: int) -> int:
    for line in lines:
        print(f"biobot-mapper: error: {line}", file=sys.stderr)
    return status
