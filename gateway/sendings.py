"""Payloads on their way down a radio, from ``send`` until it is known what became of them."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from firmware_protocol.units import ShortAddress
from gateway.errors import RadioUnavailableError
from gateway.health import Health
from gateway.radio import RadioOutcome


@dataclass(slots=True)
class _Sending:
    future: asyncio.Future[RadioOutcome]
    deadline_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedSending:
    """A payload that is made when the port takes it: ``make`` gets that instant of the monotonic clock [ns]."""

    destination: ShortAddress
    make: Callable[[int], bytes]
    future: asyncio.Future[RadioOutcome]

    def follow(self, outcome: "asyncio.Future[RadioOutcome]") -> None:
        """Tell what became of the payload, now that it was made, when that is known."""
        outcome.add_done_callback(lambda done: self.settle(done.result()))

    def settle(self, outcome: RadioOutcome) -> None:
        """Tell what became of it."""
        if not self.future.done():
            self.future.set_result(outcome)


class Sendings:
    """Futures of payloads by ticket, in the order of their deadlines; each is settled once, and counted.

    At most one timed payload waits beside them for the port.
    """

    def __init__(self, *, health: Health) -> None:
        self._health = health
        self._waiting: dict[int, _Sending] = {}
        self._timed: TimedSending | None = None

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._waiting)

    @property
    def next_deadline_ns(self) -> int | None:
        """When the first of them is overdue."""
        return next(iter(self._waiting.values())).deadline_ns if self._waiting else None

    @property
    def has_timed(self) -> bool:
        """Whether a timed payload waits for the port."""
        return self._timed is not None

    def add(self, ticket: int, *, deadline_ns: int) -> "asyncio.Future[RadioOutcome]":
        """Return the future of a payload; no deadline is before that of an earlier one."""
        future: asyncio.Future[RadioOutcome] = asyncio.get_running_loop().create_future()
        self._waiting[ticket] = _Sending(future, deadline_ns)
        return future

    def hold_timed(self, *, destination: ShortAddress, make: Callable[[int], bytes], radio: str) -> "asyncio.Future[RadioOutcome]":
        """Keep a timed payload until ``take_timed``; return its future.

        Raises
        ------
        RadioUnavailableError
            Another one waits.
        """
        if self._timed is not None:
            raise RadioUnavailableError(radio=radio, reason="another timed payload waits for it")
        future: asyncio.Future[RadioOutcome] = asyncio.get_running_loop().create_future()
        self._timed = TimedSending(destination=destination, make=make, future=future)
        return future

    def take_timed(self) -> TimedSending | None:
        """Return the timed payload that waits; it waits no more."""
        timed, self._timed = self._timed, None
        return timed

    def ticket_of(self, future: "asyncio.Future[RadioOutcome]") -> int | None:
        """Return the ticket of a payload that waits, by its future."""
        return next((ticket for ticket, sending in self._waiting.items() if sending.future is future), None)

    def drop_timed(self, future: "asyncio.Future[RadioOutcome]", outcome: RadioOutcome) -> bool:
        """Make no payload of the timed one that waits, if it has this future; return whether it has."""
        if self._timed is None or self._timed.future is not future:
            return False
        self._timed = None
        future.set_result(outcome)
        return True

    def overdue(self, *, now_ns: int) -> list[int]:
        """Return the tickets whose deadline has passed."""
        tickets = []
        for ticket, sending in self._waiting.items():
            if sending.deadline_ns > now_ns:
                break
            tickets.append(ticket)
        return tickets

    def settle(self, ticket: int, outcome: RadioOutcome) -> None:
        """Tell what became of a payload."""
        sending = self._waiting.pop(ticket, None)
        if sending is None:
            self._health.count("radio.unexpected_confirms")
            return
        self._health.count(f"radio.{outcome.fate.value}")
        if not sending.future.done():
            sending.future.set_result(outcome)

    def settle_all(self, outcome: RadioOutcome) -> None:
        """Tell the same of all that wait."""
        if (timed := self.take_timed()) is not None:
            timed.settle(outcome)
        for ticket in list(self._waiting):
            self.settle(ticket, outcome)
