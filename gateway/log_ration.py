"""How many lines something that may go wrong at any speed is allowed in the log."""

from firmware_protocol.units import NS_PER_S


class LogRation:
    """So many lines in each period; what is beyond is counted, and told with the next line.

    Parameters
    ----------
    n_lines, period_s
        How many, in how long [s].
    """

    def __init__(self, *, n_lines: int = 20, period_s: float = 60.0) -> None:
        self._n_lines = n_lines
        self._period_ns = int(period_s * NS_PER_S)
        self._n_left = n_lines
        self._until_ns = 0
        self._n_unsaid = 0

    def ask(self, *, now_ns: int) -> int | None:
        """Return how many lines were not said since the last one, or None: this one is not to be said either."""
        if now_ns >= self._until_ns:
            self._until_ns = now_ns + self._period_ns
            self._n_left = self._n_lines
        if not self._n_left:
            self._n_unsaid += 1
            return None
        self._n_left -= 1
        n_unsaid, self._n_unsaid = self._n_unsaid, 0
        return n_unsaid
