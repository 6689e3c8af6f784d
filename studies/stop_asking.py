"""Asks for stops as an operator's programs do: over Zenoh in one session, and over REST."""

import http.client
import json
import threading
import time
import uuid
from dataclasses import dataclass
from typing import Any, Final, Self
from urllib.parse import urlsplit

from firmware_protocol.contract.commands import StimulationAction, StimulationRequest
from firmware_protocol.contract.keys import Stream, build_key
from firmware_protocol.contract.records import encode_record
from firmware_protocol.contract.sessions import TlsTable
from firmware_protocol.units import EVERYBODY, Nanoseconds, NodeId
from gateway.bus_client import find_gateway
from gateway.bus_session import open_client

_SITE: Final = "local"
_OPERATOR: Final = "bench"
_TIMEOUT_S: Final = 10.0


@dataclass(slots=True)
class Answered:
    """When the first answer to a request came [ns, monotonic]; None: none yet."""

    first_ns: int | None = None


class ZenohAsker:
    """See the module."""

    def __init__(self, endpoint: str) -> None:
        self._session: Any = open_client(connect=(endpoint,), tls=TlsTable())
        name = find_gateway(self._session, site=_SITE, gateway=None, connect=(endpoint,))
        self._key = build_key(site=_SITE, stream=Stream.COMMAND, gateway=name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def ask(self, node: int, action: StimulationAction) -> Answered:
        """Ask, and return at once."""
        answered = Answered()
        request = StimulationRequest(
            command_id=f"bench-{uuid.uuid4().hex}",
            node=EVERYBODY if action is StimulationAction.STOP_ALL else NodeId(node),
            action=action,
            operator=_OPERATOR,
            issued_wall_ns=Nanoseconds(time.time_ns()),
        )

        def hear(_: object) -> None:
            answered.first_ns = answered.first_ns or time.monotonic_ns()

        self._session.get(self._key, hear, payload=encode_record(request), timeout=_TIMEOUT_S)
        return answered


class RestAsker:
    """See the module; each request has a connection of its own, and making it is part of what is measured."""

    def __init__(self, url: str, *, token: str) -> None:
        self._place = urlsplit(url)
        self._headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}

    def ask(self, node: int, action: StimulationAction) -> Answered:
        """Ask in a thread, and return at once."""
        answered = Answered()
        threading.Thread(target=self._ask, args=(node, action, answered), daemon=True).start()
        return answered

    def _ask(self, node: int, action: StimulationAction, answered: Answered) -> None:
        body = json.dumps({"biobot": node, "action": action.value})
        connection = http.client.HTTPConnection(self._place.hostname or "", self._place.port, timeout=_TIMEOUT_S)
        try:
            connection.request("POST", "/api/v1/commands", body=body, headers=self._headers)
            connection.getresponse().read()
            answered.first_ns = time.monotonic_ns()
        except (OSError, http.client.HTTPException):
            pass  # the frame tells whether it was heard
        finally:
            connection.close()
