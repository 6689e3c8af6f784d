"""Ids that a person names: on a command line, parted by commas, or in a file, ``@FILE``, one a line or parted by commas."""

from pathlib import Path

from mapper.errors import InputFileError


def read_ids(texts: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ids as they are written, those in files in the place of the files.

    Raises
    ------
    InputFileError
        A file cannot be read or names nobody.
    """
    ids: list[str] = []
    for text in texts:
        ids += _ids_in(text[1:]) if text.startswith("@") else [text]
    return tuple(dict.fromkeys(ids))


def _ids_in(name: str) -> list[str]:
    try:
        content = Path(name).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = (error.strerror or str(error)).lower() if isinstance(error, OSError) else str(error)
        raise InputFileError(path=name, faults=[f"cannot be read: {reason}; give a file of ids, one a line"]) from error
    ids = [part.strip() for line in content.splitlines() for part in line.split(",") if part.strip()]
    if not ids:
        raise InputFileError(path=name, faults=["names no id; write one a line"])
    return ids
