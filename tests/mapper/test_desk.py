"""What stands around the map: who is signed in, the table of biobots, missions, the stop; for every size, theme and way to use it."""

import re
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from playwright.sync_api import Browser, Page, expect

from firmware_protocol.contract.commands import PulseRequest, Stage, StimulationAction, StimulationRequest, WaveformName
from firmware_protocol.contract.mission_orders import MissionAction
from firmware_protocol.contract.records import Cause, MissionPhase, Mode
from firmware_protocol.units import EVERYBODY
from mapper.access import Role, add_token, revoke_token
from studies.chromium import CHROMIUM, launched
from studies.ports import free_port
from tests.mapper.browser_side import DESK, PHONE, WAIT_MS, Watched, accessibility_faults, fits_its_width, opened, picture, tab_to, until
from tests.mapper.fake_gateway import FakeGateway, account, mission
from tests.mapper.serving import serving, shown, token_of

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH; apt-get install chromium"),
    pytest.mark.xdist_group("mapper desk"),
]

S = 1_000_000_000
LOST, LOW, STILL = 3, 4, 5
ALSO_LOW = {6, 7, 8}
N_BIOBOTS = 12
# What browsers say by themselves of answers that the page shows in words.
REFUSED = (r"status of 401", r"status of 403", r"status of 409")


@dataclass(frozen=True)
class Site:
    """A gateway with biobots, and a mapper with its page."""

    gateway: FakeGateway
    url: str
    browser: Browser
    directory: Path

    def token(self, role: Role) -> str:
        if role is Role.OPERATOR:
            return token_of(self.directory)
        secret = self.directory / f"token-{role.value}"
        if not secret.exists():
            add_token(self.directory / "tokens.json", name="vera", role=role, secret_file=secret)
        return secret.read_text().strip()

    def get(self, path: str) -> Any:
        return httpx.get(self.url.rstrip("/") + path, headers=shown(self.directory)).json()

    def publish(self) -> None:
        self.gateway.publish_status()
        for node in range(1, N_BIOBOTS + 1):
            is_still = node == STILL
            self.gateway.publish_node(
                node,
                heard_ns=time.time_ns() - (300 * S if node == LOST else 0),
                battery_mv=2050 if node == LOW else 2060 if node in ALSO_LOW else 3900 + node,
                mode=Mode.S if is_still else Mode.CRW,
                cause=Cause.NATURAL,
            )

    def known(self, page: Page) -> Page:
        """Wait until a page shows all biobots."""

        def is_known() -> bool:
            self.publish()
            return bool(page.locator("#rows tr").count() == N_BIOBOTS)

        until(is_known)
        return page


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    directory = tmp_path_factory.mktemp("site")
    port = free_port()
    with ExitStack() as stack:
        gateway = stack.enter_context(FakeGateway(port=port))
        gateway.clock = time.time_ns
        browser = stack.enter_context(launched())
        config = directory / "mapper.toml"
        config.write_text("[alerts]\nlost_s = 240\n")  # on a busy machine a test takes longer than the minute that it is by default
        url, _process = stack.enter_context(serving(directory, connect=port, arguments=["--config", str(config)]))
        is_over = threading.Event()

        def beat() -> None:
            """Speak every second, as gateways do: one that is silent is away."""
            while not is_over.wait(1.0):
                gateway.publish_status()

        beating = threading.Thread(target=beat)
        beating.start()
        try:
            yield Site(gateway=gateway, url=url, browser=browser, directory=directory)
        finally:
            is_over.set()
            beating.join()


@pytest.fixture
def operator(site: Site) -> Iterator[Watched]:
    site.gateway.forget_commands()
    site.gateway.orders.clear()
    with opened(site.browser, site.url, token=site.token(Role.OPERATOR), expected=REFUSED) as watched:
        site.known(watched.page)
        yield watched


def row(page: Page, node: int) -> Any:
    return page.locator(f"#rows tr[data-key='{node}']")


