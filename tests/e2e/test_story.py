"""An operator's whole story at the page, from the first glance to the files taken home; `make story` runs it, with pictures of every step.

All parts are real processes: simulated insects that walk around two obstacles, some times faster than life; gateway, mapper, browser.
Nothing is asserted of how long anything takes, and what may pass quickly is collected as it passes.
"""

import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from studies.system import RunningSystem, SystemSettings
from tests.mapper.browser_side import CHROMIUM, DESK, PHONE, WAIT_MS, accessibility_faults, fits_its_width, launched, opened, picture

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.story,
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH; apt-get install chromium"),
    pytest.mark.timeout(1800),
]

PATIENCE_MS = 300_000
STOP_MS = 60_000
N_BIOBOTS = 150
# From so many on maps of this site show its two holes, one after the other: the operator waits for that, too.
N_SETTLED = 2500
# What an element said, each text once in its order: none is missed, however short it stood.
COLLECT = """(element, name) => {
  const kept = (window[name] = []);
  const keep = () => {
    const text = element.hidden ? "" : element.ariaLabel ?? element.innerText;
    if (text && kept.at(-1) !== text) kept.push(text);
  };
  keep();
  new MutationObserver(keep).observe(element, { attributes: true, childList: true, subtree: true, characterData: true });
}"""


@dataclass
class Story:
    """The page, the site behind it, and how many pictures were made."""

    page: Page
    system: RunningSystem
    n_pictures: int = field(default=0)

    def keep(self, name: str) -> None:
        """Take a picture on a desk in light, and find that nobody is shut out."""
        self.n_pictures += 1
        picture(self.page, f"story-{self.n_pictures:02}-{name}", is_whole=False)
        assert fits_its_width(self.page)
        assert accessibility_faults(self.page) == [], name

    def keep_everywhere(self, name: str, *, tab: str = "Biobots") -> None:
        """Take it in every size and theme; on a phone one of the tabs is shown."""
        self.keep(name)
        for kind, (width, height), scheme in (("dark", DESK, "dark"), ("phone", PHONE, "light"), ("phone-dark", PHONE, "dark")):
            self.page.set_viewport_size({"width": width, "height": height})
            self.page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
            expect(self.page.locator("html")).to_have_attribute("data-theme", scheme)
            expect(self.page.get_by_role("button", name="Stop all")).to_be_in_viewport()
            if (width, height) == PHONE:
                self.page.get_by_role("tab", name=tab).click()
            picture(self.page, f"story-{self.n_pictures:02}-{name}-{kind}", is_whole=False)
            assert fits_its_width(self.page), kind
            assert accessibility_faults(self.page) == [], (name, kind)
        self.page.set_viewport_size({"width": DESK[0], "height": DESK[1]})
        self.page.emulate_media(color_scheme="light")
        expect(self.page.locator("html")).to_have_attribute("data-theme", "light")

    def until(self, is_met: Callable[[], bool], *, what: str) -> None:
        self.system.wait_for(lambda: is_met() or None, what=what, timeout_s=PATIENCE_MS / 1000)


@pytest.fixture
def browser() -> Iterator[Browser]:
    with launched() as chromium:
        yield chromium


def test_an_operator_from_the_first_glance_to_the_files_taken_home(browser: Browser, tmp_path: Path) -> None:
    settings = SystemSettings(
        out=tmp_path, seed=3, speed=8, n_biobots=N_BIOBOTS, dispersion_s=2, exploration_s=3600, begins_by_itself=False
    )  # fmt: skip
    expect.set_options(timeout=PATIENCE_MS)
    try:
        with (
            RunningSystem(settings=settings) as system,
            opened(browser, system.url + "/", motion="reduce", expected=(r"status of 503",)) as watched,
        ):
            watched.page.set_default_timeout(PATIENCE_MS)
            story = Story(page=watched.page, system=system)
            for chapter in (looks_and_signs_in, starts_a_mission, waits_for_two_holes, finds_a_hole_by_its_bar, stops_one, stops_all):
                chapter(story)
            for chapter in (names_three_places, slides_back, takes_files_home):
                chapter(story)
    finally:
        expect.set_options(timeout=WAIT_MS)


