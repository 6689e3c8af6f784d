"""Zenoh sessions of the gateway package, and the watch over who is connected to them (CONTRACT.md, docs/zenoh.md)."""

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import zenoh

from firmware_protocol.contract.handshakes import CertificateFacts
from firmware_protocol.contract.sessions import CLIENT, ROUTER, TlsTable, ZenohTable, session_settings
from gateway.connecting import diagnose_all, why_not_listening
from gateway.errors import BusError
from gateway.health import Health
from gateway.log import EventLog
from gateway.tls_files import EXPIRES_SOON_DAYS, days_left

_log = EventLog(__name__)

_CLIENT_TIMEOUT_MS: Final = 3000
_LOOK_EVERY_S: Final = 0.2
_PATIENCE_S: Final = 1.5
"""Nobody is connected for so long before the reason is looked for."""

_ASK_AGAIN_S: Final = 5.0
_CERTIFICATE_EVERY_S: Final = 86_400.0


def open_service(
    *,
    listen: Sequence[str],
    connect: Sequence[str],
    tls: TlsTable,
    timing: ZenohTable | None = None,
    access: Mapping[str, object] | None = None,
) -> zenoh.Session:
    """Open the session of a service; whom it connects to is waited for in the background, for ever.

    Raises
    ------
    BusError
        An endpoint cannot be listened on, or is none.
    """
    settings = session_settings(mode=ROUTER, listen=listen, connect=connect, tls=tls, timing=timing)
    if access is not None:
        settings["access_control"] = dict(access)
    try:
        return zenoh.open(_config_of(settings))
    except zenoh.ZError as error:
        reasons = "; ".join(f"{endpoint}: {reason}" for endpoint in listen if (reason := why_not_listening(endpoint)))
        where = f"listen on {', '.join(listen) or 'nothing'} and connect to {', '.join(connect) or 'nobody'}"
        raise BusError(f"cannot listen on {reasons}" if reasons else f"Zenoh cannot {where}: {first_sentence(error)}") from error


def open_client(*, connect: Sequence[str], tls: TlsTable, timing: ZenohTable | None = None) -> zenoh.Session:
    """Open a session that asks something once.

    Raises
    ------
    BusError
        Nobody can be connected to within 3 s, or one attempt where that takes longer; it says why for each endpoint.
    """
    timeout_ms = max(_CLIENT_TIMEOUT_MS, 0 if timing is None else timing.open_timeout_ms)
    settings = session_settings(mode=CLIENT, listen=(), connect=connect, tls=tls, timing=timing, timeout_ms=timeout_ms)
    try:
        settings["connect/exit_on_failure"] = True
        return zenoh.open(_config_of(settings))
    except zenoh.ZError as error:
        reasons = "; ".join(f"{endpoint}: {reason}" for endpoint, reason in diagnose_all(connect, tls).items())
        raise BusError(f"cannot connect: {reasons or first_sentence(error)}") from error


def try_client(*, connect: Sequence[str], tls: TlsTable, timing: ZenohTable | None = None) -> zenoh.Session | None:
    """Try once to open a client's session; None: nobody could be connected to."""
    timeout_ms = (timing or ZenohTable()).open_timeout_ms
    settings = session_settings(mode=CLIENT, listen=(), connect=connect, tls=tls, timing=timing, timeout_ms=timeout_ms)
    try:
        return zenoh.open(_config_of(settings))
    except zenoh.ZError:
        return None  # why, `ConnectionWatch` says


def first_sentence(error: zenoh.ZError) -> str:
    """Return what Zenoh says without the places in its own source that it appends."""
    return str(error).split(" at /", maxsplit=1)[0]


class ConnectionWatch:
    """Looks who is connected, and says once why nobody is, and once when somebody is again.

    Levels in `Health`: ``bus.connections``, and ``tls.days_left`` where there is a certificate. `missing` is for status views.
    """

    def __init__(
        self,
        *,
        n_links: Callable[[], int],
        connect: Sequence[str],
        tls: TlsTable,
        facts: CertificateFacts | None,
        health: Health,
        patience_s: float = _PATIENCE_S,
        ask_again_s: float = _ASK_AGAIN_S,
    ) -> None:
        self._n_links = n_links
        self._connect = tuple(connect)
        self._tls = tls
        self._facts = facts
        self._health = health
        self._patience_s, self._ask_again_s = patience_s, ask_again_s
        self._closing = threading.Event()
        self._reasons: dict[str, str] = {}
        self._n_connected = 0
        self._thread = threading.Thread(target=self._run, name="connections", daemon=True)
        self._thread.start()

    @property
    def missing(self) -> str | None:
        """Say why nobody is connected who should be, or None."""
        return "; ".join(f"{endpoint}: {reason}" for endpoint, reason in self._reasons.items()) or None

    def close(self) -> None:
        """Stop looking; call it before the session is closed."""
        self._closing.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        alone_since_s = time.monotonic()
        asked_s = certificate_s = float("-inf")
        while not self._closing.wait(_LOOK_EVERY_S):
            now_s = time.monotonic()
            if now_s - certificate_s >= _CERTIFICATE_EVERY_S:
                certificate_s = now_s
                self._look_at_certificate()
            n_connected = self._n_links()
            self._health.set_level("bus.connections", n_connected)
            if n_connected or not self._connect:
                alone_since_s = now_s
                self._say_connected(n_connected)
            elif now_s - alone_since_s >= self._patience_s and now_s - asked_s >= self._ask_again_s:
                self._say_alone(diagnose_all(self._connect, self._tls))
                asked_s = time.monotonic()

    def _say_connected(self, n_connected: int) -> None:
        # Who connects to nobody has nothing to find: others come to it for a moment, again and again.
        if n_connected and self._connect and (self._reasons or not self._n_connected):
            _log.info("bus.connected", n=n_connected)
        self._reasons, self._n_connected = {}, n_connected

    def _say_alone(self, reasons: dict[str, str]) -> None:
        if self._n_links():
            return  # somebody came while the reasons were looked for
        self._health.count("bus.unconnected_looks")
        for endpoint, reason in reasons.items():
            if self._reasons.get(endpoint) != reason:
                _log.warning("bus.unconnected", endpoint=endpoint, reason=reason)
        self._reasons, self._n_connected = reasons, 0

    def _look_at_certificate(self) -> None:
        if self._facts is None:
            return
        days = days_left(self._facts)
        self._health.set_level("tls.days_left", int(days))
        if days < EXPIRES_SOON_DAYS:
            say = _log.warning if days > 0 else _log.error
            say("tls.expiring", certificate=self._tls.certificate, days=round(days, 1), advice="biobot-gateway certs issue --renew")


def _config_of(settings: Mapping[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