def test_who_is_not_signed_in_looks_and_signs_in_and_out(site: Site) -> None:
    site.gateway.forget_commands()
    with opened(site.browser, site.url, expected=REFUSED) as watched:
        page = site.known(watched.page)
        start = page.get_by_role("button", name="Start biobot 1", exact=True)
        expect(start).to_be_disabled()
        start.click(force=True)
        expect(page.locator("#message")).to_contain_text("This needs the role operator; you are not signed in")
        page.get_by_role("button", name="Sign in", exact=True).click()
        expect(page.get_by_label("Token", exact=True)).to_be_focused()
        for wrong in ("", "biobot_0_nobody", "two words"):
            page.get_by_label("Token", exact=True).fill(wrong)
            page.keyboard.press("Enter")
            expect(page.locator("#sign-in-fault")).not_to_be_empty()
            expect(page.get_by_label("Token", exact=True)).to_be_focused()
        page.get_by_label("Token", exact=True).fill(site.token(Role.OPERATOR))
        page.keyboard.press("Enter")
        account = page.locator("#account-open")
        expect(account).to_have_text("anna · operator")
        expect(page.locator("#account")).to_be_hidden()
        expect(account).to_be_focused()
        expect(start).to_be_enabled()
        start.click()
        expect(page.locator("#outcome")).to_contain_text("Start biobot 1: confirmed by the biobot")
        page.reload()
        expect(account).to_have_text("anna · operator")
        assert site.token(Role.OPERATOR) not in page.evaluate(
            "location.href + JSON.stringify(localStorage) + document.documentElement.outerHTML"
        )
        account.click()
        page.get_by_role("button", name="Sign out").click()
        expect(account).to_have_text("Sign in")
        expect(site.known(page).get_by_role("button", name="Start biobot 1", exact=True)).to_be_disabled()
        assert page.evaluate("sessionStorage.length") == 0
    assert [(command.node, command.operator) for command in site.gateway.commands] == [(1, "anna")]


def test_a_token_that_is_revoked_meanwhile_is_asked_for_again(site: Site) -> None:
    tokens, secret = site.directory / "tokens.json", site.directory / "token-of-otto"
    token_id = add_token(tokens, name="otto", role=Role.OPERATOR, secret_file=secret).record.id
    with opened(site.browser, site.url, token=secret.read_text().strip(), expected=REFUSED) as watched:
        page = site.known(watched.page)
        expect(page.locator("#account-open")).to_have_text("otto · operator")
        revoke_token(tokens, token_id=token_id, keeps_admin=False)
        page.get_by_role("button", name="Stop biobot 1", exact=True).click()
        # The mapper looks at the file once a second: a stop that is quicker passes, and the page learns of it when its stream ends.
        expect(page.locator("#sign-in-fault")).to_have_text("The token is not valid any more. Sign in again.")
        expect(page.locator("#account-open")).to_have_text("Sign in")
        expect(page.get_by_role("button", name="Stop biobot 1", exact=True)).to_be_disabled()
        # This mapper shows what there is to whoever is on its machine, also after a stop that was refused.
        page.keyboard.press("Control+Shift+X")
        expect(page.get_by_role("alert")).to_contain_text("NOT stopped")
        expect(page.locator("#account-words")).to_have_text("You may look. Commands need a token with the role operator.")
        expect(page.locator("#link")).to_contain_text("live")
        assert page.evaluate("document.body.dataset.role") == "viewer"
        page.get_by_label("Token", exact=True).fill(site.token(Role.OPERATOR))
        page.keyboard.press("Enter")
        expect(page.locator("#account-open")).to_have_text("anna · operator")
        expect(page.locator("#link")).to_contain_text("live")


