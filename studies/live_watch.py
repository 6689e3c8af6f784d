"""What `studies.bench_live` measures while processes run: answers of the web API, and memory."""

import http.client
import json
import os
import threading
import time
from collections import defaultdict
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from urllib.parse import urlsplit

_DEADLINE_S: Final = 30.0


class Watch:
    """Asks a mapper's API as pages do, on threads of its own, while its context lasts.

    ``behind_s`` has what each status said of the map's age; ``latency_s`` the time of each answer by path; ``n_failed`` counts answers that
    did not come, or were none.
    """

    def __init__(self, url: str, *, periods_s: dict[str, float]) -> None:
        self.behind_s: list[float] = []
        self.versions: set[int] = set()
        self.computing_s: list[float] = []
        self.latency_s: defaultdict[str, list[float]] = defaultdict(list)
        self.n_failed = 0
        self._address = urlsplit(url).netloc
        self._is_over = threading.Event()
        self._threads = [threading.Thread(target=self._ask, args=item, name=f"ask {item[0]}") for item in periods_s.items()]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._is_over.set()
        for thread in self._threads:
            thread.join()

    def _ask(self, path: str, period_s: float) -> None:
        connection = http.client.HTTPConnection(self._address, timeout=_DEADLINE_S)
        due = time.monotonic()
        while not self._is_over.wait(max(0.0, due - time.monotonic())):
            due = max(due + period_s, time.monotonic())
            begun = time.monotonic()
            try:
                connection.request("GET", path)
                answer = connection.getresponse()
                body = answer.read()
            except (OSError, http.client.HTTPException):
                self.n_failed += 1
                connection.close()
                continue
            self.latency_s[path].append(time.monotonic() - begun)
            if answer.status != http.HTTPStatus.OK:
                self.n_failed += 1
            elif path.endswith("/status"):
                self._note(json.loads(body))
        connection.close()

    def _note(self, status: dict[str, Any]) -> None:
        self.behind_s.append(float(status["behind_s"]))
        if status["version"] not in self.versions:
            self.versions.add(status["version"])
            self.computing_s.append(float(status["computing_s"]))


def children_of(pid: int) -> list[int]:
    """Return the numbers of a process's children; needs /proc."""
    return [int(child) for thread in Path(f"/proc/{pid}/task").iterdir() for child in (thread / "children").read_text().split()]


def peak_memory(pid: int) -> dict[str, int]:
    """Return the peaks of resident memory [bytes] of a process and its children, by number; needs /proc."""
    peaks: dict[str, int] = {}
    for one in (pid, *children_of(pid)):
        lines = Path(f"/proc/{one}/status").read_text().splitlines()
        peaks[str(one)] = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))
    return peaks


def core_times(pid: int) -> tuple[float, float]:
    """Return the time of cores [s] that a process has used, and that of its running children; needs /proc."""
    ticks = []
    for one in (pid, *children_of(pid)):
        fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
        ticks.append(int(fields[11]) + int(fields[12]))
    return ticks[0] / os.sysconf("SC_CLK_TCK"), sum(ticks[1:]) / os.sysconf("SC_CLK_TCK")


def share(values: list[float], q: float) -> float:
    """Return the value below which a share ``q`` of all lies; nan where there are none."""
    return sorted(values)[min(len(values) - 1, int(q * len(values)))] if values else float("nan")
