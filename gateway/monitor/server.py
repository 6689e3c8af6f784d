"""Answers /metrics, /healthz and /readyz on a thread of its own, so that it neither holds up the gateway nor hangs with it.

A plain ASGI application behind uvicorn. Connections are few and short; what is asked for beyond them is refused.
"""

import json
import socket
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from http import HTTPStatus
from importlib.metadata import version
from typing import Any, Self

import uvicorn

from gateway.errors import MonitorError
from gateway.log import EventLog
from gateway.monitor.exposition import CONTENT_TYPE, expose, make_registry
from gateway.vitals import Vitals

_log = EventLog(__name__)

_MAX_CONNECTIONS = 32
_KEEP_ALIVE_S = 5
_GRACEFUL_S = 1
_JOIN_S = 3.0

_Message = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[_Message]]
_Send = Callable[[_Message], Awaitable[None]]


class Monitor:
    """The running monitor; made by ``start``, ended by ``close``."""

    def __init__(self, *, listener: socket.socket, vitals: Vitals) -> None:
        host, port = listener.getsockname()[:2]
        self.url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
        config = uvicorn.Config(
            MonitorApp(vitals),
            http="h11",
            ws="none",
            loop="asyncio",
            lifespan="off",
            log_config=None,
            log_level="warning",
            access_log=False,
            server_header=False,
            limit_concurrency=_MAX_CONNECTIONS,
            timeout_keep_alive=_KEEP_ALIVE_S,
            timeout_graceful_shutdown=_GRACEFUL_S,
        )
        self._server = uvicorn.Server(config)
        self._listener = listener
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [listener]}, name="monitor", daemon=True)

    @classmethod
    def start(cls, *, host: str, port: int, vitals: Vitals) -> Self:
        """Answer at an address from now on; port 0 takes a free one.

        Raises
        ------
        MonitorError
            The address is none of this machine, or in use.
        """
        monitor = cls(listener=_listen(host, port), vitals=vitals)
        monitor._thread.start()
        _log.info("monitor.up", url=monitor.url)
        return monitor

    def close(self) -> None:
        """Finish what is being answered, and end."""
        self._server.should_exit = True
        self._thread.join(timeout=_JOIN_S)
        self._listener.close()


class MonitorApp:
    """The ASGI application."""

    def __init__(self, vitals: Vitals) -> None:
        self._vitals = vitals
        self._registry = make_registry(vitals)

    async def __call__(self, scope: _Message, receive: _Receive, send: _Send) -> None:
        """Answer one request; its body is not read."""
        del receive
        if scope["type"] != "http":
            return
        status, content_type, body = self._answer(scope["method"], scope["path"])
        headers = [(b"content-type", content_type.encode()), (b"content-length", str(len(body)).encode()), (b"cache-control", b"no-store")]
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            headers.append((b"allow", b"GET, HEAD"))
        await send({"type": "http.response.start", "status": int(status), "headers": headers})
        await send({"type": "http.response.body", "body": b"" if scope["method"] == "HEAD" else body})

    def _answer(self, method: str, path: str) -> tuple[HTTPStatus, str, bytes]:
        if method not in {"GET", "HEAD"}:
            return _problem(HTTPStatus.METHOD_NOT_ALLOWED, f"{method} is not answered here; only GET and HEAD are")
        match path:
            case "/metrics":
                return HTTPStatus.OK, CONTENT_TYPE, expose(self._registry)
            case "/healthz":
                faults = self._vitals.faults()
                return _told(
                    faults,
                    {
                        "status": "faulty" if faults else "ok",
                        "software": version("biobot-gateway"),
                        "faults": faults,
                        "warnings": self._vitals.warnings(),
                    },
                )
            case "/readyz":
                missing = [*self._vitals.faults(), *self._vitals.missing()]
                return _told(missing, {"is_ready": not missing, "missing": missing})
        return _problem(HTTPStatus.NOT_FOUND, f"there is no {path}; ask for /metrics, /healthz or /readyz")


def _told(wrong: list[str], document: dict[str, object]) -> tuple[HTTPStatus, str, bytes]:
    status = HTTPStatus.SERVICE_UNAVAILABLE if wrong else HTTPStatus.OK
    return status, "application/json", json.dumps(document).encode() + b"\n"


def _problem(status: HTTPStatus, detail: str) -> tuple[HTTPStatus, str, bytes]:
    return (
        status,
        "application/problem+json",
        json.dumps({"status": int(status), "title": status.phrase, "detail": detail}).encode() + b"\n",
    )


def _listen(host: str, port: int) -> socket.socket:
    address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    try:
        family, _, _, _, target = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except OSError as error:
        reason = f"{host!r} is no address of this machine ({error})"
        raise MonitorError(address=address, reason=reason, next_step="correct monitor.listen") from error
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(target)
        listener.listen(_MAX_CONNECTIONS)
    except OSError as error:
        listener.close()
        raise MonitorError(
            address=address,
            reason=(error.strerror or str(error)).lower(),
            next_step="give monitor.listen another port, or 0 for a free one; the log says which",
        ) from error
    return listener
