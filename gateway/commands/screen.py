"""The picture that ``biobot-gateway status`` draws: once, or until it is interrupted."""

import logging
import signal
import time
from collections.abc import Sequence

from rich.console import Console, RenderableType
from rich.live import Live

from gateway.commands.outcome import DONE, FAILED
from gateway.config import GatewayConfig
from gateway.site_view import SiteView
from gateway.site_watch import SiteWatch
from gateway.status_screen import draw

_TIMEOUT_S = 5.0
_OTHERS_S = 1.5
"""After the first gateway, others of the site are waited for; each speaks every second, and two statuses make a rate."""

_POLL_S = 0.05
_REFRESH_S = 0.5


def show(way: GatewayConfig, *, gateway: str | None, is_once: bool) -> int:
    """Show how the gateways of a site stand, over the way to it; returns the exit status: whether one was heard.

    A terminal that cannot move its cursor gets one picture.
    """
    console = Console(highlight=False)
    # What the watch over the connection would log is in the picture, which lines among it would tear.
    logging.disable(logging.CRITICAL)
    watch = SiteWatch.open(site=way.site, gateway=gateway, connect=way.connect, tls=way.tls, timing=way.zenoh)
    try:
        screen = Screen(watch=watch, site=way.site, connect=way.connect)
        return screen.draw_once(console) if is_once or console.is_dumb_terminal else screen.keep_drawing(console)
    finally:
        watch.close()
        logging.disable(logging.NOTSET)


class Screen:
    """What is heard, and its picture."""

    def __init__(self, *, watch: SiteWatch, site: str, connect: Sequence[str]) -> None:
        self._watch = watch
        self._site = site
        self._connect = connect
        self._view = SiteView()
        self._begun_s = time.monotonic()

    def draw_once(self, console: Console) -> int:
        """Draw when all gateways have had time to speak; returns the exit status: whether one has."""
        deadline_s = self._begun_s + _TIMEOUT_S
        while (now_s := time.monotonic()) < deadline_s:
            had_any = self._has_status()
            self._listen()
            if not had_any and self._has_status():
                deadline_s = now_s + _OTHERS_S
            time.sleep(_POLL_S)
        console.print(self._picture())
        return DONE if self._has_status() else FAILED

    def keep_drawing(self, console: Console) -> int:
        """Draw until interrupted; returns the exit status: whether a gateway was heard."""
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the terminal is left as it was
        try:
            with Live(console=console, screen=True, auto_refresh=False) as live:
                while True:
                    self._listen()
                    live.update(self._picture(), refresh=True)
                    time.sleep(_REFRESH_S)
        except KeyboardInterrupt:
            return DONE if self._has_status() else FAILED

    def _listen(self) -> None:
        now_s = time.monotonic()
        for arrival in self._watch.take():
            self._view.take(arrival, now_s=now_s)

    def _has_status(self) -> bool:
        return any(one.status is not None for one in self._view.gateways())

    def _picture(self) -> RenderableType:
        now_s = time.monotonic()
        waited_s, is_connected = now_s - self._begun_s, self._watch.is_connected
        return draw(
            self._view,
            site=self._site,
            connect=self._connect,
            is_connected=is_connected,
            why_alone=self._watch.missing,
            waited_s=waited_s,
            now_s=now_s,
        )
