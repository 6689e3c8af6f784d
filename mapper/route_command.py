"""``biobot-mapper route``: routes around obstacles between two places, on a map that is there or made for it."""

import argparse
import json
from pathlib import Path

from mapper.encounter_csv import read_modes
from mapper.errors import MapDocumentError, TooFewEncountersError
from mapper.kernels import choose_kernels
from mapper.log_map import map_log
from mapper.map_sketch import MapSketch, sketch_document, sketch_map
from mapper.output_files import check_outputs, is_standard_output, write_output
from mapper.pipeline import MIN_ENCOUNTERS
from mapper.places import NamedPlace, parse_place, rows_to_place
from mapper.reading import read_ids, read_log
from mapper.reading_flags import reading_options
from mapper.route_report import answer_routes, describe_routes, routes_to_json
from mapper.types import Recipe

_MAX_MAP_BYTES = 2**30


def run(args: argparse.Namespace, recipe: Recipe) -> int:
    """Find routes, print them and write them as JSON.

    Raises
    ------
    MapError
        A file is faulty, a place is not shown, or there is no way.
    """
    inputs = [path for path in (args.source, args.modes) if path is not None]
    check_outputs([args.json] if args.json is not None else [], inputs)
    ends = parse_place(args.begin), parse_place(args.end)
    sketch = _read_map(args.source) if args.source.suffix.lower() == ".json" else _make_map(args, recipe, ends)
    routes = answer_routes(sketch, *ends, classes=args.classes)
    if args.json is not None:
        write_output(args.json, (json.dumps(routes_to_json(routes), allow_nan=False) + "\n").encode())
    if args.json is None or not is_standard_output(args.json):
        print(describe_routes(routes))
    return 0


def _read_map(path: Path) -> MapSketch:
    try:
        if path.stat().st_size > _MAX_MAP_BYTES:
            raise MapDocumentError(source=str(path), problem=f"larger than {_MAX_MAP_BYTES} bytes")
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapDocumentError(source=str(path), problem=f"cannot be read: {(error.strerror or str(error)).lower()}") from error
    except (ValueError, RecursionError) as error:
        raise MapDocumentError(source=str(path), problem=f"not JSON: {error}") from error
    if not isinstance(document, dict):
        raise MapDocumentError(source=str(path), problem=f"holds a JSON {type(document).__name__}")
    return sketch_document(document, source=str(path))


def _make_map(args: argparse.Namespace, recipe: Recipe, ends: tuple[NamedPlace, NamedPlace]) -> MapSketch:
    """Map a log; biobots' whereabouts are told by their encounters just before and after, points of the map or not."""
    log = read_log(args.source, reading_options(args))
    if len(log.table) < MIN_ENCOUNTERS:
        raise TooFewEncountersError(n_encounters=len(log.table), minimum=MIN_ENCOUNTERS, where=str(args.source))
    result = map_log(
        log,
        log.table,
        recipe,
        spells=None if args.modes is None else read_modes(args.modes, number_of=log.names.number_of),
        stationary=None if args.stationary is None else read_ids(args.stationary),
        searches=args.find_stationary,
        kernels=choose_kernels(),
        also_place=rows_to_place(ends, log.table, number_of=log.names.number_of),
    )
    return sketch_map(result)
