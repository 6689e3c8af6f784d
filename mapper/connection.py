"""Says once why no gateway or router is connected, and once when one is again."""

import asyncio
import socket
import ssl
import time
from collections.abc import Callable
from typing import Final

from firmware_protocol.contract.handshakes import CertificateFacts, Handshake, explain, no_such_host
from firmware_protocol.contract.sessions import SECURE_PREFIXES, TlsTable, endpoint_problem, host_and_port
from mapper.log import EventLog
from mapper.tls_files import EXPIRES_SOON_DAYS, client_context

_log = EventLog(__name__)

_LOOK_EVERY_S: Final = 0.5
_PATIENCE_S: Final = 1.5
"""Nobody is connected for so long before the reason is looked for."""

_ASK_AGAIN_S: Final = 5.0
_CONNECT_S: Final = 2.0
_ALERT_S: Final = 0.7
"""A server that refuses the client's certificate says so within this after the handshake."""

_CERTIFICATE_EVERY_S: Final = 86_400.0
_ACCEPTED: Final = "it accepts the connection, but no Zenoh session came about; does a router or gateway listen there?"


class ConnectionWatch:
    """Looks whether the bus is connected. `missing` says why it is not, endpoint by endpoint, or is None."""

    def __init__(
        self, *, is_connected: Callable[[], bool], connect: tuple[str, ...], tls: TlsTable, facts: CertificateFacts | None
    ) -> None:
        self._is_connected = is_connected
        self._connect = connect
        self._tls = tls
        self._facts = facts
        self._reasons: dict[str, str] = {}

    @property
    def missing(self) -> str | None:
        """Say why nobody is connected who should be, or None."""
        return "; ".join(f"{endpoint}: {reason}" for endpoint, reason in self._reasons.items()) or None

    async def run(self) -> None:
        """Look until cancelled."""
        alone_since_s = time.monotonic()
        asked_s = certificate_s = float("-inf")
        was_connected = False
        while True:
            now_s = time.monotonic()
            if now_s - certificate_s >= _CERTIFICATE_EVERY_S:
                certificate_s = now_s
                self._look_at_certificate()
            is_connected = self._is_connected()
            if is_connected or not self._connect:
                alone_since_s = now_s
                if is_connected and (self._reasons or not was_connected):
                    _log.info("bus.connected")
                self._reasons = {}
            elif now_s - alone_since_s >= _PATIENCE_S and now_s - asked_s >= _ASK_AGAIN_S:
                await self._say_alone()
                asked_s = time.monotonic()
            was_connected = is_connected
            await asyncio.sleep(_LOOK_EVERY_S)

    async def _say_alone(self) -> None:
        reasons = {endpoint: await diagnose(endpoint, self._tls) for endpoint in self._connect}
        if self._is_connected():
            return  # somebody came while the reasons were looked for
        for endpoint, reason in reasons.items():
            if self._reasons.get(endpoint) != reason:
                _log.warning("bus.unconnected", endpoint=endpoint, reason=reason)
        self._reasons = reasons

    def _look_at_certificate(self) -> None:
        if self._facts is None:
            return
        days = self._facts.days_left(now_ns=time.time_ns())
        if days < EXPIRES_SOON_DAYS:
            say = _log.warning if days > 0 else _log.error
            say("tls.expiring", certificate=self._tls.certificate, days=round(days, 1), advice="biobot-gateway certs issue --renew")


async def diagnose(endpoint: str, tls: TlsTable) -> str:
    """Return why a session with an endpoint does not come about; takes up to 3 s and never raises."""
    address = host_and_port(endpoint)
    if address is None:
        return endpoint_problem(endpoint, listens=False) or "only tcp/ and tls/ endpoints can be tried by hand; see the other side's log"
    try:
        async with asyncio.timeout(_CONNECT_S):
            reader, writer = await asyncio.open_connection(*address)
    except ConnectionRefusedError:
        return "nobody listens there; is the router or gateway running, and the port right?"
    except TimeoutError:
        return f"no answer within {_CONNECT_S:g} s; is the machine on, and the network there?"
    except socket.gaierror:
        return no_such_host(address[0])
    except OSError as error:
        return f"cannot be reached: {(error.strerror or str(error)).lower()}"
    try:
        return await _shake_hands(reader, writer, host=address[0], tls=tls) if endpoint.startswith(SECURE_PREFIXES) else _ACCEPTED
    except ssl.SSLError as error:
        return explain(error)
    except OSError as error:
        return f"the connection broke: {(error.strerror or str(error)).lower()}"
    finally:
        writer.close()


async def _shake_hands(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, host: str, tls: TlsTable) -> str:
    handshake = Handshake(client_context(tls), host=host)
    received = b""
    deadline_s = time.monotonic() + _CONNECT_S
    while time.monotonic() < deadline_s:
        writer.write(handshake.step(received))
        try:
            async with asyncio.timeout(_ALERT_S if handshake.is_done else _CONNECT_S):
                received = await reader.read(65_536)
        except TimeoutError:
            return _ACCEPTED if handshake.is_done else "it does not answer to TLS; is it tcp/ there?"
        if not received:
            return "the other side hung up after the handshake" if handshake.is_done else "the other side hung up; is it tcp/ there?"
    return _ACCEPTED
