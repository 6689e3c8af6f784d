"""Who speaks to this gateway without asking anything: mappers by their watermarks, commanders by their tokens and beats.

Zenoh's threads keep what is newest of each name; one wake-up crosses to the event loop. Names come from outside, so they are bounded.
"""

import asyncio
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import zenoh

from firmware_protocol.contract.commands import CommanderBeat
from firmware_protocol.contract.keys import parse_key
from firmware_protocol.contract.presence import parse_token_key
from firmware_protocol.contract.records import Watermark, decode_record
from firmware_protocol.errors import KeyExpressionError, RecordError
from gateway.health import Health

_MAX_WATERMARKS = 64
_MAX_COMMANDERS = 256
"""Commanders of a site; one more is not there, so that what it commands is refused."""

_TOLD_AGAIN_S = 1.0
"""Within this all tokens are told again after their subscriber was declared anew."""


_FIRST_NUMBER = 1
"""Of a beat that came before its token: it may be another session's of the same name, and this one's numbers are not to be behind it."""


class CommanderListener(Protocol):
    """Hears of commanders, in the loop."""

    def came(self, name: str) -> None:
        """Its liveliness token is there."""

    def went(self, name: str) -> None:
        """Its liveliness token is there no more."""

    def beat(self, name: str, *, number: int, at_ns: int) -> None:
        """It said at ``at_ns`` of the monotonic clock that it is there."""


class WatermarkDoor:
    """Takes the watermarks of mappers of one journal."""

    def __init__(self, *, loop: asyncio.AbstractEventLoop, journal: str, health: Health, on_watermark: Callable[[str, int], None]) -> None:
        self._loop = loop
        self._journal = journal
        self._health = health
        self._on_watermark = on_watermark
        self._lock = threading.Lock()
        self._watermarks: dict[str, int] = {}

    def take(self, sample: zenoh.Sample) -> None:
        """Runs on a thread of Zenoh."""
        try:
            key, watermark = parse_key(str(sample.key_expr)), decode_record(sample.payload.to_bytes(), Watermark)
        except (KeyExpressionError, RecordError):
            self._health.count("bus.unfit_watermarks")
            return
        if watermark.mapper != key.mapper or watermark.journal != self._journal:
            return  # of a journal that this gateway wrote before
        with self._lock:
            is_first = not self._watermarks
            if len(self._watermarks) < _MAX_WATERMARKS or watermark.mapper in self._watermarks:
                self._watermarks[watermark.mapper] = watermark.offset
        if is_first:
            self._loop.call_soon_threadsafe(self._hand_over)

    def _hand_over(self) -> None:
        with self._lock:
            watermarks, self._watermarks = self._watermarks, {}
        for mapper, offset in watermarks.items():
            self._on_watermark(mapper, offset)


@dataclass(slots=True)
class _News:
    """What is new of a commander: that it went (also where it has come again since), that it came, its newest beat and when."""

    went: bool = False
    came: bool = False
    beat: tuple[int, int] | None = None


class CommanderDoor:
    """Takes liveliness tokens and beats of commanders."""

    def __init__(self, *, loop: asyncio.AbstractEventLoop, health: Health, listener: CommanderListener) -> None:
        self._loop = loop
        self._health = health
        self._listener = listener
        self._lock = threading.Lock()
        self._present: set[str] = set()
        self._untold: set[str] = set()
        """Those of before, while it is declared anew, who have not been told of again."""
        self._news: dict[str, _News] = {}
        self._early: dict[str, int] = {}
        """When those were last heard whose tokens were not told of."""

    def begin_anew(self) -> None:
        """Take note that all tokens that there are will be told again now: who is not told of soon went unseen. From any thread."""
        with self._lock:
            self._untold = set(self._present)
        self._loop.call_soon_threadsafe(self._loop.call_later, _TOLD_AGAIN_S, self._drop_untold)

    def take_token(self, sample: zenoh.Sample) -> None:
        """Runs on a thread of Zenoh."""
        try:
            name = parse_token_key(str(sample.key_expr)).name
        except KeyExpressionError:
            self._health.count("bus.unfit_commanders")
            return
        is_there = sample.kind == zenoh.SampleKind.PUT
        with self._lock:
            if is_there and name not in self._present and len(self._present) >= _MAX_COMMANDERS:
                self._health.count("bus.commanders_beyond_limit")
                return
            if is_there:
                self._present.add(name)
            elif name in self._present:
                self._present.remove(name)
            else:
                return
            self._untold.discard(name)
            is_first, news = not self._news, self._news.setdefault(name, _News())
            if is_there:
                news.came = True
                if (early_ns := self._early.pop(name, None)) is not None:
                    news.beat = (_FIRST_NUMBER, early_ns)
            else:
                news.went, news.came, news.beat = True, False, None
        if is_first:
            self._loop.call_soon_threadsafe(self._hand_over)

    def take_beat(self, sample: zenoh.Sample) -> None:
        """Runs on a thread of Zenoh; the instant of a beat is that of its coming in, not of the loop's looking at it."""
        try:
            name, beat = parse_key(str(sample.key_expr)).gateway, decode_record(sample.payload.to_bytes(), CommanderBeat)
        except (KeyExpressionError, RecordError):
            self._health.count("bus.unfit_beats")
            return
        with self._lock:
            if name not in self._present:
                self._keep_early(name, time.monotonic_ns())
                return
            is_first, news = not self._news, self._news.setdefault(name, _News())
            news.beat = (beat.number, time.monotonic_ns())
        if is_first:
            self._loop.call_soon_threadsafe(self._hand_over)

    def _keep_early(self, name: str, at_ns: int) -> None:
        """Keep a beat of whom no token was told of yet: it may be on its way, and that beat the only one before a link is cut."""
        self._early.pop(name, None)
        self._early[name] = at_ns
        if len(self._early) > _MAX_COMMANDERS:
            del self._early[next(iter(self._early))]

    def _drop_untold(self) -> None:
        with self._lock:
            untold, self._untold = self._untold, set()
            self._present -= untold
            for name in untold:
                self._news[name] = _News(went=True)
        self._hand_over()

    def _hand_over(self) -> None:
        with self._lock:
            news_of, self._news = self._news, {}
        for name, news in news_of.items():
            if news.went:
                self._listener.went(name)
            if news.came:
                self._listener.came(name)
            if news.beat is not None:
                number, at_ns = news.beat
                self._listener.beat(name, number=number, at_ns=at_ns)
