"""The processes of a campaign: started, killed, frozen, started again, and brought back where they end by themselves."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

_RESTART_S = 1.0
_LOOK_S = 0.1
_STOP_S = 20.0


@dataclass(slots=True, kw_only=True)
class Service:
    """A service that is to run all the time, as under a service manager: where it ends by itself it is started again a second later."""

    name: str
    arguments: Sequence[str]
    prefix: Sequence[str]
    environment: dict[str, str]
    log: Path
    n_ended: int = 0
    """How often it ended by itself."""
    n_hung: int = 0
    """How often it did not end when it was told to."""
    peak_rss: int = 0
    """Largest resident memory of any of its processes [B]."""
    _process: subprocess.Popen[bytes] | None = None
    _is_wanted: bool = False
    _ended_cpu_s: float = 0.0
    _own_cpu_s: float = 0.0

    def start(self) -> None:
        """Start it."""
        self._is_wanted = True
        self._ended_cpu_s, self._own_cpu_s = self._ended_cpu_s + self._own_cpu_s, 0.0
        with self.log.open("ab") as log:
            command = [*self.prefix, sys.executable, "-m", *self.arguments]
            environment = {**os.environ, "PYTHONUNBUFFERED": "1", **self.environment}
            self._process = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=environment)

    @property
    def is_running(self) -> bool:
        """Whether there is a process."""
        return self._process is not None and self._process.poll() is None

    @property
    def exit_status(self) -> int | None:
        """How its process ended; None: it runs, or there is none."""
        return None if self._process is None else self._process.poll()

    def cpu_s(self) -> float:
        """Return the processor time of all its processes so far [s]; of one that has ended, what was last noted."""
        self._note_use()
        return self._ended_cpu_s + self._own_cpu_s

    def freeze(self) -> None:
        """Stop it where it is."""
        self._signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        self._signal(signal.SIGCONT)

    def kill(self) -> None:
        """End it at once."""
        self._is_wanted = False
        self._note_use()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def end(self) -> None:
        """Tell it to end, and do not wait."""
        self._is_wanted = False
        self._signal(signal.SIGTERM)

    async def stop(self) -> None:
        """End it as a service manager does: kill what does not end in time."""
        self._is_wanted = False
        self._note_use()
        if self._process is None:
            return
        self._signal(signal.SIGTERM)
        for _ in range(round(_STOP_S / _LOOK_S)):
            if self._process.poll() is not None:
                break
            await asyncio.sleep(_LOOK_S)
        else:
            self.n_hung += 1
        self.kill()

    async def keep(self) -> None:
        """Bring it back whenever it ends by itself, and note its memory and processor time, until cancelled."""
        while True:
            await asyncio.sleep(_LOOK_S)
            self._note_use()
            if self._is_wanted and not self.is_running:
                self.n_ended += 1
                await asyncio.sleep(_RESTART_S)
                if self._is_wanted and not self.is_running:
                    self.start()

    def _signal(self, number: signal.Signals) -> None:
        if self.is_running and self._process is not None:
            self._process.send_signal(number)

    def _note_use(self) -> None:
        if self._process is not None:
            self.peak_rss = max(self.peak_rss, _peak_rss(self._process.pid))
            self._own_cpu_s = max(self._own_cpu_s, _cpu_s(self._process.pid))


@dataclass(slots=True, kw_only=True)
class YardHandle:
    """A yard's process: takes orders, tells what became of them and how it is doing."""

    name: str
    config: Path
    log: Path
    state: dict[str, Any] = field(default_factory=dict)
    addresses: tuple[str, ...] = ()
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    on_news: Callable[[dict[str, Any]], None] = lambda _: None
    has_ended: asyncio.Event = field(default_factory=asyncio.Event)
    peak_rss: int = 0
    _process: asyncio.subprocess.Process | None = None
    _log: IO[bytes] | None = None

    async def start(self) -> None:
        """Start it; ``ready`` is set when its lines are there."""
        self._log = self.log.open("ab")
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "studies.campaign.yard_process", str(self.config),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log,
        )  # fmt: skip

    def order(self, **what: object) -> None:
        """Give an order."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.write(json.dumps(what).encode() + b"\n")

    async def listen(self) -> None:
        """Take in what it tells, to its end."""
        assert self._process is not None
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            news = json.loads(line)
            if "ready" in news:
                self.addresses = tuple(news["ready"])
                self.ready.set()
            elif "meetings" in news:
                self.state = news
                self.peak_rss = max(self.peak_rss, _peak_rss(self._process.pid))
            else:
                self.on_news(news)
        await self._process.wait()
        self.has_ended.set()
        if self._log is not None:
            self._log.close()

    def kill(self) -> None:
        """End it at once."""
        if self._process is not None and self._process.returncode is None:
            self._process.kill()


def _cpu_s(pid: int) -> float:
    """Return a process's time on processors, its own and the kernel's for it [s]; 0 where it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _peak_rss(pid: int) -> int:
    """Return the peak of a process's resident memory [B]; 0 where it is gone."""
    try:
        for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return 0
