"""What was done to an audit log whose chain does not hold: a row altered, missing, inserted, or put in another's place."""

import sqlite3

from gateway.journal_file.audit_chain import COLUMNS, Cell, ChainHead, link

ROWS = f"SELECT {COLUMNS}, chain FROM audit WHERE id > ? ORDER BY id"  # noqa: S608  # constants of this package
CHAIN = -1
"""Where a row of these has its hash."""

Row = tuple[Cell, ...]

_MAX_MISSING = 4096
"""Rows that are looked for where others have taken their numbers."""


def fits(chain: Cell, row: Row, *, number: int | None = None) -> bool:
    """Return whether a row comes after one whose hash is ``chain``, as if its number were ``number``."""
    found = _hash(chain, row, number=number)
    return found is not None and found == row[CHAIN]


def numbers(first: int, last: int) -> str:
    """Return how rows are named where something is said of them."""
    return f"row {first} is" if first == last else f"rows {first} to {last} are"


def diagnose(connection: sqlite3.Connection, head: ChainHead, row: Row) -> str:
    """Say what was done to the first row that does not fit behind ``head``; the rows behind it are searched for the one that would."""
    wanted, number = head.n_rows + 1, _number(row)
    if number < wanted:
        return f"row {number} was inserted: the log begins with row {wanted}"
    if fits(head.chain, row, number=wanted):
        return f"row {wanted} was altered: its number is {number} now"
    moved = next((one for one in connection.execute(ROWS, (number,)) if fits(head.chain, one, number=wanted)), None)
    if moved is not None:
        is_inserted = number == wanted and _is_pushed_back(connection, row, moved)
        what = f"{numbers(wanted, _number(moved) - 1)} inserted" if is_inserted else "reordered"
        return f"{what}: what was row {wanted} is row {_number(moved)} now"
    if number > wanted:
        return f"{numbers(wanted, number - 1)} missing"
    return _diagnose_altered(connection, head, row)


def _is_pushed_back(connection: sqlite3.Connection, row: Row, moved: Row) -> bool:
    """Return whether ``moved`` gave its number to ``row`` with all that is behind it, and not in exchange."""
    wanted, place = _number(row), _number(moved)
    behind = connection.execute(ROWS, (place,)).fetchone()
    if behind is not None:
        return fits(moved[CHAIN], behind, number=wanted + 1)
    (before,) = connection.execute("SELECT chain FROM audit WHERE id = ?", (place - 1,)).fetchone() or (None,)
    return not fits(moved[CHAIN] if place == wanted + 1 else before, row, number=place)


def _diagnose_altered(connection: sqlite3.Connection, head: ChainHead, row: Row) -> str:
    number = _number(row)
    behind = connection.execute(ROWS, (number,)).fetchone()
    if behind is None:
        return f"row {number}, the last one, was altered, replaced or inserted"
    if fits(row[CHAIN], behind):
        return f"row {number} was altered"
    if fits(_hash(head.chain, row), behind):
        return f"row {number} was altered: its hash alone"
    n_missing = next((n for n in range(1, _MAX_MISSING) if fits(row[CHAIN], behind, number=_number(behind) + n)), None)
    if n_missing is not None:
        return f"{numbers(number, number + n_missing - 1)} missing, and the rows behind have their numbers"
    return f"row {number} was altered or replaced, and the one behind it does not fit either"


def _hash(chain: Cell, row: Row, *, number: int | None = None) -> bytes | None:
    """Return what a row's hash must be; None: this program wrote no such row."""
    try:
        return link(chain, (row[0] if number is None else number, *row[1:CHAIN])) if isinstance(chain, bytes) else None
    except (UnicodeEncodeError, OverflowError):
        return None


def _number(row: Row) -> int:
    number = row[0]
    assert isinstance(number, int)  # SQLite has nothing else in an INTEGER PRIMARY KEY
    return number
