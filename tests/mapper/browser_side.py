"""A real browser opposite a page of ours: what it must not do, what it looks like, and whether everybody can use it."""

import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from playwright.sync_api import Browser, Page, expect

ARTIFACTS = Path(__file__).parents[2] / "artifacts"
WAIT_MS = 120_000
expect.set_options(timeout=WAIT_MS)
PHONE = (390, 844)
DESK = (1280, 800)
_AXE = Path(__file__).parents[1] / "vendor" / "axe-core" / "axe.min.js"
_SERIOUS = {"serious", "critical"}


@dataclass
class Watched:
    """A page, and what it must not do."""

    page: Page
    outside: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


@contextmanager
def opened(
    browser: Browser,
    url: str,
    *,
    token: str | None = None,
    size: tuple[int, int] = DESK,
    scheme: Literal["light", "dark"] = "light",
    motion: Literal["reduce", "no-preference"] = "no-preference",
    expected: Sequence[str] = (),
) -> Iterator[Watched]:
    """Open a page, signed in with ``token``; at the end it has asked nobody else, and complained of nothing.

    What is ``expected`` of complaints, by regular expressions, does not count.
    """
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, reduced_motion=motion)
    watched = Watched(page=page)

    def complain(text: str) -> None:
        if not any(re.search(pattern, text) for pattern in expected):
            watched.faults.append(text)

    page.set_default_timeout(WAIT_MS)
    page.on("request", lambda request: None if request.url.startswith((url, "data:", "blob:")) else watched.outside.append(request.url))
    page.on("console", lambda message: complain(message.text) if message.type in {"error", "warning"} else None)
    page.on("pageerror", lambda error: complain(str(error)))
    if token is not None:
        page.add_init_script(f"sessionStorage.getItem('biobot.token') ?? sessionStorage.setItem('biobot.token', {json.dumps(token)})")
    page.goto(url)
    yield watched
    assert not watched.outside, watched.outside
    assert not watched.faults, watched.faults
    page.close()


def until(is_met: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_MS / 1000
    while not is_met():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def until_true(page: Page, expression: str) -> None:
    """Wait until an expression is true in a page.

    Playwright's own ``wait_for_function`` evaluates it in the page from its second look on, which the page's content policy refuses.
    """
    until(lambda: bool(page.evaluate(expression)))


def picture(page: Page, name: str, *, is_whole: bool = True) -> None:
    """Keep a picture of the whole page, or of what is in sight of it."""
    ARTIFACTS.mkdir(exist_ok=True)
    page.screenshot(path=ARTIFACTS / f"{name}.png", full_page=is_whole)


def fits_its_width(page: Page) -> bool:
    return bool(page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth"))


def accessibility_faults(page: Page) -> list[str]:
    """Say what axe-core finds that is serious or critical, rule by rule, with the elements."""
    # Put in by the debugger, past the page's own rule that no foreign script runs.
    page.evaluate(_AXE.read_text(encoding="utf-8") + "; null")
    found: dict[str, Any] = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
    return [
        f"{violation['id']}: {violation['help']}: {[node['html'][:300] for node in violation['nodes']]}"
        for violation in found["violations"]
        if violation["impact"] in _SERIOUS
    ]


def tab_to(page: Page, selector: str, *, backwards: bool = False, at_most: int = 80) -> None:
    """Press Tab until an element has the focus."""
    for _ in range(at_most):
        page.keyboard.press("Shift+Tab" if backwards else "Tab")
        if page.evaluate("(selector) => document.activeElement.matches(selector)", selector):
            return
    raise AssertionError(f"{selector} was not reached by {at_most} presses of Tab")
