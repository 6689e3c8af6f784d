"""How far a study is: a bar on a terminal, a line now and then elsewhere. Both go to standard error."""

import sys
import time
from typing import Any, Self, TextIO

from tqdm import tqdm

_LINE_EVERY_S = 30.0


class Progress:
    """Counts cases and tells of them; a context manager.

    Parameters
    ----------
    label
        What is being computed.
    total, done
        Cases in all, and those that were done before.
    stream
        Where it is told; standard error if None.
    every_s
        Time between two lines where the stream is no terminal [s].
    """

    def __init__(self, *, label: str, total: int, done: int = 0, stream: TextIO | None = None, every_s: float = _LINE_EVERY_S) -> None:
        self._label = label
        self._stream = sys.stderr if stream is None else stream
        self._every_s = every_s
        self._total, self._before, self._done, self._failed = total, done, done, 0
        self._began_s = self._told_s = time.monotonic()
        self._bar: Any = None
        if self._stream.isatty() and done < total:
            self._bar = tqdm(desc=label, total=total, initial=done, file=self._stream, unit="case", dynamic_ncols=True, smoothing=0.1)

    def step(self, *, has_failed: bool) -> None:
        """Count a case."""
        self._done += 1
        self._failed += has_failed
        if self._bar is not None:
            if has_failed:
                self._bar.set_postfix(failed=self._failed, refresh=False)
            self._bar.update()
        elif time.monotonic() - self._told_s >= self._every_s:
            self._told_s = time.monotonic()
            left = tqdm.format_interval(self._elapsed_s() / (self._done - self._before) * (self._total - self._done))
            self._tell(f"{self._count()}, {left} left")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
        before = f", {self._before} of them before" if self._before else ""
        self._tell(f"{self._count()}{before}, in {tqdm.format_interval(self._elapsed_s())}")

    def _count(self) -> str:
        failed = f", {self._failed} failed" if self._failed else ""
        return f"{self._done} of {self._total} cases{failed}"

    def _elapsed_s(self) -> float:
        return time.monotonic() - self._began_s

    def _tell(self, text: str) -> None:
        self._stream.write(f"{self._label}: {text}\n")
        self._stream.flush()
