"""Tables that studies write into documents, between two markers."""

from pathlib import Path

from studies.errors import MarkerError


def put_between_markers(document: str, table: str, *, path: Path, markers: tuple[str, str]) -> str:
    """Return the document with the table in place of what stood between the markers.

    Parameters
    ----------
    path
        Of the document, for the error.

    Raises
    ------
    MarkerError
        The markers are not there once each, in order.
    """
    first, last = markers
    before, begin, rest = document.partition(first)
    _, end, after = rest.partition(last)
    if not (begin and end) or first in rest or last in after:
        raise MarkerError(path=path, markers=markers)
    return f"{before}{first}\n\n{table}\n\n{last}{after}"
