"""How far long work is, on standard error: a bar on a terminal, an event of the log now and then elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from simulator.log import EventLog

log = EventLog(__name__)

Show = Callable[[float], None]
"""Told how much of all is done, in the unit of all."""

_BAR_WIDTH = 40
_TOLD_EVERY_S = 30.0


@contextlib.contextmanager
def shown_progress(event: str, *, total: float, unit: str, every_s: float = _TOLD_EVERY_S) -> Iterator[Show]:
    """Give what shows how far work is; where standard error is no terminal, as ``event`` of the log, at most once each ``every_s`` [s]."""
    if sys.stderr.isatty():
        yield lambda done: _draw_bar(done, total=total, unit=unit)
        sys.stderr.write("\n")
        return
    told_s = time.monotonic()

    def tell(done: float) -> None:
        nonlocal told_s
        now_s = time.monotonic()
        if now_s - told_s >= every_s:
            told_s = now_s
            log.info(event, done=round(done, 3), of=total, unit=unit)

    yield tell


def _draw_bar(done: float, *, total: float, unit: str) -> None:
    share = done / total
    filled = round(share * _BAR_WIDTH)
    sys.stderr.write(f"\r[{'#' * filled}{' ' * (_BAR_WIDTH - filled)}] {share:4.0%}  {done:.0f} of {total:.0f} {unit}")
    sys.stderr.flush()
