"""When a client of Zenoh looks whether its router hears it, when it joins anew, and what is to be told of that. Pure (ADR 0028).

A session that was heard and is not any more is joined anew, which heals it. One that was never heard, and is not when it is joined anew
either, is most likely denied: its name is not on the router's roster. That is told once, and it joins anew more and more rarely: one that
reads its roster again drops all links, and a new link is looked at like the first.
"""

from dataclasses import dataclass, field
from enum import Enum
from typing import Final

_LOOKS_S: Final = (2.0, 4.0, 14.0)
"""Pauses after a new link, and after each look, before it is looked whether the session is heard."""

_LOOK_EVERY_S: Final = 60.0
_AGAIN_S: Final = 1.0
_MOST_UNHEARD: Final = 3
"""So many looks in a row: a busy machine answers late."""

_VAIN_PAUSE_S: Final = 15.0
_LONGEST_PAUSE_S: Final = 60.0
"""Should it be heard for want of anything but a line in the roster, it must not wait long."""


class Told(Enum):
    """What a look has shown that somebody should hear of."""

    UNHEARD = "bus.unheard"
    """It is not heard, and is to be joined anew."""
    DENIED = "bus.denied"
    """The same, and joining anew does not help."""
    HEARD = "bus.heard"
    """It was denied, and is heard now."""


WHY: Final = {
    Told.UNHEARD: "it is connected, and the router does not hear it; it is joined anew",
    Told.DENIED: "it joined twice, and the router does not hear it: most likely the name in its certificate is not on the router's roster, "
    "or is for another site; add the line to the roster and send the router SIGHUP (`biobot-gateway certs check` names all)",
    Told.HEARD: "the router hears it now",
}


@dataclass(slots=True, kw_only=True)
class Hearing:
    """What is known of being heard over all sessions of one client; `joins_anew` after a look says whether to leave this one."""

    joins_anew: bool = False
    _pauses_s: list[float] = field(default_factory=list)
    _n_unheard: int = 0
    _was_heard: bool = False
    _n_vain: int = 0

    def begin(self) -> None:
        """Begin with a new session."""
        self.joins_anew, self._was_heard, self._n_unheard = False, False, 0
        # Once in vain may be chance.
        vain_s = _VAIN_PAUSE_S * 2.0 ** min(self._n_vain - 2, 10)
        self._pauses_s = [*_LOOKS_S] if self._n_vain < 2 else [min(vain_s, _LONGEST_PAUSE_S)]

    def link(self) -> None:
        """Take a new link: it is looked at soon."""
        self._pauses_s = [*_LOOKS_S]

    def pause_s(self) -> float:
        """Return how long to wait before the next look [s]; it is the next one's turn then."""
        return self._pauses_s.pop(0) if self._pauses_s else _LOOK_EVERY_S

    def look(self, *, is_heard: bool | None) -> Told | None:
        """Take what a look has shown; None: it could not be looked. Returns what is to be told, each once."""
        self._n_unheard = self._n_unheard + 1 if is_heard is False else 0
        if is_heard:
            was_denied, self._n_vain, self._was_heard = self._n_vain >= 2, 0, True
            return Told.HEARD if was_denied else None
        if self._n_unheard < _MOST_UNHEARD:
            self._pauses_s[:0] = [_AGAIN_S] if self._n_unheard else []
            return None
        self.joins_anew = True
        self._n_vain = 0 if self._was_heard else self._n_vain + 1
        return None if self._n_vain > 2 else Told.DENIED if self._n_vain == 2 else Told.UNHEARD
