"""The whole system as three real processes: simulator, gateway, mapper. Used by the demo and the end-to-end tests."""

import contextlib
import json
import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, TypeVar

from mapper.access import Role, add_token
from studies.ports import free_port

_ValueT = TypeVar("_ValueT")

OPERATOR: Final = "operator"
"""Whose token it is."""

_POLL_S = 0.1
_STOP_TIMEOUT_S = 15.0


class PartFailedError(Exception):
    """A part of the system did not do what it was started for; the message says where its log is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SystemSettings:
    """What to run. Durations are wall-clock seconds; insects walk ``speed`` times faster than life."""

    out: Path
    scenario: str = "two-obstacles"
    preset: str = "paper-units"
    seed: int = 1
    speed: float = 4.0
    n_biobots: int = 150
    n_landmarks: int = 20
    dispersion_s: float = 5.0
    exploration_s: float = 50.0
    drain_s: float = 10.0
    link: str = "pty"
    """``pty``, ``tcp`` or ``slcan`` with options, such as ``slcan?fd=1``: what stands between simulator and gateway."""
    begins_by_itself: bool = True
    """The mission begins when biobots are heard; False: when somebody orders it."""
    http_port: int = 0
    simulator_args: tuple[str, ...] = ()
    gateway_args: tuple[str, ...] = ()
    mapper_args: tuple[str, ...] = ()


@dataclass(slots=True, kw_only=True)
class RunningSystem:
    """Three processes that end with this context."""

    settings: SystemSettings
    url: str = ""
    token: str = ""
    """That of an operator."""
    bus_endpoint: str = ""
    radio: str = ""
    """What the gateway opens to reach the simulator's dongle."""
    _processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    @property
    def truth_directory(self) -> Path:
        """Where the simulator writes the truth when it ends."""
        return self.settings.out / "truth"

    @property
    def tokens(self) -> Path:
        """The file of tokens that the mapper heeds."""
        return self.settings.out / "tokens.json"

    def start_process(self, name: str, arguments: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start ``python -m ...`` with its output in ``{name}.log`` and remember it under ``name``."""
        log = (self.settings.out / f"{name}.log").open("ab")
        with log:
            process = subprocess.Popen(
                [sys.executable, "-m", *arguments], stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=_environment()
            )
        self._processes[name] = process
        return process

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """Return the running process of a part: simulator, gateway or mapper."""
        return self._processes[name]

    def gateway_arguments(self) -> list[str]:
        """Return the arguments that start the gateway, so that a test can start it again."""
        settings = self.settings
        mission = ["--mission"] if settings.begins_by_itself else []
        return [
            "gateway", "run", "--port", self.radio, "--journal", str(settings.out / "gateway.sqlite"), "--listen", self.bus_endpoint,
            *mission, "--dispersion-s", str(settings.dispersion_s), "--landmarks", str(settings.n_landmarks), *settings.gateway_args,
        ]  # fmt: skip

    def get(self, path: str) -> Any:
        """Return the JSON that the mapper answers to a GET of ``path``."""
        return self._request(self._asking(path))

    def post(self, path: str, body: Mapping[str, object]) -> Any:
        """Return the JSON that the mapper answers to a POST of ``body``."""
        return self._request(self._asking(path, body=body))

    def download(self, path: str) -> bytes:
        """Return the bytes behind ``path``."""
        with urllib.request.urlopen(self._asking(path), timeout=60) as answer:
            content: bytes = answer.read()
        return content

    def wait_for(self, probe: Callable[[], _ValueT | None], *, what: str, timeout_s: float) -> _ValueT:
        """Call ``probe`` until it returns something true; a connection that is refused counts as not yet.

        Raises
        ------
        PartFailedError
            It did not in time, or one of the processes has ended.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            self.check_alive()
            with contextlib.suppress(urllib.error.URLError, ConnectionError, TimeoutError):
                value = probe()
                if value:
                    return value
            time.sleep(_POLL_S)
        raise PartFailedError(f"{what}: not after {timeout_s:g} s; the logs are in {self.settings.out}")

    def check_alive(self, *, may_end: Sequence[str] = ("simulator",)) -> None:
        """Raise ``PartFailedError`` with the end of its log where a process has ended that should run."""
        for name, process in self._processes.items():
            code = process.poll()
            if code is not None and (name not in may_end or code != 0):
                tail = (self.settings.out / f"{name}.log").read_text(errors="replace")[-2000:]
                raise PartFailedError(f"the {name} ended with exit status {code}; the end of its log:\n{tail}")

    def stop(self) -> None:
        """End all processes, the mapper first, and wait for them; kill what does not end."""
        for name in ("mapper", "gateway", "simulator"):
            process = self._processes.get(name)
            if process is None or process.poll() is not None:
                continue
            process.terminate()
            try:
                process.wait(_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self) -> None:
        settings = self.settings
        settings.out.mkdir(parents=True, exist_ok=True)
        self.bus_endpoint = f"tcp/127.0.0.1:{free_port()}"
        kind, question, options = settings.link.partition("?")
        link = "tcp:127.0.0.1:0" if kind == "tcp" else f"{kind}:{settings.out / 'radio'}{question}{options}"
        ready = settings.out / "simulator.ready"
        self.start_process("simulator", [
            "simulator", "serve", "--link", link, "--scenario", settings.scenario, "--preset", settings.preset,
            "--biobots", str(settings.n_biobots), "--seed", str(settings.seed), "--speed", str(settings.speed),
            "--duration", str(settings.dispersion_s + settings.exploration_s), "--drain-s", str(settings.drain_s),
            "--out", str(self.truth_directory), "--ready-file", str(ready), *settings.simulator_args,
        ])  # fmt: skip
        self.radio = self.wait_for(lambda: ready.read_text().strip() if ready.exists() else None, what="simulator ready", timeout_s=120)
        self.start_process("gateway", self.gateway_arguments())
        self.start_mapper()

    def start_mapper(self) -> None:
        """Start the mapper, for the first time or again, and wait until it serves."""
        settings = self.settings
        url_file, tokens = settings.out / "mapper.url", self.tokens
        url_file.unlink(missing_ok=True)
        if not self.token:
            self.token = add_token(tokens, name=OPERATOR, role=Role.OPERATOR).text
        self.start_process("mapper", [
            "mapper", "serve", "--connect", self.bus_endpoint, "--store", str(settings.out / "mapper.sqlite"),
            "--port", str(settings.http_port), "--url-file", str(url_file), "--tokens", str(tokens), *settings.mapper_args,
        ])  # fmt: skip
        self.url = self.wait_for(
            lambda: url_file.read_text().strip() if url_file.exists() else None, what="mapper ready", timeout_s=120
        ).rstrip("/")

    def _asking(self, path: str, *, body: Mapping[str, object] | None = None) -> urllib.request.Request:
        headers = {"Authorization": f"Bearer {self.token}"}
        if body is None:
            return urllib.request.Request(self.url + path, headers=headers)
        headers["Content-Type"] = "application/json"
        return urllib.request.Request(self.url + path, data=json.dumps(body).encode(), headers=headers, method="POST")

    def _request(self, request: urllib.request.Request) -> Any:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.loads(answer.read())


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONUNBUFFERED": "1"}