def looks_and_signs_in(story: Story) -> None:
    page = story.page
    page.locator("#verdict").evaluate(COLLECT, "verdicts")
    page.locator("#waiting-time").evaluate(COLLECT, "waits")
    expect(page.locator("#rows tr")).to_have_count(N_BIOBOTS)
    expect(page.get_by_role("button", name="Stop all")).to_contain_text("sign in first")
    story.keep("first-glance")
    page.get_by_role("button", name="Sign in", exact=True).click()
    page.get_by_label("Token", exact=True).fill(story.system.token)
    story.keep("signing-in")
    page.keyboard.press("Enter")
    expect(page.locator("#account-open")).to_have_text("operator · operator")


def starts_a_mission(story: Story) -> None:
    page = story.page
    page.get_by_role("tab", name="Mission").click()
    orders = page.get_by_role("group", name="Orders to the mission")
    orders.get_by_role("button", name="Start").click()
    story.keep("asked-back")
    page.get_by_role("button", name="Yes: start").click()
    page.locator("#mission-chip").evaluate(COLLECT, "phases")
    block = page.get_by_role("region", name="Mission of")
    expect(block).to_contain_text("Start: taken by")
    expect(block.locator("[aria-current='step']")).to_have_text("Exploration")
    expect(block).to_contain_text("20 landmarks")
    story.keep("exploration")
    seen = " ".join(page.evaluate("phases"))
    assert "exploration" in seen


def waits_for_two_holes(story: Story) -> None:
    page = story.page
    page.get_by_role("tab", name="Biobots").click()
    story.until(lambda: story.system.get("/api/v1/map/status")["n_encounters"] >= N_SETTLED, what=f"{N_SETTLED} encounters")
    expect(page.locator("#holes")).to_have_text("2")
    expect(page.locator("#holes-list tr[data-row^=h]")).to_have_count(2)
    expect(page.locator("#verdict")).to_be_hidden()
    told = page.evaluate("verdicts.concat(waits)")
    assert any("Likely enough in" in text or "a statement is likely in" in text for text in told), told
    story.keep("two-holes")


def finds_a_hole_by_its_bar(story: Story) -> None:
    page = story.page
    page.get_by_role("button", name="Barcode").click()
    chosen = page.locator("#holes-list tr[data-row^=h].chosen")

    def is_marked() -> bool:
        # Maps go on to come, and with each the bars are drawn anew: whoever points at one moves with it.
        page.mouse.move(0, 0)
        page.locator("#diagram rect[data-hole='1']").hover()
        return chosen.count() == 1

    story.until(is_marked, what="that the bar's hole is marked")
    label = page.locator("#diagram rect.chosen").get_attribute("aria-label") or ""
    assert label.startswith("hole ")
    story.keep("hovered-bar")
    page.mouse.move(0, 0)
    page.get_by_role("button", name="Diagram", exact=True).click()


def stops_one(story: Story) -> None:
    page = story.page
    page.get_by_label("Only").select_option("walking")
    key = page.locator("#rows tr:visible").first.get_attribute("data-key") or ""
    page.get_by_label("Only").select_option("")
    row = page.locator(f"#rows tr[data-key='{key}']")
    row.locator(".steps").evaluate(COLLECT, "steps")
    page.get_by_role("button", name=f"Stop biobot {key}", exact=True).click()
    expect(page.locator("#outcome")).to_contain_text(f"Stop biobot {key}: confirmed by the biobot")
    expect(row).to_contain_text("landmark")
    story.keep("one-stopped")
    stages = ["sent", "accepted by the gateway", "sent by the radio", "confirmed by the biobot"]
    told = [text.removeprefix(f"Stop biobot {key}: ").partition(":")[0] for text in page.evaluate("steps")]
    assert [stages.index(stage) for stage in told] == sorted(stages.index(stage) for stage in told)
    (command,) = (one for one in story.system.get("/api/v1/commands")["commands"] if one["origin"] == "here")
    assert [stage["stage"] for stage in command["stages"]] == ["accepted", "radio_confirmed", "biobot_confirmed"]
    assert command["stages"][-1]["mode"] == "S"  # said by the insect's own backpack
    page.get_by_role("button", name=f"More of biobot {key}", exact=True).click()
    panel = page.get_by_role("dialog", name=f"Biobot {key}")
    expect(panel).to_contain_text("next train")
    story.keep_everywhere("one-biobot")
    panel.get_by_role("button", name="Close").click()
    expect(panel).to_be_hidden()


