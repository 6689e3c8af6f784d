"""Burst loss (Gilbert-Elliott): each link works and fails by turns, for times that are exponentially distributed."""

import numpy as np
from numpy.typing import NDArray

from simulator import draws
from simulator.draws import Floats, Words
from simulator.errors import ParameterError

_STREAM = 240
_NS_PER_S = 1e9


class BurstLoss:
    """Remembers in which state each directed link was when a packet last tried it.

    Parameters
    ----------
    good_s, bad_s
        Mean duration of the working and of the failing state [s], positive.

    Notes
    -----
    In continuous time: what a link does does not depend on how often it is tried. A link is first tried in its stationary state, bad
    with probability ``bad / (good + bad)``; after a time t, with r = exp(-t (1 / good + 1 / bad)), it is bad with probability
    p (1 - r) if it was good and p (1 - r) + r if it was bad. One draw u decides for both cases at once: below the first it is bad,
    above the second good, between them unchanged.
    """

    __slots__ = ("_bad", "_links", "_p_bad", "_rate_hz", "_seed", "_t_ns")

    def __init__(self, *, seed: int, good_s: float, bad_s: float) -> None:
        if not (0 < good_s < float("inf") and 0 < bad_s < float("inf")):
            raise ParameterError(name="burst_good_s, burst_bad_s", got=(good_s, bad_s), wanted="two positive finite durations")
        self._seed = seed
        self._p_bad = bad_s / (good_s + bad_s)
        self._rate_hz = 1.0 / good_s + 1.0 / bad_s
        self._links: Words = np.empty(0, dtype=np.uint64)
        self._t_ns = np.empty(0, dtype=np.int64)
        self._bad = np.empty(0, dtype=np.bool_)

    def strikes(self, *, sender: Words, receiver: Words, number: Words, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which packets meet a link that fails.

        Parameters
        ----------
        sender, receiver
            Identities below 2^32, shape (k,).
        number
            The sender's number of the packet, below 2^32, shape (k,).
        t_ns
            When [ns], shape (k,), in any order, but for each link not before what was asked earlier.

        Returns
        -------
        NDArray of bool
            Shape (k,).
        """
        if not sender.size:
            return np.empty(0, dtype=np.bool_)
        link = (sender << np.uint64(32)) | receiver
        order = np.lexsort((number, t_ns, link))
        link, at_ns = link[order], t_ns[order]
        index = (number[order] << np.uint64(32)) | (link & np.uint64(0xFFFFFFFF))
        u = draws.uniform(draws.words(seed=self._seed, biobot=sender[order], stream=_STREAM, index=index))
        is_first = np.append(True, link[1:] != link[:-1])
        place = np.searchsorted(self._links, link[is_first])
        known = np.zeros(place.size, dtype=np.bool_)
        known[place < self._links.size] = self._links[place[place < self._links.size]] == link[is_first][place < self._links.size]
        before_ns = np.append(np.int64(0), at_ns[:-1])
        before_ns[is_first] = np.where(known, np.append(self._t_ns, 0)[np.where(known, place, -1)], at_ns[is_first])
        kept: Floats = np.exp(-self._rate_hz * np.maximum(at_ns - before_ns, 0) / _NS_PER_S)
        fresh = is_first.copy()
        fresh[is_first] = ~known
        kept[fresh] = 0.0
        low = self._p_bad * (1.0 - kept)
        was_bad = np.zeros(link.size, dtype=np.bool_)
        was_bad[is_first] = known & np.append(self._bad, False)[np.where(known, place, -1)]
        # Where u decides alone, or at the first packet of a link, the state is known; the others repeat the last known one.
        is_bad = u < low
        is_open = (u >= low) & (u < low + kept)
        is_bad[is_first & is_open] = was_bad[is_first & is_open]
        anchor = np.maximum.accumulate(np.where(is_open & ~is_first, 0, np.arange(link.size)))
        is_bad = is_bad[anchor]
        is_last = np.append(link[1:] != link[:-1], True)
        self._remember(link[is_last], at_ns[is_last], is_bad[is_last], place=place, known=known)
        struck = np.empty(link.size, dtype=np.bool_)
        struck[order] = is_bad
        return struck

    def _remember(
        self, links: Words, t_ns: NDArray[np.int64], bad: NDArray[np.bool_], *, place: NDArray[np.int64], known: NDArray[np.bool_]
    ) -> None:
        self._t_ns[place[known]], self._bad[place[known]] = t_ns[known], bad[known]
        if not known.all():
            fresh = ~known
            self._links = np.insert(self._links, place[fresh], links[fresh])
            self._t_ns = np.insert(self._t_ns, place[fresh], t_ns[fresh])
            self._bad = np.insert(self._bad, place[fresh], bad[fresh])