def test_a_stop_without_the_role_is_sent_and_says_that_it_was_refused(site: Site) -> None:
    site.gateway.forget_commands()
    with opened(site.browser, site.url, token=site.token(Role.VIEWER), expected=REFUSED) as watched:
        page = site.known(watched.page)
        expect(page.locator("#account-open")).to_have_text("vera · viewer")
        button = page.get_by_role("button", name="Stop all")
        expect(button).to_be_enabled()
        expect(button).to_contain_text("not as viewer")
        button.click()
        panel = page.get_by_role("alert")
        expect(panel).to_contain_text("NOT stopped")
        expect(panel).to_contain_text("operator")
        expect(panel).to_contain_text("biobot-gateway stop --all")
    assert site.gateway.commands == []


def test_the_keys_of_the_stop_work_from_a_field_and_with_a_panel_open(site: Site, operator: Watched) -> None:
    page = operator.page
    page.get_by_role("button", name="Help").click()
    expect(page.locator("#help")).to_be_visible()
    page.get_by_label("Find biobots", exact=True).focus()
    page.keyboard.press("Control+Shift+X")
    expect(page.get_by_role("alert")).to_contain_text("confirmed by all that can be reached")
    assert [(command.node, command.action, command.operator) for command in site.gateway.commands] == [
        (EVERYBODY, StimulationAction.STOP_ALL, "anna")
    ]
    expect(page.get_by_role("button", name="Stop all")).to_be_in_viewport()


def test_the_table_says_who_is_lost_and_finds_and_sorts(site: Site, operator: Watched) -> None:
    page = operator.page
    expect(row(page, LOST)).to_contain_text("lost")
    expect(row(page, 1)).to_contain_text("online")
    expect(row(page, STILL)).to_contain_text("still")
    expect(page.locator("#swarm")).to_have_text(f"{N_BIOBOTS - 1} online, 1 lost")
    page.locator("#swarm").click()
    expect(page.get_by_label("Only")).to_have_value("lost")
    expect(page.locator("#rows tr:visible")).to_have_count(1)
    expect(page.locator("#shown")).to_have_text(f"1 of {N_BIOBOTS}")
    page.get_by_label("Only").select_option("low")
    expect(page.locator("#rows tr:visible")).to_have_count(1 + len(ALSO_LOW))
    expect(row(page, LOW)).to_be_visible()
    page.get_by_label("Only").select_option("")
    page.get_by_label("Find biobots", exact=True).fill("gateway1 walk")
    expect(page.locator("#rows tr:visible")).to_have_count(N_BIOBOTS - 1)
    page.get_by_label("Find biobots", exact=True).fill("nobody")
    expect(page.locator("#no-rows")).to_have_text("No biobot is like that.")
    page.get_by_label("Find biobots", exact=True).fill("")
    heading = page.get_by_role("columnheader", name="battery")
    heading.get_by_role("button").click()
    expect(heading).to_have_attribute("aria-sort", "ascending")
    expect(page.locator("#rows tr").first).to_have_attribute("data-key", str(LOW))
    heading.get_by_role("button").click()
    expect(heading).to_have_attribute("aria-sort", "descending")
    expect(page.locator("#rows tr").last).to_have_attribute("data-key", str(LOW))
    # Nothing moves under the pointer or the focus: a press must not meet another biobot.
    page.get_by_role("button", name=f"Stop biobot {LOW}", exact=True).focus()
    site.gateway.publish_node(LOW, heard_ns=time.time_ns(), battery_mv=4100)
    expect(row(page, LOW)).to_contain_text("4.10 V")
    expect(page.locator("#rows tr").last).to_have_attribute("data-key", str(LOW))
    page.get_by_label("Find biobots", exact=True).focus()
    site.publish()
    site.gateway.publish_node(LOW, heard_ns=time.time_ns(), battery_mv=4100)
    expect(page.locator("#rows tr").first).to_have_attribute("data-key", str(LOW))
    assert site.gateway.commands == []