def stops_all(story: Story) -> None:
    page = story.page
    panel = page.get_by_role("alert")

    def is_confirmed_by_all() -> bool:
        """Press, and press again where somebody has not confirmed in time: the page says who."""
        page.get_by_role("button", name="Stop all").click()
        try:
            expect(panel).to_contain_text(f"confirmed by {N_BIOBOTS} biobots", timeout=STOP_MS)
        except AssertionError:
            return False
        return True

    story.until(is_confirmed_by_all, what="that all have confirmed the stop")
    expect(page.locator("#mission-chip")).to_contain_text("mission paused")
    page.get_by_label("Only").select_option("walking")
    expect(page.locator("#rows tr:visible")).to_have_count(0)
    page.get_by_label("Only").select_option("")
    story.keep_everywhere("all-stopped")
    panel.get_by_role("button", name="Close").click()
    # Nobody meets anybody any more: the map stays as it is.
    story.until(lambda: _is_settled(story.system), what="the last map")
    page.get_by_role("tab", name="Alerts").click()
    story.keep("alerts")
    page.get_by_role("tab", name="Biobots").click()


def names_three_places(story: Story) -> None:
    page = story.page
    page.get_by_role("button", name="Places").click()
    options = page.locator("#pin-place option")
    chosen = [options.nth(k).get_attribute("value") or "" for k in (0, 7, 14)]
    places = zip(("door", "shaft", "stairs"), chosen, ((0, 0), (12, 3), (4, 15)), strict=True)
    for name, place, (x, y) in places:
        page.locator("#pin-name").fill(name)
        page.locator("#pin-place").select_option(place)
        page.locator("#pin-x").fill(str(x))
        page.locator("#pin-y").fill(str(y))
        page.get_by_role("button", name="Name it").click()
        expect(page.locator("#places-outcome")).to_have_text(f"{name} is on the map.")
    expect(page.locator("#pins-frame")).to_contain_text("in your frame")
    expect(page.locator("#orientation")).to_contain_text("in your frame")
    page.locator("#route-from").select_option("pin:door")
    page.locator("#route-to").select_option("pin:stairs")
    page.get_by_role("button", name="Show ways").click()
    expect(page.locator("#routes li").first).to_contain_text("A ")
    story.keep_everywhere("places", tab="Map")
    page.get_by_role("button", name="Clear").click()
    page.get_by_role("button", name="Diagram", exact=True).click()


def slides_back(story: Story) -> None:
    page = story.page
    when, holes = page.locator("#time-text"), page.locator("#holes")
    newest = holes.inner_text()
    page.locator("#time").focus()
    page.keyboard.press("Home")
    expect(when).to_contain_text("Since then")
    story.keep_everywhere("past", tab="Map")
    page.get_by_role("button", name="The next map").click()
    expect(page.locator("#go-live")).to_have_attribute("aria-pressed", "false")
    page.get_by_role("button", name="Live", exact=True).click()
    expect(when).to_contain_text("Live")
    expect(holes).to_have_text(newest)


def takes_files_home(story: Story) -> None:
    page = story.page
    page.get_by_role("button", name="Save", exact=True).click()
    document = json.loads(_saved(page, "map as GeoJSON"))
    kinds = [feature["properties"]["kind"] for feature in document["features"]]
    assert kinds.count("hole") == story.system.get("/api/v1/map")["betti_numbers"][1] >= 1
    assert {"landmark", "pin"} <= set(kinds)
    assert _saved(page, "map as PNG").startswith(b"\x89PNG\r\n\x1a\n")
    rows = list(csv.DictReader(_saved(page, "encounters as CSV").decode().splitlines()))
    assert len(rows) >= N_SETTLED
    assert all(float(row["t_start_s"]) <= float(row["t_end_s"]) for row in rows)
    report = _saved(page, "mission report as HTML to print").decode()
    for words in ("<html", "exploration", "operator", "stop all"):
        assert words in report, words
    expect(page.locator("#export-outcome")).to_contain_text("report.html is saved")
    story.keep_everywhere("saved", tab="Map")
    _read_report(story, report)


def _read_report(story: Story, report: str) -> None:
    """See the page that was saved, as a stranger opens it: by itself."""
    paper = story.page.context.browser.new_page() if story.page.context.browser else story.page
    paper.set_content(report)
    story.n_pictures += 1
    picture(paper, f"story-{story.n_pictures:02}-report")
    paper.close()


def _saved(page: Page, what: str) -> bytes:
    with page.expect_download() as download:
        page.get_by_role("button", name=f"Save {what}").click()
    return Path(download.value.path()).read_bytes()


def _is_settled(system: RunningSystem) -> bool:
    """Say whether the newest map is of all encounters there are."""
    status = system.get("/api/v1/map/status")
    return bool(status["n_encounters"] + status["n_before"] == status["n_known"])
