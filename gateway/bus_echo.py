"""Whether a client of Zenoh is heard through its router: asked by another session of the same process, both ways.

After a router stood still for longer than the lease, it may leave a client connected and deaf or mute for good (eclipse-zenoh 1.10.2,
ADR 0028), of which the client itself sees nothing.
"""

import threading
from collections.abc import Callable
from typing import Any, Final

import zenoh

_TIMEOUT_S: Final = 1.5


def answer_echo(session: zenoh.Session, key: str) -> list[Any]:
    """Answer what is asked under a key, and what is published there; what is returned stands as long as it is kept."""

    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(key, b"")

    def answer(_sample: zenoh.Sample) -> None:
        session.put(f"{key}/answer", b"", congestion_control=zenoh.CongestionControl.DROP, express=True)

    return [session.declare_queryable(key, reply), session.declare_subscriber(f"{key}/ask", answer)]


def is_heard(key: str, *, open_session: Callable[[], zenoh.Session | None]) -> bool | None:
    """Ask through another session, which is closed then; None: none could be opened. Takes up to some seconds."""
    session = open_session()
    if session is None:
        return None
    try:
        with session:
            heard = threading.Event()
            subscriber = session.declare_subscriber(f"{key}/answer", lambda _sample: heard.set())
            is_answered = any(reply.ok is not None for reply in session.get(key, timeout=_TIMEOUT_S))
            session.put(f"{key}/ask", b"")
            is_echoed = heard.wait(_TIMEOUT_S)
            subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
            return is_answered and is_echoed
    except zenoh.ZError:
        return None