def test_a_command_shows_its_stages_and_a_second_start_says_why_it_waits(site: Site, operator: Watched) -> None:
    page = operator.page

    def in_step(request: StimulationRequest) -> Iterator[Stage]:
        """Go on when the page has shown the stage before; a start of 2 goes on when its stop has come."""
        yield Stage.ACCEPTED
        deadline = time.monotonic() + WAIT_MS / 1000
        while request.action is StimulationAction.START and len(site.gateway.commands) < 2 and time.monotonic() < deadline:
            time.sleep(0.02)
        yield Stage.REFUSED if request.action is StimulationAction.START else Stage.BIOBOT_CONFIRMED

    before, site.gateway.answer = site.gateway.answer, in_step
    try:
        steps = row(page, 2).get_by_role("img")
        page.get_by_role("button", name="Start biobot 2", exact=True).click()
        expect(steps).to_have_attribute("aria-label", "Start biobot 2: accepted by the gateway")
        expect(page.get_by_role("button", name="Turn biobot 2 left")).to_be_disabled()
        page.get_by_role("button", name="Turn biobot 2 left").click(force=True)
        expect(page.locator("#message")).to_contain_text("Biobot 2 has a command under way; only a stop can follow")
        page.get_by_role("button", name="Stop biobot 2", exact=True).click()
        expect(page.get_by_role("button", name="Turn biobot 2 left")).to_be_enabled()
    finally:
        site.gateway.answer = before
    assert [command.action for command in site.gateway.commands] == [StimulationAction.START, StimulationAction.STOP]
    page.get_by_role("button", name="Turn biobot 2 right").click()
    expect(page.locator("#outcome")).to_contain_text("Turn biobot 2 right: confirmed by the biobot")
    expect(steps).to_have_attribute("aria-label", "Turn biobot 2 right: confirmed by the biobot")
    page.get_by_role("tab", name="Mission").click()
    expect(page.get_by_role("region", name="Newest commands")).to_contain_text("turn right biobot 2 by anna")


def test_what_is_not_needed_every_minute_is_in_a_panel_that_tells_what_spares_the_animal(site: Site, operator: Watched) -> None:
    page, gateway = operator.page, site.gateway
    until(lambda: bool(gateway.commanders))  # the mapper may move biobots for a while from when it has its name
    gateway.publish_account(account(1, n_trains=12))
    until(lambda: bool(site.get("/api/v1/biobots/1/stimulation")["accounts"]))
    more = page.get_by_role("button", name="More of biobot 1", exact=True)
    more.click()
    panel = page.get_by_role("dialog", name="Biobot 1")
    expect(panel.get_by_role("heading", name="Biobot 1")).to_be_focused()
    expect(panel).to_contain_text("online, heard")
    expect(panel).to_contain_text("12 trains")
    panel.get_by_role("button", name="Let biobot 1 follow walls").click()
    outcome = panel.locator("#biobot-outcome")
    expect(outcome).to_contain_text("Let biobot 1 follow walls: confirmed by the biobot")
    panel.get_by_label("what").select_option("turn left")
    panel.get_by_label("stop after [s]").fill("1.5")
    panel.get_by_text("A pulse train of its own").click()
    panel.get_by_label("amplitude [mV]").fill("1500")
    panel.get_by_label("length [ms]").fill("300")
    panel.get_by_label("waveform").select_option("asymmetric")
    picture(page, "desk-one-biobot")
    assert accessibility_faults(page) == []
    before, gateway.answer = gateway.answer, lambda _request: (Stage.REFUSED,)
    try:
        panel.get_by_label("length [ms]").press("Enter")
        expect(outcome).to_contain_text("Turn biobot 1 left for 1.5 s: refused to spare the animal: too soon after the train before")
        expect(page.locator("#outcome")).to_contain_text("refused to spare the animal")
    finally:
        gateway.answer = before
    follow, turn = gateway.commands[:2]
    assert (follow.action, follow.hold_ms, follow.pulse) == (StimulationAction.FOLLOW_WALLS, 0, None)
    pulse = PulseRequest(amplitude_mv=1500, duration_ms=300, waveform=WaveformName.ASYMMETRIC)
    assert (turn.node, turn.action, turn.hold_ms, turn.operator, turn.pulse) == (1, StimulationAction.TURN_LEFT, 1500, "anna", pulse)
    panel.get_by_role("button", name="Stop biobot 1").click()
    expect(outcome).to_contain_text("Stop biobot 1: confirmed by the biobot")
    page.keyboard.press("Escape")
    expect(panel).to_be_hidden()
    expect(more).to_be_focused()


