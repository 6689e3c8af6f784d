"""An operator at the page, with all parts as real processes: simulated insects and radio, gateway, mapper, browser."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from studies.chromium import CHROMIUM, launched
from studies.system import RunningSystem, SystemSettings
from tests.mapper.browser_side import opened, picture, until

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH; apt-get install chromium"),
    pytest.mark.timeout(280),
]

PATIENCE_MS = 60_000
N_BIOBOTS = 16
# Every text that the steps of a command had, in order: none is missed, however short it stood.
KEEP_STEPS = """(steps) => {
  window.kept = [];
  const keep = () => kept.at(-1) !== steps.ariaLabel && kept.push(steps.ariaLabel);
  new MutationObserver(keep).observe(steps, { attributeFilter: ["aria-label"] });
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched() as chromium:
        yield chromium


def sign_in(page: Page, token: str) -> None:
    page.get_by_role("button", name="Sign in", exact=True).click()
    page.get_by_label("Token", exact=True).fill(token)
    page.keyboard.press("Enter")
    expect(page.locator("#account-open")).to_contain_text("operator")


def test_an_operator_signs_in_stops_one_insect_pauses_the_mission_stops_all_and_sees_the_radio_fail(
    browser: Browser, tmp_path: Path
) -> None:
    settings = SystemSettings(out=tmp_path, seed=21, speed=8, n_biobots=N_BIOBOTS, n_landmarks=4, dispersion_s=2, exploration_s=300)
    with RunningSystem(settings=settings) as system, opened(browser, system.url + "/") as watched:
        page = watched.page
        page.set_default_timeout(PATIENCE_MS)
        sign_in(page, system.token)
        expect(page.locator("#mission-chip")).to_contain_text("exploration", timeout=PATIENCE_MS)
        expect(page.locator("#rows tr.online")).to_have_count(N_BIOBOTS, timeout=PATIENCE_MS)
        walker = page.locator("#rows tr", has_text="walking").first
        key = walker.get_attribute("data-key")
        steps = page.locator(f"#rows tr[data-key='{key}'] .steps")
        steps.evaluate(KEEP_STEPS)
        page.get_by_role("button", name=f"Stop biobot {key}", exact=True).click()
        expect(page.locator("#outcome")).to_contain_text(f"Stop biobot {key}: confirmed by the biobot", timeout=PATIENCE_MS)
        stages = ["sent", "accepted by the gateway", "sent by the radio", "confirmed by the biobot"]
        texts = [text.removeprefix(f"Stop biobot {key}: ") for text in page.evaluate("kept")]
        kept = [stages.index(text.partition(":")[0]) for text in texts]  # a stop may say besides why it has no train
        assert kept == sorted(kept)
        assert kept[-1] == len(stages) - 1
        (told,) = (one for one in system.get("/api/v1/commands")["commands"] if one["origin"] == "here")
        assert [stage["stage"] for stage in told["stages"]] == ["accepted", "radio_confirmed", "biobot_confirmed"]
        expect(page.locator(f"#rows tr[data-key='{key}']")).to_contain_text("landmark", timeout=PATIENCE_MS)

        page.get_by_role("tab", name="Mission").click()
        orders = page.get_by_role("group", name="Orders to the mission")
        orders.get_by_role("button", name="Pause").click()
        expect(page.locator("#mission-chip")).to_contain_text("mission paused", timeout=PATIENCE_MS)
        orders.get_by_role("button", name="Resume").click()
        page.get_by_role("button", name="Yes: resume").click()
        expect(page.locator("#mission-chip")).to_contain_text("exploration", timeout=PATIENCE_MS)

        until(lambda: system.get("/api/v1/map/status")["version"] is not None)  # who stands meets too few for the first map
        page.keyboard.press("Control+Shift+X")
        panel = page.get_by_role("alert")
        expect(panel).to_contain_text(f"confirmed by {N_BIOBOTS} biobots", timeout=PATIENCE_MS)
        expect(page.locator("#mission-chip")).to_contain_text("mission paused", timeout=PATIENCE_MS)
        expect(page.get_by_role("region", name="Newest commands")).to_contain_text(f"stop all by {told['operator']}")
        page.get_by_role("tab", name="Biobots").click()
        expect(page.locator("#rows tr", has_text="walking")).to_have_count(0, timeout=PATIENCE_MS)
        picture(page, "operator-stopped-all")
        # Who stands near another goes on reporting it: a map that was begun since knows all that the page does.
        before = system.get("/api/v1/map/status")["version"]
        until(lambda: (now := system.get("/api/v1/map/status"))["n_waiting"] == 0 or now["version"] >= before + 2)
        chosen = {str(one) for one in system.get("/api/v1/mission")["gateways"][0]["landmarks"]}
        landmarks = {str(one) for one in system.get("/api/v1/coverage")["landmarks"]}
        assert chosen <= landmarks <= chosen | {key}, "who stands because all were stopped is no landmark"

        # Its terminal's number is given to the next who asks for one, in another test; the name must not lead there.
        (tmp_path / "radio").unlink()
        system.process("simulator").kill()
        expect(page.locator("#link")).to_contain_text("radio", timeout=PATIENCE_MS)
        page.get_by_role("tab", name="Alerts").click()
        alert = page.get_by_role("list", name="Alerts that hold").get_by_role("listitem").filter(has_text="radio").first
        expect(alert).to_be_visible(timeout=PATIENCE_MS)
        picture(page, "operator-radio-down")
        alert.get_by_role("button", name="Acknowledge").click()
        expect(alert).to_contain_text(f"acknowledged by {told['operator']}")
