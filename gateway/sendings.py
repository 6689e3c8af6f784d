"""Payloads on their way down a radio, from ``send`` until it is known what became of them."""

import asyncio
from dataclasses import dataclass

from gateway.health import Health
from gateway.radio import RadioOutcome


@dataclass(slots=True)
class _Sending:
    future: asyncio.Future[RadioOutcome]
    deadline_ns: int


class Sendings:
    """Futures of payloads by ticket, in the order of their deadlines; each is settled once, and counted."""

    def __init__(self, *, health: Health) -> None:
        self._health = health
        self._waiting: dict[int, _Sending] = {}

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._waiting)

    @property
    def next_deadline_ns(self) -> int | None:
        """When the first of them is overdue."""
        return next(iter(self._waiting.values())).deadline_ns if self._waiting else None

    def add(self, ticket: int, *, deadline_ns: int) -> "asyncio.Future[RadioOutcome]":
        """Return the future of a payload; no deadline is before that of an earlier one."""
        future: asyncio.Future[RadioOutcome] = asyncio.get_running_loop().create_future()
        self._waiting[ticket] = _Sending(future, deadline_ns)
        return future

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
        for ticket in list(self._waiting):
            self.settle(ticket, outcome)