def test_orders_that_set_biobots_walking_are_asked_back_and_say_what_the_gateway_answered(site: Site, operator: Watched) -> None:
    page, gateway = operator.page, site.gateway
    page.get_by_role("tab", name="Mission").click()
    orders = page.get_by_role("group", name="Orders to the mission of gateway1")
    expect(orders.get_by_role("button", name="Pause")).to_be_enabled()
    expect(orders.get_by_role("button", name="End")).to_be_disabled()
    orders.get_by_role("button", name="Start").click()
    question = page.get_by_role("group", name="Start the mission? All biobots begin to walk.")
    expect(question).to_be_focused()
    question.get_by_role("button", name="No").click()
    expect(orders.get_by_role("button", name="Start")).to_be_focused()
    assert gateway.orders == []
    orders.get_by_role("button", name="Start").click()
    question.get_by_role("button", name="Yes: start").click()
    block = page.get_by_role("region", name="Mission of gateway1")
    expect(block).to_contain_text("Start: taken by gateway1")
    assert [(order.action, order.operator) for order in gateway.orders] == [(MissionAction.START, "anna")]

    gateway.journal_records([mission(1, phase=MissionPhase.EXPLORATION, t_ns=5 * S, landmarks=(1, 2))])
    gateway.publish_status()
    expect(page.locator("#mission-chip")).to_contain_text("exploration")
    expect(block.locator("[aria-current='step']")).to_have_text("Exploration")
    expect(block).to_contain_text("2 landmarks")
    expect(orders.get_by_role("button", name="Start")).to_be_disabled()
    orders.get_by_role("button", name="Start").click(force=True)
    expect(page.locator("#message")).to_contain_text("It has begun already")
    before, gateway.order_answer = gateway.order_answer, lambda _order: (False, "the journal's disk is full")
    try:
        orders.get_by_role("button", name="Pause").click()
        expect(block).to_contain_text("the journal's disk is full")
    finally:
        gateway.order_answer = before
    assert [order.action for order in gateway.orders] == [MissionAction.START, MissionAction.PAUSE]


def test_alerts_of_a_kind_are_one_entry_acknowledged_with_a_name_and_lead_to_their_biobots(site: Site, operator: Watched) -> None:
    page = operator.page
    page.get_by_role("tab", name="Alerts").click()
    n_low = 1 + len(ALSO_LOW)
    entry = page.locator("#alerts .group").filter(has_text=f"{n_low} batteries low")
    expect(entry).to_be_visible(timeout=WAIT_MS)
    badge = page.locator("#alert-badge")
    n_open = int((badge.text_content() or "").split()[0])
    entry.locator("summary").click()
    alert = entry.get_by_role("listitem").filter(has_text=f"biobot {LOW}")
    alert.get_by_role("button", name=f"Acknowledge: biobot {LOW}").click()
    expect(alert).to_contain_text("acknowledged by anna at")
    expect(alert.get_by_role("button", name="Acknowledge")).to_be_hidden()
    expect(badge).to_contain_text(str(n_open - 1))
    every = entry.get_by_role("button", name=f"Acknowledge all ({n_low - 1})")
    every.click()
    expect(every).to_be_hidden()
    expect(entry.get_by_text("acknowledged by anna at")).to_have_count(n_low)
    alert.get_by_role("button", name=f"Show biobot {LOW}").click()
    expect(page.get_by_role("tabpanel", name="Biobots")).to_be_visible()
    expect(page.get_by_role("button", name=f"Stop biobot {LOW}", exact=True)).to_be_focused()
    expect(page.locator("#rows tr:visible")).to_have_count(1)


