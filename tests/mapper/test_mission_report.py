"""The mission report: what it says, that nothing in it is taken for HTML, and that it comes out of a printer."""

import asyncio
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx
import msgspec.structs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from playwright.sync_api import Browser, sync_playwright

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import MissionPhase
from firmware_protocol.units import Nanoseconds
from mapper.mission_report import ReportFacts, write_report
from mapper.report_pictures import TimedCount, TimedSpan, draw_timeline
from studies.ports import free_port
from tests.mapper.fake_gateway import FakeGateway, account, mission
from tests.mapper.mapper_side import mapper_side, until
from tests.mapper.ring import ring_records
from tests.mapper.web_side import check_against, client_of, meet, openapi_of

NOTHING = ReportFacts(
    site="local",
    now_wall_ns=1_700_000_000_000_000_000,
    software="biobot-gateway 1",
    kernels="compiled",
    persistence=None,
    made_by=None,
    map_json=None,
    waiting="not enough encounters yet: 0 of at least 2",
    history=[],
    alerts=[],
    gateways=[],
    biobots=[],
    accounts=[],
    commands=[],
    missions=[],
    faults=[],
)
CHROMIUM = shutil.which("chromium")
VOID = {"meta", "link", "path", "circle", "polygon", "rect"}


class Reader(HTMLParser):
    """The words of a page, and whether its elements are closed in the order in which they were opened."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, Any]]] = []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID or (tag == "rect"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


def check_policy(reader: Reader) -> None:
    """Nothing is in the page that its policy forbids, or that is fetched from elsewhere."""
    for tag, attributes in reader.elements:
        assert tag not in {"script", "img", "iframe", "object", "style"}
        assert not any(name == "style" or name.startswith("on") for name in attributes)
        assert "src" not in attributes


async def tell_a_story(client_story: Any) -> None:
    """Have a mapper with a map, a mission, commands and an alert, and ask it."""
    port = free_port()
    with FakeGateway(port=port) as gateway:
        async with mapper_side(port, with_map=True) as side, client_of(side) as client:
            await until(lambda: side.bus.is_connected and gateway.is_heard)
            records = ring_records()
            last = records[-1].offset
            gateway.journal_records([*records, mission(last + 1, phase=MissionPhase.EXPLORATION, t_ns=0, landmarks=(1001, 1002))])
            await meet(side, gateway, 7)
            gateway.publish_account(account(7))
            event = GatewayEvent(gateway="gateway1", wall_ns=Nanoseconds(5), level="warning", kind="journal.damaged", facts={})
            side.fleet.events.append(event)
            await until(lambda: bool(side.history.page()[0]) and bool(side.accounts.all()))
            await side.alerts.look()
            await client.put("/api/v1/pins/door", json={"place": "landmark:1001", "x": 12.5, "y": 0})
            await client.put("/api/v1/pins/lost%20%3Cb%3E", json={"place": "biobot:77"})
            await client.post("/api/v1/commands", json={"biobot": "7", "action": "stop", "id": "one"})
            await client_story(side, client)


@pytest.fixture(scope="module")
def report() -> tuple[httpx.Response, httpx.Response]:
    """The page, and the file."""
    found: list[httpx.Response] = []

    async def ask(side: Any, client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        for download in ("false", "true"):
            found.append(await client.get("/api/v1/report.html", params={"download": download}))
            check_against(document, "/api/v1/report.html", found[-1])
        bad = await client.get("/api/v1/report.html", params={"download": "perhaps"})
        assert bad.status_code == HTTPStatus.UNPROCESSABLE_ENTITY

    asyncio.run(tell_a_story(ask))
    page, file = found
    return page, file


def test_the_report_says_what_the_map_says_how_sure_it_is_and_who_did_what(report: tuple[httpx.Response, httpx.Response]) -> None:
    page, _ = report
    reader = Reader(page.text)
    check_policy(reader)
    assert re.search(r"The map shows 1 hole \(\d+% sure\) in 1 connected part\.", reader.text)
    for words in (
        "whether it is the mirror image",
        "seconds of walking",
        "exploration",
        "anna",
        "biobot confirmed",
        "has records on its disk that cannot be read",
        "SHA-256",
        "landmark:1001 12.5, 0",
        "lost <b> biobot:77",
        "gateway1",
    ):
        assert words in reader.text, words
    assert ("link", {"rel": "stylesheet", "href": "http://127.0.0.1/static/report.css"}) in reader.elements
    assert sum(tag == "svg" for tag, _ in reader.elements) == 2
    biobot = next(row for row in page.text.split("<tr>") if row.startswith("<td>7</td><td>walks"))
    assert "<td>3</td><td>0.9</td>" in biobot, "its trains, and their time [s]"


def test_the_file_is_the_page_with_its_style_in_it(report: tuple[httpx.Response, httpx.Response]) -> None:
    page, file = report
    assert 'filename="report-local-' in file.headers["content-disposition"]
    assert "<style>" in file.text
    assert "http://127.0.0.1/static" not in file.text
    assert file.text[file.text.index("<h2>Holes</h2>") :].split("How this was made")[0].count("<tr>") == page.text[
        page.text.index("<h2>Holes</h2>") :
    ].split("How this was made")[0].count("<tr>")


def test_before_the_first_map_the_report_says_what_it_waits_for() -> None:
    reader = Reader(write_report(NOTHING, style_url="/static/report.css"))
    assert "There is no map yet: not enough encounters yet: 0 of at least 2." in reader.text
    for empty in ("No biobot was heard.", "None was given.", "No mission was run.", "There was none.", "None was seen."):
        assert empty in reader.text


@given(text=st.text(max_size=40), site=st.text(max_size=20))
@settings(max_examples=40)
def test_no_text_from_outside_becomes_part_of_the_page(text: str, site: str) -> None:
    record = msgspec.structs.replace(mission(1, phase=MissionPhase.DONE, t_ns=0), operator=text, reason=f"<b>{text}</b><script>")
    facts = replace(NOTHING, site=site, missions=[record], faults=[f"</ul>{text}"], waiting=f"<i>{text}")
    reader = Reader(write_report(facts, style_url="/x.css"))
    assert {tag for tag, _ in reader.elements}.isdisjoint({"b", "i", "script"})
    check_policy(reader)


@given(
    counts=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 9), st.booleans()), max_size=20),
    spans=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 10**6) | st.none()), max_size=12),
)
@settings(max_examples=40)
def test_nothing_of_a_timeline_lies_beside_it(counts: list[tuple[int, int, bool]], spans: list[tuple[int, int | None]]) -> None:
    drawn = draw_timeline(
        [TimedCount(wall_ns=wall_ns, n_holes=number, is_enough=enough) for wall_ns, number, enough in sorted(counts)],
        [TimedSpan(begin_ns=begin, end_ns=None if end is None else begin + end, kind="info", text="<x>") for begin, end in spans],
        end_ns=2 * 10**6,
    )
    reader = Reader(drawn)
    for tag, attributes in reader.elements:
        if tag == "rect":
            assert 0 <= float(attributes["x"]) <= float(attributes["x"]) + float(attributes["width"]) <= 720
            assert 0 <= float(attributes["y"]) <= 186
        numbers = [float(number) for number in re.findall(r"[\d.]+", attributes.get("d", ""))]
        assert all(0 <= number <= 720 for number in numbers)


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_the_report_prints_on_paper_and_complains_of_nothing(report: tuple[httpx.Response, httpx.Response], tmp_path: Path) -> None:
    _, file = report
    path = tmp_path / "report.html"
    path.write_text(file.text, encoding="utf-8")
    with sync_playwright() as playwright:
        browser: Browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        said: list[str] = []
        asked: list[str] = []
        page.on("console", lambda message: said.append(message.text))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        for width in (1280, 390):
            page.set_viewport_size({"width": width, "height": 800})
            assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        pdf = page.pdf(format="A4")
        browser.close()
    assert said == []
    assert asked == [path.as_uri()]
    assert pdf.startswith(b"%PDF")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 8
