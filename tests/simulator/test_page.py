"""Laws of the page that plays a run: complete in one file, and it shows what the files hold."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect, sync_playwright

from simulator.pictures.page import render_page
from simulator.pictures.recorded_run import RecordedRun, read_run
from tests.simulator.runs import change_description, make_run, run_with_a_door_that_closes

pytestmark = pytest.mark.xdist_group("simulator page")
"""What they share is made once, by one worker."""

CHROMIUM = shutil.which("chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--host-resolver-rules=MAP * ~NOTFOUND"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    directory = make_run(tmp_path_factory.mktemp("made") / "run", samples=6)
    return run_with_a_door_that_closes(directory)


def test_the_same_run_gives_the_same_page_and_it_fetches_nothing(run: RecordedRun) -> None:
    page = render_page(run, trail_s=1.0)
    assert page == render_page(run, trail_s=1.0)
    assert not re.findall(rb"(?:src|href)\s*=|https?://|url\(|@import|fetch\(|import\(", page)


def test_a_name_cannot_leave_its_place_in_the_page(tmp_path: Path) -> None:
    directory = make_run(tmp_path / "run", samples=2)
    change_description(directory, arena="</script><script>alert(1)</script>.geojson")
    assert render_page(read_run(directory), trail_s=1.0).count(b"</script>") == 2


@pytest.fixture(scope="module")
def opened(run: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    if CHROMIUM is None:
        pytest.skip("no chromium on the PATH; apt-get install chromium")
    path = tmp_path_factory.mktemp("page") / "run.html"
    path.write_bytes(render_page(run, trail_s=1.0))
    faults: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 900, "height": 800})
        page.on("console", lambda message: faults.append(message.text))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("request", lambda request: None if request.url.startswith(path.as_uri()) else faults.append(request.url))
        page.goto(path.as_uri() + "#t=7")
        yield page
        browser.close()
    assert faults == []


@pytest.mark.browser
def test_the_page_opens_at_the_instant_named(opened: Page) -> None:
    assert opened.title() == "two-obstacles, paper-units, seed 3"
    assert (opened.text_content("#clock") or "").startswith("t = 7.0 s of 20 s")
    assert "40 biobots (6 landmarks)" in (opened.text_content("#summary") or "")


@pytest.mark.browser
@pytest.mark.parametrize("at_s", [0.0, 3.3, 11.0, 13.7, 20.0])
def test_the_page_shows_everybody_where_the_pictures_do(opened: Page, run: RecordedRun, at_s: float) -> None:
    """A place on the page is rounded to one part in 65,535 of the arena's side."""
    places, states, count = opened.evaluate(f"(goTo({at_s}), [Array.from(places), Array.from(state), byId('clock').textContent])")
    x_min, y_min, x_max, _ = run.bounds
    shown = np.array(places).reshape(-1, 2) * (x_max - x_min) / 65_535 + (x_min, y_min)
    np.testing.assert_allclose(shown, run.track.at(at_s), atol=50.0 / 65_535)
    landmark, resting = run.standing_at(at_s)
    np.testing.assert_array_equal(states, 2 * landmark + resting)
    assert f", {(run.met_start_s <= at_s).sum()} encounters" in count
    assert opened.evaluate("arenaAt(now).parts[0].length") == 1 + run.track.arena_at(at_s).betti.holes


@pytest.mark.browser
def test_play_moves_time_and_the_end_stops_it(opened: Page) -> None:
    opened.evaluate("goTo(19)")
    opened.select_option("#speed", "50")
    opened.click("#play")
    expect(opened.locator("#clock")).to_contain_text("t = 20.0 s", timeout=20_000)
    expect(opened.locator("#play")).to_have_text("Play")