# Alerts of a kind, some on and some over; what the two lists say, at first and when the last one on has ended.
MANY_ALERTS = """async ({ nOn, nOver }) => {
  const { Alerts } = await import("/static/alerts.js");
  const panel = document.createElement("div");
  const account = { guard() {}, forget() {} };
  const live = { serverNow: () => 100 };
  const alerts = new Alerts({ panel, badge: document.createElement("span"), account, live, onBiobot() {}, onLow() {} });
  const make = (id, isOn) => ({
    id, kind: "biobot_lost", severity: "warning", subject: `biobot ${id}`, text: `biobot ${id} is lost`, is_on: isOn,
    since_wall_ns: 1e9 * id, ended_wall_ns: isOn ? null : 1e9 * id + 1, acknowledged_by: null, acknowledged_wall_ns: null });
  const told = (list) => [...list.children].map((one) => one.querySelector("strong").textContent);
  const said = [];
  for (const left of [nOn, 0]) {
    alerts.show(Array.from({ length: nOn + nOver }, (_, at) => make(at + 1, at < left)));
    said.push([told(alerts.now), told(alerts.over), alerts.over.querySelectorAll("li li").length]);
  }
  return said;
}"""


def test_alerts_of_a_kind_that_are_over_are_one_entry_too(operator: Watched) -> None:
    first, last = operator.page.evaluate(MANY_ALERTS, {"nOn": 4, "nOver": 5})
    assert first == [["4 biobots lost"], ["5 biobots lost"], 5]
    assert last == [[], ["9 biobots lost"], 9]
    few = operator.page.evaluate(MANY_ALERTS, {"nOn": 1, "nOver": 2})
    assert few == [[["biobot 1"], ["biobot 3", "biobot 2"], 0], [[], ["biobot 3", "biobot 2", "biobot 1"], 0]]


def test_all_of_it_is_reached_by_keys_alone(site: Site, operator: Watched) -> None:
    page = operator.page
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to biobots")).to_be_focused()
    page.keyboard.press("Enter")
    tab_to(page, "#tab-biobots")
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("tabpanel", name="Mission")).to_be_visible()
    page.keyboard.press("Home")
    expect(page.get_by_role("tabpanel", name="Biobots")).to_be_visible()
    tab_to(page, "#rows button")
    for key, name in (
        ("ArrowDown", "Stop biobot 2"),
        ("End", f"Stop biobot {N_BIOBOTS}"),
        ("PageUp", "Stop biobot 2"),
        ("Home", "Stop biobot 1"),
    ):
        page.keyboard.press(key)
        expect(page.get_by_role("button", name=name, exact=True)).to_be_focused()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    expect(page.locator("#outcome")).to_contain_text("Stop biobot 2: confirmed by the biobot")
    tab_to(page, "#help-open", backwards=True)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="What the map can say")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.get_by_role("button", name="Help")).to_be_focused()
    expect(page.locator("#help")).to_be_hidden()
    tab_to(page, "#emergency", backwards=True)
    outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline != "none"


@pytest.mark.parametrize(
    ("scheme", "sizes"),
    [
        ("light", {"Biobots": DESK, "Mission": PHONE, "Alerts": DESK}),
        ("dark", {"Biobots": PHONE, "Mission": DESK, "Alerts": PHONE}),
    ],
)
def test_nobody_is_shut_out_on_a_desk_and_on_a_phone(site: Site, scheme: Any, sizes: dict[str, tuple[int, int]]) -> None:
    with opened(site.browser, site.url, token=site.token(Role.OPERATOR), scheme=scheme, motion="reduce") as watched:
        page = site.known(watched.page)
        for name, (width, height) in sizes.items():
            page.set_viewport_size({"width": width, "height": height})
            page.get_by_role("tab", name=name).click()
            expect(page.get_by_role("button", name="Stop all")).to_be_in_viewport()
            assert fits_its_width(page)
            picture(page, f"desk-{name.lower()}-{scheme}")
            assert accessibility_faults(page) == []
        page.set_viewport_size({"width": DESK[0], "height": DESK[1]})
        page.get_by_role("button", name="Help").click()
        page.locator("#account-open").click()
        expect(page.locator("#help")).to_be_hidden()
        page.get_by_role("button", name="Help").click()
        picture(page, f"desk-help-{scheme}")
        assert accessibility_faults(page) == []
        assert page.evaluate("document.getAnimations().length") == 0


