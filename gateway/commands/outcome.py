"""How a command ends: its exit status, and complaints on stderr."""

import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator

DONE, FAILED, USAGE = 0, 1, 2


def complain(*lines: str, status: int = DONE) -> int:
    """Write each line to stderr under the program's name; return ``status``."""
    for line in lines:
        print(f"biobot-gateway: {line}", file=sys.stderr)
    return status


def warn(lines: Iterable[str]) -> None:
    """Write each line to stderr as a warning."""
    complain(*(f"warning: {line}" for line in lines))


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Yield what shows on a terminal's last line what is being done, and wipes it at the end; where stderr is none, it shows nothing."""
    is_shown = sys.stderr.isatty()

    def tell(what: str) -> None:
        if is_shown:
            print(f"\r\033[K{what} ...", end="", file=sys.stderr, flush=True)

    try:
        yield tell
    finally:
        if is_shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
