"""What every query that comes in over Zenoh has: a payload to read, and a way to say no."""

import zenoh

from gateway.health import Health


def payload_of(query: zenoh.Query) -> bytes:
    """Return the payload of a query, empty where it has none."""
    return b"" if query.payload is None else query.payload.to_bytes()


def refuse(query: zenoh.Query, reason: str, *, health: Health) -> None:
    """Answer a query with an error, and end it."""
    health.count("bus.refused_queries")
    with query:
        query.reply_err(reason.encode())
