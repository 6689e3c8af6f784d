"""``biobot-gateway journal``: check a journal, tell what is in it, export it; also while a gateway writes it."""

import argparse
import json
import sqlite3
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import NS_PER_S
from gateway.commands.outcome import DONE, FAILED, complain, progress
from gateway.errors import JournalUnfitError
from gateway.journal_export.outputs import expect_output
from gateway.journal_export.rows import COLUMNS, Kind, Selection, read_rows
from gateway.journal_export.tables import write_csv, write_parquet
from gateway.journal_file import AFTER_DAMAGE, check_journal, describe_journal, expect_journal

_ALL = "all"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions of ``journal`` and their flags."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    check = actions.add_parser("check", help="read all of it; exit status 1 and its faults where it is damaged")
    info = actions.add_parser("info", help="print what is in it, as JSON")
    export = actions.add_parser("export", help="write it as a table; a void encounter is a part of another one and left out")
    for action in (check, info, export):
        action.add_argument("file", type=Path, metavar="FILE", help="journal, of a running gateway or not")
    target = export.add_mutually_exclusive_group(required=True)
    target.add_argument("--csv", type=Path, metavar="OUT", help="write CSV")
    target.add_argument("--parquet", type=Path, metavar="OUT", help="write Parquet (needs pyarrow)")
    kinds = [*(kind.value for kind in Kind), _ALL]
    export.add_argument(
        "--kind", choices=kinds, default=Kind.ENCOUNTERS.value, help="(default: encounters); all: OUT.encounters.csv and so on, one each"
    )
    export.add_argument("--from", dest="begin", type=instant, metavar="T", help="what ends at or after T, such as 2026-11-26T09:00Z")
    export.add_argument("--until", type=instant, metavar="T", help="what begins before T")
    export.add_argument("--skip-damaged", action="store_true", help="export what is whole, and say what was left out")
    export.add_argument("--all-revisions", action="store_true", help="every revision of a record, void ones too, not the newest alone")


def journal(options: argparse.Namespace) -> int:
    """Do what was asked."""
    path: Path = options.file
    try:
        expect_journal(path)
        with progress() as tell:
            if options.action == "check":
                return _check(path, tell)
            if options.action == "info":
                print(json.dumps(describe_journal(path), indent=2))
                return DONE
            return _export(options, tell)
    except sqlite3.Error as error:
        see = "" if options.action == "check" else "see `biobot-gateway journal check`; "
        raise JournalUnfitError(path=str(path), reason=f"cannot be read: {error}", advice=see + AFTER_DAMAGE) from error


def _check(path: Path, tell: Callable[[str], None]) -> int:
    findings = check_journal(path, tell=tell)
    print(f"{findings.n_segments} segments, {findings.n_records} records, {findings.n_reports} reports")
    if not findings.n_faults:
        return DONE
    complain(*(f"journal {path}: {fault}" for fault in findings.faults))
    more = f" ({findings.n_faults - len(findings.faults)} more are not shown)" if findings.n_faults > len(findings.faults) else ""
    faults = "1 fault" if findings.n_faults == 1 else f"{findings.n_faults} faults"
    return complain(f"journal {path}: {faults}{more}; {AFTER_DAMAGE}", status=FAILED)


def _export(options: argparse.Namespace, tell: Callable[[str], None]) -> int:
    if options.begin is not None and options.until is not None and options.until <= options.begin:
        raise ConfigurationError(["journal export: --until is not after --from; nothing would be left"])
    out: Path = options.csv or options.parquet
    left_out: dict[str, None] = {}  # a set that keeps the order
    write = write_csv if options.csv is not None else write_parquet
    kinds = list(Kind) if options.kind == _ALL else [Kind(options.kind)]
    hear = left_out.setdefault if options.skip_damaged else None
    targets = {kind: out if len(kinds) == 1 else out.with_name(f"{out.stem}.{kind.value}{out.suffix}") for kind in kinds}
    for target in targets.values():
        expect_output(target, journal=options.file)
    for kind, target in targets.items():
        selection = Selection(kind=kind, from_wall_ns=options.begin, until_wall_ns=options.until, has_all_revisions=options.all_revisions)
        n_rows = write(target, COLUMNS[kind], read_rows(options.file, selection, tell=tell, left_out=hear))
        complain(f"{target}: {n_rows} rows")
    if left_out:
        complain(*(f"left out: {part}" for part in left_out), f"{len(left_out)} damaged parts of {options.file} were left out")
    return DONE


def instant(text: str) -> int:
    """Return an instant [ns since 1970]; without a zone it is UTC."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no date and time; give one such as 2026-11-26T09:00:00Z") from error
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    return int(moment.timestamp()) * NS_PER_S + moment.microsecond * 1000
