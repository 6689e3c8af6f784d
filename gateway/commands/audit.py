"""``biobot-gateway audit``: who commanded what, and whether the log of it is as it was written; also while a gateway writes it."""

import argparse
import json
import sqlite3
import string
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from gateway.commands.audit_lines import COLUMNS, DOSE_HEAD, dose_line, escaped, line_of, shown, table_row
from gateway.commands.journal import instant
from gateway.commands.outcome import DONE, FAILED, complain, progress
from gateway.errors import JournalUnfitError
from gateway.journal_export.outputs import expect_output
from gateway.journal_export.tables import write_csv, write_json_lines
from gateway.journal_file import (
    AFTER_DAMAGE,
    AuditEntry,
    AuditSelection,
    UnreadableRow,
    expect_journal,
    read_audit_kinds,
    read_audit_rows,
    read_doses,
    verify_audit_of,
)

_FOLLOW_S = 0.5
_MIN_DIGITS, _MAX_DIGITS = 12, 64
_WHAT_NOW = "keep a copy of the file and find out who can write it; `biobot-gateway audit show` prints all that is in it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions of ``audit`` and their flags."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    verify = actions.add_parser("verify", help="follow the chain of hashes; exit status 1 and the first row that does not fit")
    show = actions.add_parser("show", help="print what was asked, decided and done, a line each")
    export = actions.add_parser("export", help="write it as a table, or as lines of JSON")
    stats = actions.add_parser("stats", help="print how each biobot was stimulated")
    for action in (verify, show, export, stats):
        action.add_argument("file", type=Path, metavar="FILE", help="journal, of a running gateway or not")
    help_text = f"a hash that was noted, or its first {_MIN_DIGITS} digits or more: exit status 1 where the log does not have it"
    verify.add_argument("--head", type=_digits, metavar="HASH", help=help_text)
    for action in (show, export):
        action.add_argument("--node", type=int, metavar="N", help="of this biobot")
        action.add_argument("--operator", metavar="X", help="of this operator")
        action.add_argument("--command", dest="command_id", metavar="ID", help="of this command")
        action.add_argument("--kind", metavar="K", help="of this kind: stage, limits, order, gateway, ... (docs/audit.md)")
        action.add_argument("--since", type=instant, metavar="T", help="from T on, such as 2026-11-26T09:00Z")
    show.add_argument("--follow", action="store_true", help="go on with what is written from now on")
    show.add_argument("--json", action="store_true", help="one JSON object a line")
    target = export.add_mutually_exclusive_group(required=True)
    target.add_argument("--csv", type=Path, metavar="OUT", help="write CSV")
    target.add_argument("--json", type=Path, metavar="OUT", help="write one JSON object a line")
    stats.add_argument("--json", action="store_true", help="print JSON")


def audit(options: argparse.Namespace) -> int:
    """Do what was asked."""
    path: Path = options.file
    try:
        expect_journal(path)
        match options.action:
            case "verify":
                with progress() as tell:
                    return _verify(path, witness=options.head or "", tell=tell)
            case "show" if options.follow or _has_kind(path, options.kind):
                return _show(path, _selection(options), is_json=options.json, follows=options.follow)
            case "export" if _has_kind(path, options.kind):
                return _export(path, _selection(options), csv=options.csv, json_lines=options.json)
            case "show" | "export":
                return FAILED
            case _:
                return _print_doses(path, is_json=options.json)
    except sqlite3.Error as error:
        advice = "see `biobot-gateway journal check`; " + AFTER_DAMAGE
        raise JournalUnfitError(path=str(path), reason=f"cannot be read: {error}", advice=advice) from error


def _verify(path: Path, *, witness: str, tell: Callable[[str], None]) -> int:
    found = verify_audit_of(path, witness=witness, tell=tell)
    before = f", after {found.n_pruned} that went by age" if found.n_pruned else ""
    print(f"{found.n_rows} rows{before}, head {found.head.n_rows} {found.head.chain.hex()}")
    if found.fault is not None:
        return complain(f"audit log of {path}: {found.fault}; {_WHAT_NOW}", status=FAILED)
    if witness and found.witness_at is None:
        gone = f", unless it went by age (rows 1 to {found.n_pruned})" if found.n_pruned else ""
        reason = f"no row has the hash {witness}: the log was cut or written anew since that was noted, or it is of another journal{gone}"
        return complain(f"audit log of {path}: {reason}; {_WHAT_NOW}", status=FAILED)
    if witness:
        print(f"{witness} is row {found.witness_at}")
    return DONE


def _show(path: Path, selection: AuditSelection, *, is_json: bool, follows: bool) -> int:
    last = 0
    while True:
        for row in read_audit_rows(path, selection, after=last):
            last = row.last if isinstance(row, UnreadableRow) else row.id
            if isinstance(row, UnreadableRow):
                which = f"row {row.id} is" if row.id == last else f"rows {row.id} to {last} are"
                complain(f"{which} not as a gateway writes it ({row.reason}); see `biobot-gateway audit verify {path}`")
            else:
                print(json.dumps(shown(row)) if is_json else line_of(row), flush=follows)
        if not follows:
            return DONE
        time.sleep(_FOLLOW_S)


def _export(path: Path, selection: AuditSelection, *, csv: Path | None, json_lines: Path | None) -> int:
    out = csv or json_lines
    assert out is not None
    expect_output(out, journal=path)
    unreadable: list[str] = []

    def readable() -> Iterator[AuditEntry]:
        for row in read_audit_rows(path, selection):
            if isinstance(row, AuditEntry):
                yield row
            elif len(unreadable) < _MAX_DIGITS:
                unreadable.append(str(row.id) if row.id == row.last else f"{row.id} to {row.last}")

    as_table = csv is not None
    n_rows = write_csv(out, COLUMNS, map(table_row, readable())) if as_table else write_json_lines(out, map(shown, readable()))
    complain(f"{out}: {n_rows} rows")
    if unreadable:
        rows = ", ".join(unreadable)
        return complain(f"left out, not as a gateway writes them: rows {rows}; see `biobot-gateway audit verify {path}`", status=FAILED)
    return DONE


def _print_doses(path: Path, *, is_json: bool) -> int:
    doses = read_doses(path)
    if is_json:
        names = list(doses[0].__dataclass_fields__) if doses else []
        print(json.dumps([{name: getattr(dose, name) for name in names} for dose in doses], indent=2))
        return DONE
    print(DOSE_HEAD)
    for dose in doses:
        print(dose_line(dose))
    return DONE


def _has_kind(path: Path, kind: str | None) -> bool:
    """Whether there is a row of a kind; where there is none, say which kinds there are."""
    kinds = [] if kind is None else read_audit_kinds(path)
    if kind is None or kind in kinds:
        return True
    there = ", ".join(map(escaped, kinds)) or "no row at all"
    complain(f"audit log of {path}: no row is of kind {escaped(kind)!r}; there is {there} (docs/audit.md)")
    return False


def _selection(options: argparse.Namespace) -> AuditSelection:
    return AuditSelection(
        node=options.node, operator=options.operator, command_id=options.command_id, kind=options.kind, since_wall_ns=options.since
    )


def _digits(text: str) -> str:
    if not _MIN_DIGITS <= len(text) <= _MAX_DIGITS or any(one not in string.hexdigits for one in text):
        wanted = f"{_MIN_DIGITS} to {_MAX_DIGITS} hexadecimal digits, as the status has them (audit_head)"
        raise argparse.ArgumentTypeError(f"{text!r} is no hash; wanted {wanted}")
    return text.lower()
