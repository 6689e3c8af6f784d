"""How every Zenoh session of biobot is set up, as plain values (docs/zenoh.md says what was measured).

Pure: the caller has read the files it names, and opens the session. Gateways, mappers and the router share this, so that both ends of
a link agree on its timing.
"""

from collections.abc import Sequence
from typing import Annotated, Final

import msgspec

CLIENT: Final = "client"
"""For what is asked once, and for services that connect to one other: opening fails when nobody is there."""

ROUTER: Final = "router"
"""For services that others connect to: starts when nobody is there, connects later, for ever; relays, which peers do not (ADR 0016)."""

SECURE_PREFIXES: Final = ("tls/", "quic/")

LEASE_MS: Final = 2000
"""A link that is silent for so long is closed; Zenoh's own 10 s makes a cut link heal 9 s later (measured)."""

RETRY_MS: Final = {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 2}
"""Pause between two attempts: with an ``open_timeout_ms`` of 700, a healed link is found within 0.9 s."""

_MAX_PORT: Final = 65_535

_LINKS: Final = ("tcp", "tls", "quic", "udp", "ws", "unixsock-stream")
"""Kinds of link that the Zenoh library on PyPI has (measured, eclipse-zenoh 1.10)."""

_LINKS_WITH_PORTS: Final = frozenset(_LINKS) - {"unixsock-stream"}

_COMMON: Final[dict[str, object]] = {
    "scouting/multicast/enabled": False,
    # Implicit shared memory has lost messages to descheduled receivers (zenoh issue 2628) and gains nothing at these sizes.
    "transport/shared_memory/enabled": False,
    "timestamping/enabled": True,
    "transport/link/tx/lease": LEASE_MS,
    "connect/retry": RETRY_MS,
    "connect/exit_on_failure": False,
    "listen/timeout_ms": 0,
    "listen/exit_on_failure": True,
}


class TlsTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How ``tls/`` endpoints are secured (docs/zenoh.md); `biobot-gateway certs issue` prints this table.

    Keys
    ----
    ca
        Certificate of the authority whose certificates are believed.
    certificate, key
        What this service shows of itself, and the private key to it.
    verify_name
        Whether the host in an endpoint must be one that the other side's certificate names.
    """

    ca: str | None = None
    certificate: str | None = None
    key: str | None = None
    verify_name: bool = True

    @property
    def is_set(self) -> bool:
        """Say whether anything is secured."""
        return self.ca is not None


class ZenohTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How patient connections are (docs/zenoh.md, Timing).

    Keys
    ----
    open_timeout_ms
        An attempt to connect is given up after this. The kernel repeats a lost SYN after 1 s only, so a short one finds a healed link
        sooner; over a line with a round trip above 150 ms, as by satellite, TLS takes longer than 700 ms: 3000 or so is needed.
    """

    open_timeout_ms: Annotated[int, msgspec.Meta(ge=100, le=60_000)] = 700


def mode_of_service(*, listen: Sequence[str], connect: Sequence[str]) -> str:
    """Return the mode of a service's session: a client where it connects to one other and nobody connects to it (ADR 0016)."""
    return CLIENT if len(connect) == 1 and not listen else ROUTER


def tls_problems(tls: TlsTable, *, listen: Sequence[str], connect: Sequence[str]) -> list[str]:
    """Return what is missing between a TLS table and the endpoints, one line each."""
    problems = []
    if (tls.certificate is None) != (tls.key is None):
        have, lack = ("certificate", "key") if tls.key is None else ("key", "certificate")
        problems.append(f"tls.{have} is given, but tls.{lack} is not; a certificate is of no use without its private key: give both")
    if tls.certificate is not None and tls.ca is None:
        problems.append("tls.certificate is given, but tls.ca is not; name the certificate of the authority that the others are known by")
    if tls.ca is None:
        problems += [
            f"endpoint {endpoint!r} is secured, but tls.ca is not given; `biobot-gateway certs issue` makes what it needs"
            for endpoint in (*listen, *connect)
            if endpoint.startswith(SECURE_PREFIXES)
        ]
    if tls.ca is not None and tls.certificate is None:
        problems += [
            f"listening on {endpoint!r} needs tls.certificate and tls.key; `biobot-gateway certs issue` makes them"
            for endpoint in listen
            if endpoint.startswith(SECURE_PREFIXES)
        ]
    return problems


def endpoint_problem(endpoint: str, *, listens: bool) -> str | None:
    """Return what is wrong with an endpoint, or None. One that is listened on may have port 0, which takes a free one."""
    link, slash, address = endpoint.partition("/")
    if not slash or not address or link not in _LINKS:
        return f"endpoint {endpoint!r} must be LINK/ADDRESS with one of the links {', '.join(_LINKS)}, such as tcp/127.0.0.1:7447"
    if link not in _LINKS_WITH_PORTS:
        return None
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    least = 0 if listens else 1
    if not host or (":" in host and not (host.startswith("[") and host.endswith("]"))):
        return f"endpoint {endpoint!r} names no host and port; give {link}/HOST:PORT, such as {link}/127.0.0.1:7447 or {link}/[::1]:7447"
    if not (port.isascii() and port.isdecimal() and len(port) <= 5 and least <= int(port) <= _MAX_PORT):
        return f"endpoint {endpoint!r} has port {port!r}, but it must be {least} to {_MAX_PORT}, such as {link}/{host}:7447"
    return None


def host_and_port(endpoint: str) -> tuple[str, int] | None:
    """Return where a ``tcp/`` or ``tls/`` endpoint is, or None for another kind."""
    protocol, _, rest = endpoint.partition("/")
    host, _, port = rest.partition("#")[0].partition("?")[0].rpartition(":")
    if protocol not in {"tcp", "tls"} or not host or not (port.isascii() and port.isdecimal()) or int(port) > _MAX_PORT:
        return None
    return host.removeprefix("[").removesuffix("]"), int(port)


def session_settings(
    *, mode: str, listen: Sequence[str], connect: Sequence[str], tls: TlsTable, timing: ZenohTable | None = None, timeout_ms: int = -1
) -> dict[str, object]:
    """Return Zenoh's configuration keys and values for one session.

    Parameters
    ----------
    mode
        `CLIENT` or `ROUTER`.
    timing
        None: as it is by default.
    timeout_ms
        How long a client waits for a router before opening fails; -1: for ever. A router never waits.
    """
    settings = {
        **_COMMON,
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": timeout_ms,
        "transport/unicast/open_timeout": (timing or ZenohTable()).open_timeout_ms,
    }
    if tls.ca is not None:
        settings["transport/link/tls/root_ca_certificate"] = tls.ca
        settings["transport/link/tls/verify_name_on_connect"] = tls.verify_name
        settings["transport/link/tls/close_link_on_expiration"] = True
    if tls.certificate is not None:
        for side in ("listen", "connect"):
            settings[f"transport/link/tls/{side}_certificate"] = tls.certificate
            settings[f"transport/link/tls/{side}_private_key"] = tls.key
        # Without it neither side shows its own certificate as a client nor asks for one as a server.
        settings["transport/link/tls/enable_mtls"] = True
    return settings
