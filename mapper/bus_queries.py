"""Questions to gateways over Zenoh: asked on the session that there is, answered into the event loop."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import zenoh

from mapper.bus_standing import StandingSession
from mapper.errors import QueryError

# Zenoh answers a query that nobody ends with this error (measured, eclipse-zenoh 1.10).
_TIMEOUT_PAYLOAD: Final = b"Timeout"
_DEADLINE_SLACK_S: Final = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """A question that is on its way; ``replies`` ends with None."""

    key: str
    timeout_s: float
    asked: asyncio.Future[None]
    replies: asyncio.Queue[zenoh.Reply | None]


class Queries:
    """Asks on a session that may not be there."""

    def __init__(self, session: StandingSession, *, loop: asyncio.AbstractEventLoop) -> None:
        self._session = session
        self._loop = loop

    def begin(self, key: str, payload: bytes, *, timeout_s: float, is_command: bool = False) -> Query:
        """Ask all who answer under a key; a command leaves at once, ahead of all else."""
        replies: asyncio.Queue[zenoh.Reply | None] = asyncio.Queue()

        def hand_over(reply: zenoh.Reply | None) -> None:
            with suppress(RuntimeError):  # the loop is closed: nobody waits any more
                self._loop.call_soon_threadsafe(replies.put_nowait, reply)

        def ask() -> None:
            session = self._session.current
            if session is None or not session.info.transports():
                hand_over(None)  # nobody is there; a client would wait until the query's time is over
                return
            session.get(
                key,
                zenoh.handlers.Callback(hand_over, drop=lambda: hand_over(None)),
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.DROP if is_command else zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.REAL_TIME if is_command else zenoh.Priority.DATA,
                express=is_command,
            )

        if not is_command:
            return Query(key=key, timeout_s=timeout_s, asked=self._loop.run_in_executor(None, ask), replies=replies)
        asked = self._loop.create_future()
        try:
            ask()
        except zenoh.ZError as error:
            asked.set_exception(error)
        else:
            asked.set_result(None)
        return Query(key=key, timeout_s=timeout_s, asked=asked, replies=replies)

    async def replies(self, query: Query) -> AsyncGenerator[bytes | QueryError, None]:
        """Yield what is answered, and an error for each that refuses, or for no end within the time."""
        try:
            async with asyncio.timeout(query.timeout_s + _DEADLINE_SLACK_S):
                await query.asked
                while (reply := await query.replies.get()) is not None:
                    if reply.ok is not None:
                        yield reply.ok.payload.to_bytes()
                    elif reply.err is not None:
                        yield _query_error(query.key, reply.err.payload.to_bytes(), timeout_s=query.timeout_s)
        except TimeoutError:
            yield _query_error(query.key, _TIMEOUT_PAYLOAD, timeout_s=query.timeout_s)
        except zenoh.ZError as error:
            yield QueryError(key=query.key, reason=first_sentence(error), is_timeout=False)


def _query_error(key: str, payload: bytes, *, timeout_s: float) -> QueryError:
    if payload == _TIMEOUT_PAYLOAD:
        return QueryError(key=key, reason=f"no end of the answer within {timeout_s:g} s", is_timeout=True)
    return QueryError(key=key, reason=payload.decode(errors="replace"), is_timeout=False)


def first_sentence(error: zenoh.ZError) -> str:
    """Return what Zenoh says, without the places in its own source that it appends."""
    return str(error).split(" at /", maxsplit=1)[0]
