"""What is wrong with one radio, from its first failure until it is up: told when it begins and when it is over, counted in between."""

import time
from collections.abc import Callable

from firmware_protocol.units import NS_PER_S
from gateway.health import Health, RadioState
from gateway.log import EventLog

_log = EventLog(__name__)

OnState = Callable[[str, RadioState, str], None]
"""Is told a radio's name, where it stands now, and why, or for how long it was down."""


class Outage:
    """See the module. A radio that has not been up yet is connecting, and its first failure begins an outage."""

    def __init__(self, *, radio: str, health: Health, on_state: OnState | None = None) -> None:
        self._radio = radio
        self._health = health
        self._on_state = on_state
        self._since_ns: int | None = None
        self._reason = ""
        self._n_attempts = 0
        self._told: set[str] = set()
        health.set_radio(radio, RadioState.CONNECTING)

    @property
    def is_on(self) -> bool:
        """The radio is down."""
        return self._since_ns is not None

    @property
    def why_down(self) -> str:
        """Say why the radio takes nothing, for whoever is refused."""
        return f"it is not connected ({self._reason})" if self._reason else "it is not connected"

    def attempt(self) -> None:
        """Count an attempt to bring the radio up."""
        self._n_attempts += 1
        self._health.count("radio.attempts")
        self._health.note_attempts(self._radio, self._n_attempts)

    def begin(self, reason: str) -> None:
        """Say that the radio is down; while it is, only the reason is kept."""
        self._reason = reason
        self._health.set_radio(self._radio, RadioState.DOWN, reason=reason)
        self._health.count("radio.faults")
        if self._since_ns is not None:
            return
        self._since_ns = time.monotonic_ns()
        self._n_attempts = 0
        self._told.clear()
        _log.warning("radio.down", radio=self._radio, reason=reason)
        if self._on_state is not None:
            self._on_state(self._radio, RadioState.DOWN, reason)

    def step(self, event: str, **facts: object) -> None:
        """Log a step that is taken against the outage, once of each kind; all are counted."""
        self._health.count(event)
        if event not in self._told:
            self._told.add(event)
            _log.info(event, radio=self._radio, **facts)

    def end(self) -> None:
        """Say that the radio is up."""
        down_s = 0.0 if self._since_ns is None else round((time.monotonic_ns() - self._since_ns) / NS_PER_S, 1)
        n_attempts, self._since_ns, self._n_attempts, self._reason = self._n_attempts, None, 0, ""
        self._health.set_radio(self._radio, RadioState.UP)
        self._health.count("radio.sessions")
        _log.info("radio.up", radio=self._radio, attempts=n_attempts, down_s=down_s)
        if self._on_state is not None:
            self._on_state(self._radio, RadioState.UP, f"down for {down_s:g} s, {n_attempts} attempts" if down_s else "")
