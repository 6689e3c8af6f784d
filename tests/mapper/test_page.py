"""The operator's page in a real browser: it works empty and full, on a desk and on a phone, and asks nobody but its own service."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, expect

from firmware_protocol.contract.commands import Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import Cause, EncounterRecord, Mode
from firmware_protocol.units import EVERYBODY, Nanoseconds, NodeId
from studies.chromium import CHROMIUM, launched
from studies.ports import free_port
from tests.mapper.browser_side import PHONE, WAIT_MS, fits_its_width, opened, picture, until, until_true
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.ring import ring_records
from tests.mapper.serving import serving, token_of
from tests.mapper.worlds import FIRST_LANDMARK

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH; apt-get install chromium"),
    pytest.mark.xdist_group("mapper page"),
]

# How many pixels of the canvas are of the colour that the style sheet gives to holes, within a little.
COUNT_HOLE_PIXELS = """() => {
  const canvas = document.getElementById("map-canvas");
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const probe = copy.getContext("2d", { willReadFrequently: true });
  probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--hole").trim();
  probe.fillRect(0, 0, 1, 1);
  const wanted = probe.getImageData(0, 0, 1, 1).data;
  probe.clearRect(0, 0, 1, 1);
  probe.drawImage(canvas, 0, 0);
  const { data } = probe.getImageData(0, 0, canvas.width, canvas.height);
  let n = 0;
  for (let i = 0; i < data.length; i += 4) n += [0, 1, 2].every((c) => Math.abs(data[i + c] - wanted[c]) < 12) && data[i + 3] > 200;
  return n;
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched() as chromium:
        yield chromium


def test_an_operator_sees_the_map_and_stops_a_biobot(browser: Browser, tmp_path: Path) -> None:
    port = free_port()
    records = ring_records()
    n_encounters = sum(isinstance(record, EncounterRecord) for record in records)
    with (
        FakeGateway(port=port) as gateway,
        serving(tmp_path, connect=port) as (url, _process),
        opened(browser, url, token=token_of(tmp_path)) as watched,
    ):
        page = watched.page
        expect(page.get_by_text("Waiting for encounters")).to_be_visible()
        expect(page.get_by_text("No gateway has reported a biobot yet.")).to_be_visible()
        picture(page, "page-empty")

        # The first statuses may be sent before the mapper is connected; a gateway repeats them.
        def live() -> bool:
            gateway.publish_status()
            return "live" in (page.locator("#link").text_content() or "")

        until(live)
        gateway.journal_records(records)
        gateway.publish_status()
        for walker in range(1, 6):
            gateway.publish_node(walker, heard_ns=time.time_ns(), battery_mv=3300 + 100 * walker)
        expect(page.locator("#encounters")).to_have_text(str(n_encounters))
        expect(page.locator("#components")).to_have_text("1")
        expect(page.locator("#holes")).to_have_text("1")
        expect(page.get_by_text("Waiting for encounters")).to_be_hidden()
        until_true(page, f"({COUNT_HOLE_PIXELS})() > 300")
        page.get_by_role("checkbox", name="holes").uncheck()
        until_true(page, f"({COUNT_HOLE_PIXELS})() < 50")
        page.get_by_role("checkbox", name="holes").check()
        assert "holes 1" in (page.locator("#map-canvas").get_attribute("aria-label") or "")
        expect(page.locator("#diagram circle[data-hole]")).to_have_count(1)
        page.get_by_role("button", name="Barcode").click()
        expect(page.locator("#diagram rect[data-hole]")).to_have_count(1)
        page.get_by_role("button", name="Diagram", exact=True).click()
        expect(page.locator("#rows").get_by_role("row")).to_have_count(20 + 5)
        expect(page.get_by_role("row").filter(has_text=str(FIRST_LANDMARK)).first).to_contain_text("landmark")
        expect(page.get_by_role("row").filter(has=page.get_by_role("button", name="Stop biobot 1", exact=True))).to_contain_text("3.40 V")

        page.get_by_role("button", name="Stop biobot 3", exact=True).click()
        expect(page.locator("#outcome")).to_contain_text("Stop biobot 3: confirmed by the biobot")
        assert [(command.node, command.action, command.operator) for command in gateway.commands] == [(3, StimulationAction.STOP, "anna")]
        gateway.publish_node(3, mode=Mode.S, cause=Cause.COMMAND, heard_ns=time.time_ns())
        expect(page.get_by_role("row").filter(has=page.get_by_role("button", name="Stop biobot 3", exact=True))).to_contain_text("landmark")
        page.get_by_label("Find biobots", exact=True).fill("walk")
        expect(page.locator("#rows tr:visible")).to_have_count(4)
        page.get_by_label("Find biobots", exact=True).fill("")
        assert fits_its_width(page)
        until_true(page, f"({COUNT_HOLE_PIXELS})() > 300")
        picture(page, "page-light")
        with opened(browser, url, token=token_of(tmp_path), scheme="dark") as dark:
            expect(dark.page.locator("#holes")).to_have_text("1")
            until_true(dark.page, f"({COUNT_HOLE_PIXELS})() > 300")
            picture(dark.page, "page-dark")
        with opened(browser, url, token=token_of(tmp_path), size=PHONE) as phone:
            expect(phone.page.locator("#holes")).to_have_text("1")
            until_true(phone.page, f"({COUNT_HOLE_PIXELS})() > 100")
            assert fits_its_width(phone.page)
            picture(phone.page, "page-phone")


def test_the_page_can_be_used_with_the_keyboard_alone(browser: Browser, tmp_path: Path) -> None:
    port = free_port()
    with (
        FakeGateway(port=port) as gateway,
        serving(tmp_path, connect=port) as (url, _process),
        opened(browser, url, token=token_of(tmp_path)) as watched,
    ):
        page = watched.page

        def known() -> bool:
            gateway.publish_status()
            gateway.publish_node(8, heard_ns=time.time_ns())
            return page.get_by_role("button", name="Stop biobot 8").count() > 0

        until(known)
        for _ in range(40):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.getAttribute('aria-label')") == "Stop biobot 8":
                break
        page.keyboard.press("Enter")
        expect(page.locator("#outcome")).to_contain_text("confirmed by the biobot")
        assert len(gateway.commands) == 1


def test_a_start_pressed_twice_is_given_once_and_a_stop_meanwhile_goes_out(browser: Browser, tmp_path: Path) -> None:
    port = free_port()
    with (
        FakeGateway(port=port) as gateway,
        serving(tmp_path, connect=port) as (url, _process),
        opened(browser, url, token=token_of(tmp_path)) as watched,
    ):
        page = watched.page

        def slowly(request: StimulationRequest) -> Iterator[Stage]:
            yield Stage.ACCEPTED
            deadline = time.monotonic() + WAIT_MS / 1000
            while request.action is StimulationAction.START and len(gateway.commands) < 2 and time.monotonic() < deadline:
                time.sleep(0.02)
            yield Stage.BIOBOT_CONFIRMED

        gateway.answer = slowly

        def known() -> bool:
            gateway.publish_status()
            gateway.publish_node(8, heard_ns=time.time_ns())
            return page.get_by_role("button", name="Start biobot 8").count() > 0

        until(known)
        start = page.get_by_role("button", name="Start biobot 8")
        start.click()
        expect(start).to_be_disabled()
        page.get_by_role("button", name="Stop biobot 8").click()
        expect(start).to_be_enabled()
        assert [command.action for command in gateway.commands] == [StimulationAction.START, StimulationAction.STOP]


def test_a_page_says_that_its_map_is_of_a_window_and_by_another_method(browser: Browser, tmp_path: Path) -> None:
    port = free_port()
    arguments = ["--window-s", "40", "--method", "paper"]
    with FakeGateway(port=port) as gateway, serving(tmp_path, connect=port, arguments=arguments) as (url, _process):
        gateway.journal_records(ring_records())

        def has_map() -> bool:
            gateway.publish_status()
            return bool(httpx.get(url + "api/v1/map", timeout=60).status_code == httpx.codes.OK)

        until(has_map)
        with opened(browser, url, token=token_of(tmp_path)) as watched:
            expect(watched.page.locator("#notices")).to_contain_text('a map of the last 40 s · by the method "paper"')


def test_one_press_stops_all_and_says_who_confirmed(browser: Browser, tmp_path: Path) -> None:
    port = free_port()
    with (
        FakeGateway(port=port) as gateway,
        serving(tmp_path, connect=port) as (url, _process),
        opened(browser, url, token=token_of(tmp_path)) as watched,
    ):
        page = watched.page
        is_free = threading.Event()

        def stop_all(request: StimulationRequest) -> Iterator[Stage]:
            yield Stage.ACCEPTED
            for node, end in ((3, Stage.BIOBOT_CONFIRMED), (4, Stage.BIOBOT_CONFIRMED), (5, Stage.UNKNOWN)):
                part = StimulationRequest(
                    command_id=f"part-{node}",
                    node=NodeId(node),
                    action=StimulationAction.STOP,
                    operator=request.operator,
                    issued_wall_ns=Nanoseconds(0),
                )
                gateway.publish_stage(gateway.stage_of(part, Stage.ACCEPTED, part_of=request.command_id))
                gateway.publish_stage(gateway.stage_of(part, end, part_of=request.command_id))
            yield Stage.RADIO_CONFIRMED
            is_free.wait(WAIT_MS / 1000)
            yield Stage.UNKNOWN

        gateway.answer = stop_all

        def is_live() -> bool:
            gateway.publish_status()
            return "live" in (page.locator("#link").text_content() or "")

        until(is_live)
        page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
        button = page.get_by_role("button", name="Stop all")
        expect(button).to_be_in_viewport()
        for _ in range(40):
            page.keyboard.press("Shift+Tab")
            if page.evaluate("document.activeElement.id") == "emergency":
                break
        page.keyboard.press("Enter")
        panel = page.get_by_role("alert")
        expect(panel).to_contain_text("gateway1: sent by the radio")
        expect(panel).to_contain_text("confirmed by 2 biobots: 3, 4")
        expect(panel).to_contain_text("not by biobot 5")
        is_free.set()
        expect(panel).to_contain_text("not confirmed by all")
        (command,) = gateway.commands
        assert (command.node, command.action, command.operator) == (EVERYBODY, StimulationAction.STOP_ALL, "anna")
        picture(page, "page-stop")
        gateway.answer = lambda _request: (Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)
        with opened(browser, url, token=token_of(tmp_path), size=PHONE) as phone:
            phone.page.mouse.wheel(0, 2000)
            phone.page.get_by_role("button", name="Stop all").click()
            expect(phone.page.get_by_role("alert")).to_contain_text("confirmed by all that can be reached")
            assert fits_its_width(phone.page)
            picture(phone.page, "page-stop-phone")
        assert len(gateway.commands) == 2
        page.get_by_role("button", name="Close").click()
        expect(panel).to_be_hidden()
        expect(button).to_be_focused()
