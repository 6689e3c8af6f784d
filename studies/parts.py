"""Parts of the system as processes of their own, started and stopped by a study."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from studies.system import PartFailedError

_POLL_S: Final = 0.02
_START_S: Final = 600.0
_STOP_S: Final = 30.0


@dataclass(slots=True, kw_only=True)
class Parts:
    """Processes that end with this context."""

    out: Path
    _processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for name in reversed(tuple(self._processes)):  # readers before what they read
            self.stop(name)

    @property
    def pids(self) -> dict[str, int]:
        """The numbers of those that have been started and not stopped."""
        return {name: process.pid for name, process in self._processes.items()}

    def start(self, name: str, *arguments: object) -> None:
        """Start ``python -m ...`` with its output in ``{name}.log``."""
        with (self.out / f"{name}.log").open("ab") as log:
            command = [sys.executable, "-m", *map(str, arguments)]
            self._processes[name] = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)

    def stop(self, name: str, *, number: signal.Signals = signal.SIGTERM) -> None:
        """Send a signal, and wait for the end."""
        process = self._processes.pop(name, None)
        if process is not None and process.poll() is None:
            process.send_signal(number)
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def wait(self, probe: Callable[[], object], *, what: str, timeout_s: float = _START_S) -> None:
        """Wait until ``probe`` returns something true."""
        deadline = time.monotonic() + timeout_s
        while not probe():
            self.check()
            if time.monotonic() > deadline:
                raise PartFailedError(f"{what}: not after {timeout_s:g} s; the logs are in {self.out}")
            time.sleep(_POLL_S)

    def check(self) -> None:
        """Raise ``PartFailedError`` where a process has ended that was not stopped."""
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise PartFailedError(f"the {name} ended with exit status {process.returncode}; see {self.out / name}.log")