def test_colours_follow_the_system_until_others_are_chosen_and_stay_chosen(site: Site) -> None:
    with opened(site.browser, site.url, scheme="dark") as watched:
        page = watched.page
        root = page.locator("html")
        expect(root).to_have_attribute("data-theme", "dark")
        page.emulate_media(color_scheme="light")
        expect(root).to_have_attribute("data-theme", "light")
        button = page.get_by_role("button", name="Colours")
        button.click()
        button.click()
        expect(button).to_have_accessible_name("Colours: dark")
        expect(root).to_have_attribute("data-theme", "dark")
        page.reload()
        expect(root).to_have_attribute("data-theme", "dark")
        expect(button).to_have_accessible_name("Colours: dark")


# What a screen reader says: every text that a live region gets, in order, but for the same one again.
LISTEN = """() => {
  window.heard = [];
  for (const region of document.querySelectorAll("[aria-live], [role=status], [role=alert]")) {
    let last = region.textContent;
    new MutationObserver(() => {
      const text = region.textContent.trim();
      if (text && text !== last) window.heard.push([region.id, text]);
      last = text;
    }).observe(region, { childList: true, characterData: true, subtree: true });
  }
}"""


def test_a_page_shows_nothing_without_a_token_where_nobody_may_and_says_since_when_the_mapper_is_away(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not the site's mapper: one that wants a token for everything, ends, and begins again on its port."""
    monkeypatch.setenv("BIOBOT_MAPPER__SERVE__ANONYMOUS_READING", "false")
    arguments = ["--port", str(free_port())]
    with ExitStack() as stack:
        with serving(tmp_path, connect=free_port(), arguments=arguments) as (url, _process):
            watched = stack.enter_context(opened(site.browser, url, expected=[*REFUSED, r"net::ERR_"]))
            page = watched.page
            expect(page.locator("#account")).to_contain_text("This mapper shows nothing without a token.")
            expect(page.locator("#link")).to_have_text("not signed in")
            page.get_by_label("Token", exact=True).fill(token_of(tmp_path))
            page.keyboard.press("Enter")
            expect(page.locator("#link")).to_have_text("no gateway yet")
            page.evaluate(LISTEN)
        expect(page.locator("#link")).to_have_text("mapper does not answer")
        expect(page.locator("#banner")).to_contain_text("No answer from the mapper for")
        expect(page.locator("#banner")).to_contain_text("What you see is from")
        expect(page.locator("#said-urgently")).to_contain_text("may be old")
        page.get_by_role("button", name="Stop all").click()
        expect(page.get_by_role("alert")).to_contain_text("NOT stopped. The mapper does not answer")
        with serving(tmp_path, connect=free_port(), arguments=arguments):
            expect(page.locator("#link")).to_have_text("no gateway yet")
            expect(page.locator("#banner")).to_be_hidden()
            expect(page.locator("#account-open")).to_have_text("anna · operator")
            expect(page.locator("#said")).to_have_text("The mapper answers again.")
            spoken = [(region, text) for region, text in page.evaluate("heard") if re.search("mapper (does not )?answer|gateway yet", text)]
            told = [("said-urgently", "The mapper does not answer; what is shown may be old."), ("said", "The mapper answers again.")]
            assert [one for one in spoken if one[0] != "stop-panel"] == told, "each is said once"


@pytest.fixture(scope="module")
def modules(site: Site) -> Iterator[Page]:
    """A page with nothing on it, from which the page's modules can be called."""
    page = site.browser.new_page()
    page.goto(site.url + "static/icon.svg")
    yield page
    page.close()


LINES = st.lists(
    st.sampled_from(["data: {}", "data:x", "data", "event: change", ": still here", "", "", "id: 7", "retry: 1000", "däta: ü"]), max_size=12
)
ENDS = st.sampled_from(["\n", "\r\n", "\r"])


@settings(max_examples=25, deadline=None)
@given(lines=LINES, end=ENDS, data=st.data())
def test_events_are_the_same_however_the_stream_is_cut(modules: Page, lines: list[str], end: str, data: st.DataObject) -> None:
    text = "".join(line + end for line in lines)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(text)), max_size=6)))
    pieces = [text[begin:stop] for begin, stop in zip([0, *cuts], [*cuts, len(text)], strict=True)]
    heard = modules.evaluate(
        """async ([pieces]) => {
          const { EventParser } = await import("/static/event_parser.js");
          const events = [];
          const parser = new EventParser({ onEvent: (event) => events.push([event.type, event.data]) });
          pieces.forEach((piece) => parser.feed(piece));
          return events;
        }""",
        [pieces],
    )
    assert heard == events_in(lines, is_open=end == "\r")


