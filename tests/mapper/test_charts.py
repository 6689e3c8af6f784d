"""What the page shows of a map, and what can be done with it, in a real browser: a simulated site with two obstacles, as it gets known."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from firmware_protocol.contract.records import EncounterRecord
from studies.chromium import CHROMIUM, launched
from studies.ports import free_port
from tests.mapper.browser_side import DESK, PHONE, accessibility_faults, fits_its_width, opened, picture, tab_to, until, until_true
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.serving import serving, token_of
from tests.mapper.two_holes import two_holes

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH; apt-get install chromium"),
    pytest.mark.xdist_group("mapper page"),
]

N_EARLY = 330
GRID_PX = 24
# Pixels of the canvas that are of a colour of the style sheet, within a little.
COUNT_PIXELS = """(name) => {
  const canvas = document.getElementById("map-canvas");
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const probe = copy.getContext("2d", { willReadFrequently: true });
  probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  probe.fillRect(0, 0, 1, 1);
  const wanted = probe.getImageData(0, 0, 1, 1).data;
  probe.clearRect(0, 0, 1, 1);
  probe.drawImage(canvas, 0, 0);
  const { data } = probe.getImageData(0, 0, canvas.width, canvas.height);
  let n = 0;
  for (let i = 0; i < data.length; i += 4) n += [0, 1, 2].every((c) => Math.abs(data[i + c] - wanted[c]) < 12) && data[i + 3] > 200;
  return n;
}"""


@dataclass(frozen=True)
class Early:
    """What was said of too little data."""

    verdict: str
    holes: str


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Page, Early]]:
    """One page that sees a site become known: nothing, then too little for a statement, then two holes. Each test leaves it as it was."""
    directory = tmp_path_factory.mktemp("charts")
    records = two_holes(directory / "run")
    n_modes = sum(not isinstance(record, EncounterRecord) for record in records)
    port = free_port()
    with ExitStack() as stack:
        browser = stack.enter_context(launched())
        gateway = stack.enter_context(FakeGateway(port=port))
        url, _process = stack.enter_context(serving(directory, connect=port, arguments=["--min-interval-s", "0.1"]))
        token = token_of(directory)
        client = stack.enter_context(httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=60))

        def knows(n_encounters: int) -> bool:
            gateway.publish_status()
            answer = client.get("api/v1/map/status").json()
            return bool(answer["n_encounters"] == n_encounters)

        # How well encounters cover the place is not known before they were first looked at.
        page = stack.enter_context(opened(browser, url, token=token, motion="reduce", expected=(r"status of 503",))).page
        expect(page.get_by_text("Waiting for encounters")).to_be_visible()
        gateway.journal_records(records[: n_modes + N_EARLY])
        until(lambda: knows(N_EARLY))
        expect(page.locator("#holes")).to_have_text("?")
        expect(page.locator("#verdict")).to_contain_text("Likely")
        early = Early(verdict=page.locator("#verdict").inner_text(), holes=page.locator("#holes").inner_text())
        picture(page, "charts-not-enough")
        gateway.journal_records(records[n_modes + N_EARLY :])
        until(lambda: knows(len(records) - n_modes))
        expect(page.locator("#holes")).to_have_text("2")
        yield page, early


@pytest.fixture
def page(site: tuple[Page, Early]) -> Page:
    return site[0]


def test_too_little_is_said_in_place_of_holes_with_reason_remedy_and_time(site: tuple[Page, Early]) -> None:
    page, early = site
    assert early.holes == "?"
    assert early.verdict.startswith("Not enough data yet")
    for word in ("Likely enough in about", "Why:", "What helps:"):
        assert word in early.verdict
    expect(page.locator("#verdict")).to_be_hidden()
    assert "holes 2 (hole 1" in (page.locator("#map-canvas").get_attribute("aria-label") or "")


def test_whatever_is_pointed_at_is_marked_everywhere(page: Page) -> None:
    dots, rows = page.locator("#diagram circle[data-hole]"), page.locator("#holes-list tr[data-row^=h]")
    expect(dots).to_have_count(2)
    plain = page.evaluate(COUNT_PIXELS, "--hole")
    dots.nth(1).hover()
    expect(page.locator("#holes-list tr.chosen")).to_have_count(1)
    until_true(page, f"({COUNT_PIXELS})('--hole') > {plain + 100}")
    page.get_by_role("button", name="Barcode").click()
    expect(page.locator("#diagram rect[data-hole]")).to_have_count(2)
    page.locator("#diagram rect[data-hole='0']").hover()
    expect(rows.nth(0)).to_have_class("chosen")
    rows.nth(1).hover()
    expect(page.locator("#diagram rect[data-hole='1']")).to_have_class("real1 chosen")
    box = page.locator("#map-canvas").bounding_box()
    assert box is not None
    found = set()
    for x in range(0, int(box["width"]), GRID_PX):
        for y in range(0, int(box["height"]), GRID_PX):
            page.mouse.move(box["x"] + x, box["y"] + y)
            found |= set(page.evaluate("[...document.querySelectorAll('#diagram .chosen')].map((mark) => mark.dataset.hole)"))
        if found == {"0", "1"}:
            break
    assert found == {"0", "1"}
    page.mouse.move(0, 0)
    page.get_by_role("button", name="Diagram", exact=True).click()


def test_a_hole_is_kept_marked_by_keyboard(page: Page) -> None:
    tab_to(page, "#holes-list button")
    expect(page.locator("#holes-list tr.chosen")).to_have_count(1)
    page.keyboard.press("Enter")
    page.locator("#map-canvas").focus()
    expect(page.locator("#diagram [aria-pressed=true]")).to_have_count(1)
    for key in ("+", "ArrowLeft", "ArrowUp", "-", "0"):
        page.keyboard.press(key)
    expect(page.locator("#holes-list tr.chosen")).to_have_count(1)
    page.locator("#holes-list button[aria-pressed=true]").press("Enter")
    page.locator("#map-canvas").focus()
    expect(page.locator("#holes-list tr.chosen")).to_have_count(0)


def test_one_slides_back_and_returns(page: Page) -> None:
    slider, when = page.locator("#time"), page.locator("#time-text")
    expect(when).to_contain_text("Live")
    slider.focus()
    page.keyboard.press("Home")
    expect(when).to_contain_text("Since then")
    expect(when).to_contain_text("is new")
    expect(page.locator("#verdict")).to_be_visible()
    expect(page.locator("#holes")).to_have_text("?")
    picture(page, "charts-past")
    page.keyboard.press("Escape")
    expect(page.locator("#holes")).to_have_text("2")
    page.get_by_role("button", name="The map before").click()
    expect(page.locator("#go-live")).to_have_attribute("aria-pressed", "false")
    page.get_by_role("button", name="Live", exact=True).click()
    expect(when).to_contain_text("Live")


def test_three_pins_lay_the_map_into_the_operators_frame_and_ways_are_found_between_them(page: Page) -> None:
    page.get_by_role("button", name="Places").click()
    options = page.locator("#pin-place option")
    chosen = [options.nth(k).get_attribute("value") or "" for k in (0, 7, 14)]
    for name, place, at in zip(("door", "shaft", "stairs"), chosen, ((0, 0), (12, 3), (4, 15)), strict=True):
        page.locator("#pin-name").fill(name)
        page.locator("#pin-place").select_option(place)
        page.locator("#pin-x").fill(str(at[0]))
        page.locator("#pin-y").fill(str(at[1]))
        page.get_by_role("button", name="Name it").click()
        expect(page.locator("#places-outcome")).to_have_text(f"{name} is on the map.")
    expect(page.locator("#pins-frame")).to_contain_text("in your frame")
    expect(page.locator("#orientation")).to_contain_text("in your frame")
    until_true(page, f"({COUNT_PIXELS})('--pin') > 300")
    page.locator("#route-from").select_option("pin:door")
    page.locator("#route-to").select_option("pin:stairs")
    page.get_by_role("button", name="Show ways").click()
    expect(page.locator("#routes li").first).to_contain_text("A ")
    until_true(page, f"({COUNT_PIXELS})('--route') > 200")
    picture(page, "charts-places")
    page.get_by_role("button", name="Clear").click()
    expect(page.locator("#routes li")).to_have_count(0)
    for name in ("door", "shaft", "stairs"):
        page.get_by_role("button", name=f"Remove {name}").click()
        expect(page.locator(".pins")).not_to_contain_text(name)
    expect(page.locator("#orientation")).to_contain_text("turned or mirrored")


def test_a_place_is_taken_from_the_map_by_keyboard(page: Page) -> None:
    page.locator("#map-canvas").focus()
    for key in ("+", "+", "ArrowRight"):
        page.keyboard.press(key)
    page.keyboard.press("Enter")
    spot = page.locator("#spot")
    if not spot.is_visible():
        # A hole is in the middle: beside it is ground.
        page.locator("#map-canvas").click(position={"x": 40, "y": 200})
    expect(spot).to_be_visible()
    page.keyboard.press("Enter")
    expect(page.locator("#pin-name")).to_be_focused()
    page.keyboard.type("pit")
    page.keyboard.press("Enter")
    expect(page.locator(".pins")).to_contain_text("pit")
    page.get_by_role("button", name="Remove pit").click()
    expect(page.locator(".pins")).not_to_contain_text("pit")
    page.locator("#zoom-fit").click()
    page.get_by_role("button", name="Diagram", exact=True).click()


def test_another_scale_opens_and_closes_the_ground(page: Page) -> None:
    value = page.locator("#epsilon")
    own = value.inner_text()
    with page.expect_response(lambda response: "/api/v1/map/lengths" in response.url) as answer:
        page.locator("#scale").focus()
        page.keyboard.press("ArrowRight")
    assert answer.value.ok
    expect(value).not_to_have_text(own)
    page.keyboard.press("Home")
    expect(value).to_have_text("0 s")
    page.get_by_role("button", name="auto", exact=True).click()
    expect(value).to_have_text(own)


def test_what_is_shown_can_be_saved(page: Page) -> None:
    page.get_by_role("button", name="Save", exact=True).click()
    # Pictures take seconds to draw; that they come is held in test_api.py.
    for name, least in (
        ("mission report as HTML to print", b"<html"),
        ("map as GeoJSON", b"FeatureCollection"),
    ):
        with page.expect_download() as download:
            page.get_by_role("button", name=f"Save {name}").click()
        assert least in Path(download.value.path()).read_bytes()
    expect(page.locator("#export-outcome")).to_contain_text("map.geojson is saved")
    page.get_by_role("button", name="Diagram", exact=True).click()


def test_it_is_readable_at_every_size_and_theme_and_nobody_is_left_out(page: Page) -> None:
    for name, (width, height), scheme in (
        ("phone-dark", PHONE, "dark"),
        ("phone-light", PHONE, "light"),
        ("desk-dark", DESK, "dark"),
        ("desk-light", DESK, "light"),
    ):
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        until_true(page, f"document.documentElement.dataset.theme === '{scheme}' && ({COUNT_PIXELS})('--hole') > 300")
        assert fits_its_width(page)
        picture(page, f"charts-{name}")
        if name in {"phone-dark", "desk-light"}:
            assert accessibility_faults(page) == []
