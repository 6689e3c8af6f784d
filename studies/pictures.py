"""The pictures of the documents: the page while a simulated swarm walks, on a desk, on a phone, in the dark, and a map beside the truth.

``make pictures`` makes them anew in docs/pictures; it wants Chromium (``make system-packages``). What differs between two runs is chance of
the machine: which instant the picture caught.
"""

import argparse
import io
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from PIL import Image
from playwright.sync_api import Browser, Locator, Page, sync_playwright

from studies.comparison import draw_comparison, fit_map
from studies.system import PartFailedError, RunningSystem, SystemSettings
from studies.truth import load_run

_DESK, _PHONE = (1280, 800), (390, 844)
_COLOURS = 96
"""Of a picture: few enough that all of them together stay below a megabyte, and none looks spoilt."""

_WAIT_MS = 120_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Make all pictures; 1 where Chromium is missing or a process ended."""
    parser = argparse.ArgumentParser(prog="make pictures ARGS=...", description="Make the pictures of the documents anew.")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"), help="where they go (default: docs/pictures)")
    parser.add_argument("--seed", type=int, default=1, help="of the insects (default: 1)")
    options = parser.parse_args(arguments)
    chromium = shutil.which("chromium")
    if chromium is None:
        print("there is no chromium here; make system-packages installs it", file=sys.stderr)
        return 1
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as directory:
        settings = SystemSettings(out=Path(directory), seed=options.seed, dispersion_s=5.0, exploration_s=240.0)
        try:
            with RunningSystem(settings=settings) as system:
                _take(system, options.out, chromium=chromium)
        except PartFailedError as error:
            print(error, file=sys.stderr)
            return 1
    for path in sorted(options.out.iterdir()):
        print(f"{path}  {path.stat().st_size / 1000:.0f} kB")
    return 0


def _take(system: RunningSystem, out: Path, *, chromium: str) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        with _opened(browser, system, size=_DESK) as page:
            _keep(page, out / "early.png")
            system.wait_for(lambda: _is_sure(system), what="a map with two holes", timeout_s=300)
            page.locator("tr[data-row=h1]").wait_for(state="attached")
            _keep(page, out / "page.png")
        with _opened(browser, system, size=_PHONE, scheme="dark") as page:
            _keep(page, out / "phone.png")
        browser.close()


def _is_sure(system: RunningSystem) -> bool:
    document: dict[str, Any] = system.get("/api/v1/map")
    return bool(document["data"]["is_enough"]) and len(document["holes"]) == 2  # noqa: PLR2004  # that is how many the scenario has


@contextmanager
def _opened(browser: Browser, system: RunningSystem, *, size: tuple[int, int], scheme: Literal["light", "dark"] = "light") -> Iterator[Page]:
    """Open the live page, signed in as the operator."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, reduced_motion="reduce")
    page.set_default_timeout(_WAIT_MS)
    page.add_init_script(f"sessionStorage.setItem('biobot.token', '{system.token}')")
    page.goto(f"{system.url}/")
    yield page
    page.close()


def _keep(what: Page | Locator, path: Path) -> None:
    """Keep a picture of a page or a part of it, with few colours."""
    with Image.open(io.BytesIO(what.screenshot())) as shot:
        shot.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    sys.exit(main())