def events_in(lines: list[str], *, is_open: bool) -> list[list[str]]:
    """Read server-sent events line by line, as the HTML standard has it (9.2.6); a last CR may yet be half an end of line."""
    events: list[list[str]] = []
    kind, parts = "", list[str]()
    for number, line in enumerate(lines, 1):
        if line == "":
            if parts and not (is_open and number == len(lines)):
                events.append([kind or "message", "\n".join(parts)])
            kind, parts = "", []
        elif not line.startswith(":"):
            name, _, value = line.partition(":")
            value = value.removeprefix(" ")
            if name == "event":
                kind = value
            elif name == "data":
                parts.append(value)
    return events


BIOBOTS = st.lists(
    st.fixed_dictionaries(
        {
            "key": st.integers(0, 2**64 - 1).map(str),
            "gateway": st.just("gateway1"),
            "is_reachable": st.booleans(),
            "is_landmark": st.booleans(),
            "is_halted": st.booleans(),
            "mode": st.sampled_from(["CRW", "S"]),
            "battery_mv": st.none() | st.integers(1500, 4200),
            "rssi_dbm": st.none() | st.integers(-110, -20),
            "state": st.sampled_from(["online", "lost", "unknown"]),
            "silence_s": st.none() | st.floats(0, 1e6),
            "toldS": st.just(190),
        }
    ),
    unique_by=lambda biobot: biobot["key"],
    max_size=8,
)


@settings(max_examples=25, deadline=None)
@given(biobots=BIOBOTS, column=st.sampled_from(["id", "state", "mode", "battery", "heard", "rate", "link"]), data=st.data())
def test_every_biobot_is_in_one_state_and_has_one_place_in_every_order(
    modules: Page, biobots: list[dict[str, Any]], column: str, data: st.DataObject
) -> None:
    shuffled = data.draw(st.permutations(biobots))
    counts, orders, kinds = modules.evaluate(
        """async ([biobots, shuffled, column]) => {
          const { countStates, isWanted, orderBy } = await import("/static/biobot_state.js");
          const compare = orderBy(column, { nowS: 200, rates: new Map() });
          const howMany = (kind) => biobots.filter((one) => isWanted(one, { words: [], kind, low: new Set() })).length;
          const kinds = ["online", "lost", "unknown"].map(howMany);
          return [countStates(biobots), [biobots, shuffled].map((list) => [...list].sort(compare).map((one) => one.key)), kinds];
        }""",
        [biobots, shuffled, column],
    )
    assert sum(counts.values()) == len(biobots)
    assert kinds == [counts[kind] for kind in ("online", "lost", "unknown")]
    assert orders[0] == orders[1]
    if column == "id":
        assert [int(key) for key in orders[0]] == sorted(int(biobot["key"]) for biobot in biobots)
