"""What one radio may bring about in the log at any speed: so many lines a minute and no more."""

import time
from collections.abc import Callable

from gateway.health import Health
from gateway.log_ration import LogRation


class RadioLog:
    """Says what happens to one radio; what is beyond its ration is counted, and told with the next line."""

    def __init__(self, *, radio: str, health: Health) -> None:
        self._radio = radio
        self._health = health
        self._ration = LogRation()

    def say(self, say: Callable[..., None], event: str, **facts: object) -> None:
        """Say an event by ``say``, a method of an event log."""
        n_unsaid = self._ration.ask(now_ns=time.monotonic_ns())
        if n_unsaid is None:
            self._health.count("radio.unsaid")
        elif n_unsaid:
            say(event, radio=self._radio, unsaid=n_unsaid, **facts)
        else:
            say(event, radio=self._radio, **facts)
