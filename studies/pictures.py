"""The pictures of the documents: the page while a simulated swarm walks, on a desk, on a phone, in the dark, and a map beside the truth.

``make pictures`` makes them anew in docs/pictures; it wants Chromium (``make system-packages``). What differs between two runs is chance of
the machine: which instant the picture caught.
"""

import argparse
import io
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from mapper.__main__ import main as make_map
from simulator.__main__ import main as simulate
from studies.architecture import write_architecture
from studies.comparison import draw_comparison, fit_map
from studies.system import PartFailedError, RunningSystem, SystemSettings
from studies.truth import load_run

_DESK, _PHONE = (1280, 800), (390, 844)
_COLOURS = 200
"""Of a picture: few enough that all of them together stay below a megabyte, and none looks spoilt."""

_WAIT_MS = 300_000
_N_OBSTACLES = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Make all pictures; 1 where Chromium is missing, a process ended, or no map was sure."""
    parser = argparse.ArgumentParser(prog="make pictures ARGS=...", description="Make the pictures of the documents anew.")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"), help="where they go (default: docs/pictures)")
    parser.add_argument("--seed", type=int, default=1, help="of the insects (default: 1)")
    parser.add_argument("--only-drawn", action="store_true", help="leave out those of the page, which take minutes and Chromium")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    write_architecture(options.out)
    _draw_map_beside_truth(options.out, seed=options.seed)
    if not options.only_drawn:
        chromium = shutil.which("chromium")
        if chromium is None:
            print("there is no chromium here; make system-packages installs it", file=sys.stderr)
            return 1
        try:
            _take_page(options.out, seed=options.seed, chromium=chromium)
        except PartFailedError as error:
            print(error, file=sys.stderr)
            return 1
    for path in sorted(options.out.iterdir()):
        print(f"{path}  {path.stat().st_size / 1000:.0f} kB")
    return 0


def _draw_map_beside_truth(out: Path, *, seed: int) -> None:
    with tempfile.TemporaryDirectory() as directory:
        run, document, drawn = Path(directory) / "run", Path(directory) / "map.json", Path(directory) / "drawn.png"
        simulate(["run", "--scenario", "two-obstacles", "--seed", str(seed), "--out", str(run)])
        make_map(["run", str(run / "encounters.csv"), "--modes", str(run / "modes.csv"), "--json", str(document)])
        draw_comparison(fit_map(json.loads(document.read_text()), load_run(run)), drawn, title=f"two-obstacles, seed {seed}")
        _keep(drawn.read_bytes(), out / "map-and-truth.png", width=1200)


def _take_page(out: Path, *, seed: int, chromium: str) -> None:
    """Take the pictures of the page while insects walk at twice their pace; faster, clocks of a busy machine would blur the map."""
    with tempfile.TemporaryDirectory() as directory, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        settings = SystemSettings(out=Path(directory), seed=seed, speed=2.0, dispersion_s=5.0, exploration_s=600.0)
        with RunningSystem(settings=settings) as system:
            with _opened(browser, system, size=_DESK) as page:
                system.wait_for(lambda: _n_holes(system), what="a map with a hole", timeout_s=300)
                page.locator("tr[data-row=h0]").wait_for()
                _keep(page.screenshot(), out / "early.png")
                _take_when_sure(system, page, out / "page.png")
            with _opened(browser, system, size=_PHONE, scheme="dark") as page:
                _take_when_sure(system, page, out / "phone.png")
        browser.close()


def _n_holes(system: RunningSystem) -> int:
    return len(system.get("/api/v1/map")["holes"])


def _take_when_sure(system: RunningSystem, page: Page, path: Path) -> None:
    """Take a picture of a map that is sure of the two holes that there are, and is so still when it is taken."""

    def is_sure() -> bool:
        document = system.get("/api/v1/map")
        return document["data"]["is_enough"] and len(document["holes"]) == _N_OBSTACLES

    def take() -> bytes | None:
        shot = page.screenshot() if is_sure() and page.locator("tr[data-row^=h]").count() == _N_OBSTACLES else None
        return shot if is_sure() else None

    _keep(system.wait_for(take, what="a map that is sure of two holes", timeout_s=600), path)


@contextmanager
def _opened(
    browser: Browser, system: RunningSystem, *, size: tuple[int, int], scheme: Literal["light", "dark"] = "light"
) -> Iterator[Page]:
    """Open the live page, signed in as the operator."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, reduced_motion="reduce")
    page.set_default_timeout(_WAIT_MS)
    page.add_init_script(f"sessionStorage.setItem('biobot.token', '{system.token}')")
    page.goto(f"{system.url}/")
    yield page
    page.close()


def _keep(picture: bytes, path: Path, *, width: int | None = None) -> None:
    """Keep a picture with few colours, and no wider than this [pixel]."""
    with Image.open(io.BytesIO(picture)) as whole:
        shot = whole.convert("RGB")
    if width is not None and shot.width > width:
        shot = shot.resize((width, round(shot.height * width / shot.width)), Image.Resampling.LANCZOS)
    shot.quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    sys.exit(main())
