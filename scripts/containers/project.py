"""A compose project that runs: its containers, what their health checks say, and whether they are as shut in as their file promises."""

import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from scripts.containers.podman import CheckFailedError, Podman

UID = "10001"
_PAUSE_S = 1.0
_T = TypeVar("_T")

_SHUT_IN = {
    "user": ("id -u", UID),
    "root file system": ("touch /probe 2>/dev/null && echo writable || echo read-only", "read-only"),
    "capabilities": ("sed -n 's/^CapEff:\\t*//p' /proc/1/status", "0000000000000000"),
    "new privileges": ("sed -n 's/^NoNewPrivs:\\t*//p' /proc/1/status", "1"),
    "compilers and installers": ("ls /usr/bin/gcc /usr/bin/cc /usr/bin/make /opt/biobot/bin/pip /usr/bin/pip3 2>/dev/null | wc -l", "0"),
}
"""What is asked inside of each container, and what must come out."""


@dataclass(slots=True, kw_only=True)
class Project:
    """Services of compose files; up within the context, and taken down with their volumes at its end."""

    podman: Podman
    name: str
    files: Sequence[Path]
    services: Sequence[str]
    variables: Mapping[str, str] = field(default_factory=dict)

    def __enter__(self) -> Self:
        self.down()
        try:
            self.compose("up", "--detach", "--no-build", *self.services)
        except BaseException:
            self.down()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if error is not None:
            self._keep_logs()
        self.down()

    def compose(self, *command: str) -> str:
        """Run podman-compose on this project."""
        return self.podman.compose(self.files, *command, project=self.name, variables=self.variables)

    def down(self) -> None:
        """Take containers, volumes and network away."""
        self.compose("down", "--volumes", "--timeout", "20")

    def container(self, service: str) -> str:
        """Return the name of a service's container."""
        return f"{self.name}_{service}_1"

    def inside(self, service: str, *command: str) -> str:
        """Run a command in the container of a service; return what it prints."""
        return self.podman.run("exec", self.container(service), *command)

    def wait_healthy(self, service: str, *, timeout_s: float = 120) -> float:
        """Run the health check until it passes; return after how long [s]. podman runs none by itself where there is no systemd."""
        started = time.monotonic()

        def check() -> bool | None:
            return True if self.is_healthy(service) else None

        until(check, what=f"the health check of {service}", timeout_s=timeout_s, explain=lambda: self.logs(service))
        return time.monotonic() - started

    def is_healthy(self, service: str) -> bool:
        """Run the health check of a service once."""
        return self.podman.attempt("healthcheck", "run", self.container(service)).returncode == 0

    def check_shut_in(self, service: str) -> None:
        """See from inside that user, root file system and rights are what they should be."""
        for what, (command, wanted) in _SHUT_IN.items():
            found = self.inside(service, "sh", "-c", command)
            if found != wanted:
                raise CheckFailedError(f"{service}: {what}: {found!r} in place of {wanted!r}")

    def check_notices_a_hang(self, service: str) -> None:
        """Stop the first process of a service where it stands: its health check must fail, and pass again when it goes on."""
        self.podman.run("kill", "--signal", "STOP", self.container(service))
        was_healthy = self.is_healthy(service)
        self.podman.run("kill", "--signal", "CONT", self.container(service))
        if was_healthy:
            raise CheckFailedError(f"{service}: its process stands still, and its health check passes")
        self.wait_healthy(service)

    def logs(self, service: str) -> str:
        """Return the end of what a service has said."""
        done = self.podman.attempt("logs", "--tail", "20", self.container(service))
        return (done.stdout + done.stderr).strip()

    def _keep_logs(self) -> None:
        for service in self.services:
            done = self.podman.attempt("logs", self.container(service))
            (self.podman.home / f"{self.name}-{service}.log").write_text(done.stdout + done.stderr, encoding="utf-8")


def until(probe: Callable[[], _T | None], *, what: str, timeout_s: float, explain: Callable[[], str] = str) -> _T:
    """Ask again and again, a second apart, until a probe returns something; ``explain`` is added to the error where it never does."""
    deadline_s = time.monotonic() + timeout_s
    while (found := probe()) is None:
        if time.monotonic() > deadline_s:
            raise CheckFailedError(f"{what}: not within {timeout_s:g} s\n{explain()}")
        time.sleep(_PAUSE_S)
    return found


def fetch(url: str, *, token: str | None = None, method: str = "GET", ca: Path | None = None) -> tuple[int, bytes]:
    """Ask over HTTP; return status and body, status 0 where nobody answers. ``ca`` is the authority to believe over https."""
    request = urllib.request.Request(url, method=method, headers={"Authorization": f"Bearer {token}"} if token else {})  # noqa: S310
    context = None if ca is None else ssl.create_default_context(cafile=str(ca))
    try:
        with urllib.request.urlopen(request, timeout=20, context=context) as answer:  # noqa: S310  # the addresses are those of services started here
            return int(answer.status), bytes(answer.read())
    except urllib.error.HTTPError as error:
        return error.code, error.read()
    except OSError as error:
        return 0, str(error).encode()
