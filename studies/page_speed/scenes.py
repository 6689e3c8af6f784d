"""What is done with the page while its frames are measured."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

from playwright.sync_api import Browser, Page, expect

from studies.page_speed.frames import FrameWatch
from studies.page_speed.site import Site

_WAIT_MS: Final = 60_000
_MOVE_MS: Final = 8
_N_MOVES: Final = 60
_WHEEL_MS: Final = 30
_N_WHEELS: Final = 20
_SETTLE_MS: Final = 1_000
_MS_PER_S: Final = 1_000
_A_MAP: Final = re.compile(r"Map of \S+ encounters")
_SORT: Final = """(label) => new Promise((resolve) => {
  const button = [...document.querySelectorAll("#columns button")].find((one) => one.textContent === label);
  const begun = performance.now();
  button.click();
  requestAnimationFrame(() => requestAnimationFrame(() => resolve(performance.now() - begun)));
})"""


@contextmanager
def opened(browser: Browser, site: Site) -> Iterator[tuple[Page, FrameWatch]]:
    """Open a site's page, signed in; the pointer is beside the table, so that rows may move."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(_WAIT_MS)
    expect.set_options(timeout=_WAIT_MS)
    page.add_init_script(f"sessionStorage.setItem('biobot.token', '{site.token}')")
    page.goto(site.url)
    yield page, FrameWatch(browser, page)
    page.close()


def watch_rows(browser: Browser, site: Site, *, n_biobots: int, seconds: float) -> dict[str, Any]:
    """Look at rows that all change, in the order of ids and in an order that changes with them; and sort them."""
    with opened(browser, site) as (page, watch):
        expect(page.locator("#rows tr")).to_have_count(n_biobots)
        facts = {"by id": _frames(watch, lambda: page.wait_for_timeout(_MS_PER_S * seconds))}
        facts["sorting"] = {label: page.evaluate(_SORT, label) for label in ("battery", "state", "id", "heard")}
        facts["by heard"] = _frames(watch, lambda: page.wait_for_timeout(_MS_PER_S * seconds))
    return facts


def watch_map(browser: Browser, site: Site) -> dict[str, Any]:
    """Drag the map, and enlarge it by the wheel, step by step and then until it is painted anew."""
    with opened(browser, site) as (page, watch):
        return _move_map(page, watch)


def watch_live(browser: Browser, site: Site, *, seconds: float) -> dict[str, Any]:
    """Do nothing, and drag and enlarge, while maps come in."""
    with opened(browser, site) as (page, watch):
        expect(page.locator("#map-canvas")).to_be_visible()
        before = site.ask("/api/v1/map/status")["version"]
        facts = {"looking on": _frames(watch, lambda: page.wait_for_timeout(_MS_PER_S * seconds))}
        return facts | _move_map(page, watch) | {"maps": site.ask("/api/v1/map/status")["version"] - before}


def _move_map(page: Page, watch: FrameWatch) -> dict[str, Any]:
    canvas = page.locator("#map-canvas")
    expect(canvas).to_have_attribute("aria-label", _A_MAP)
    page.wait_for_timeout(_SETTLE_MS)
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 3, box["y"] + box["height"] / 3

    def drag() -> None:
        page.mouse.move(x, y)
        page.mouse.down()
        for step in range(_N_MOVES):
            page.mouse.move(x + step, y + step / 2)
            page.wait_for_timeout(_MOVE_MS)
        page.mouse.up()
        page.wait_for_timeout(_SETTLE_MS)

    def enlarge() -> None:
        page.mouse.move(x, y)
        for _ in range(_N_WHEELS):
            page.mouse.wheel(0, -30)
            page.wait_for_timeout(_WHEEL_MS)
        page.wait_for_timeout(_SETTLE_MS)

    return {"dragged": _frames(watch, drag), "enlarged": _frames(watch, enlarge)}


def _frames(watch: FrameWatch, act: Callable[[], None]) -> dict[str, Any]:
    with watch.measured() as frames:
        act()
    return frames.told()
