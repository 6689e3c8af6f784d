"""The acceptance check: passes what works, fails what does not, and loses nothing for the gateway that comes later."""

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_protocol.dialects.choice import DIALECTS
from firmware_protocol.envelope import RadioStatus
from firmware_protocol.units import NodeId
from gateway.acceptance.check_radio import check_radio
from gateway.acceptance.plan import Patience, Plan
from gateway.acceptance.results import Outcome, Report
from gateway.transports.spec import parse_port_spec
from tests.gateway.fake_radio import FakeBackpack, a_dongle, on_pty
from tests.gateway.virtual_dongles import dongle_on_tcp

pytestmark = pytest.mark.xdist_group("check radio")
"""What they share is made once, by one worker."""

_ROOT = Path(__file__).parents[2]
_SERIAL = [dialect for dialect in DIALECTS if "can" not in dialect]

QUICK = Patience(
    open_s=10.0, radio_s=3.0, reply_s=3.0, first_payload_s=5.0, silence_s=2.6, broadcast_s=0.5, throughput_s=0.2, n_round_trips=4
)

PATIENT = replace(QUICK, open_s=60.0, radio_s=30.0, reply_s=30.0, first_payload_s=60.0, repeat_s=30.0, broadcast_s=10.0)
"""For what answers, on a machine that may be busy."""


def outcomes(report: Report) -> dict[str, Outcome]:
    return {one.name: one.outcome for one in report.results}


@contextmanager
def a_swarm(tmp_path: Path) -> Iterator[dict[str, str]]:
    """Serve a swarm with a coordinator of every dialect, as a user would; yields the port to open for each."""
    ready = tmp_path / "ready"
    links = {dialect: f"pty:{tmp_path}/{dialect}?dialect={dialect}" for dialect in _SERIAL} | {"can": f"slcan:{tmp_path}/can?unit=3"}
    arguments = ["--scenario", "two-obstacles", "--seed", "3", "--biobots", "16", "--speed", "0.02", "--ready-file", str(ready)]
    for link in links.values():
        arguments += ["--link", link]
    with subprocess.Popen(
        [sys.executable, "-m", "simulator", "serve", *arguments], cwd=_ROOT, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    ) as process:
        try:
            until_s = time.monotonic() + 60
            while not ready.exists() and process.poll() is None and time.monotonic() < until_s:
                time.sleep(0.02)
            assert ready.exists()
            yield {dialect: f"serial:{tmp_path}/{dialect}?dialect={dialect}" for dialect in _SERIAL} | {"can": f"can:{links['can']}"}
        finally:
            process.terminate()


@pytest.mark.e2e
def test_the_simulators_dongles_pass_in_every_dialect(tmp_path: Path) -> None:
    async def check_all(ports: dict[str, str]) -> dict[str, Report]:
        plan = Plan(stimulates=True, soak_s=0.1, patience=PATIENT)
        checks = [check_radio(parse_port_spec(port), plan, on_result=lambda _: None) for port in ports.values()]
        return dict(zip(ports, await asyncio.gather(*checks), strict=True))

    with a_swarm(tmp_path) as ports:
        reports = asyncio.run(check_all(ports))

    assert set(reports) == {*DIALECTS} - {"canfd"}
    for dialect, report in reports.items():
        not_passed = {one.name: one.detail for one in report.results if one.outcome is not Outcome.PASSED}
        assert not_passed.keys() == ({"opens exclusively"} if dialect == "can" else set()), (dialect, not_passed)
        assert report.is_passed, dialect


@pytest.fixture(scope="module")
def careless(tmp_path_factory: pytest.TempPathFactory) -> tuple[Report, FakeBackpack]:
    """A check of a dongle whose radio calls every payload sent and knows no broadcast, and the biobot behind it, with things to tell.

    Another was heard before that, and has left.
    """
    dongle = a_dongle(3, 4)
    dongle.backpacks[NodeId(3)].is_away = True
    dongle.backpacks[NodeId(3)].say_status()
    backpack = dongle.backpacks[NodeId(4)]
    for _ in range(3):
        backpack.say_encounter(NodeId(5), ago_ms=900, duration_ms=200)
    backpack.say_status()
    path = tmp_path_factory.mktemp("careless") / "dongle"

    async def run() -> Report:
        async with on_pty(dongle, path):
            return await check_radio(parse_port_spec(f"serial:{path}"), Plan(patience=QUICK), on_result=lambda _: None)

    return asyncio.run(run()), backpack


def test_a_dongle_that_calls_everything_sent_fails_just_there(careless: tuple[Report, FakeBackpack]) -> None:
    report, _ = careless
    failing = {name for name, outcome in outcomes(report).items() if outcome is Outcome.FAILED}

    assert failing == {"tells that an address is nobody's", "broadcasts"}
    assert not report.is_passed


def test_a_biobot_that_has_left_does_not_count_against_the_dongle(careless: tuple[Report, FakeBackpack]) -> None:
    report, _ = careless
    details = {one.name: one.detail for one in report.results}

    assert "biobot 3" in details["hears biobots"], "it was heard first"
    assert "biobot 4" in details["hello request answered"]


def test_a_check_acknowledges_nothing_but_the_hellos_it_asked_for(careless: tuple[Report, FakeBackpack]) -> None:
    _, backpack = careless

    assert [type(message).__name__ for message in backpack._outbox.values()] == ["EncounterBatch"] * 3 + ["Status"]
    assert backpack.hellos >= 2
    assert not backpack.heard, "nobody was stimulated"


def test_without_a_biobot_what_needs_one_is_skipped_and_nothing_passes_for_it() -> None:
    async def run() -> Report:
        async with dongle_on_tcp("native") as (_, spec):
            patience = Patience(open_s=2.0, radio_s=0.2, first_payload_s=0.2, broadcast_s=0.1)
            return await check_radio(parse_port_spec(spec), Plan(patience=patience), on_result=lambda _: None)

    report = asyncio.run(run())
    found = outcomes(report)

    assert found["opens and identifies itself"] is Outcome.PASSED
    assert found["hears biobots"] is Outcome.FAILED
    assert found["time sync round trip"] is Outcome.SKIPPED
    assert not report.is_passed


@pytest.mark.parametrize("why", ["its radio hears nothing", "it has left"])
def test_where_no_biobot_answers_none_is_blamed_on_garbage_and_nothing_passes_for_it(why: str, tmp_path: Path) -> None:
    async def run() -> Report:
        dongle = a_dongle(4)
        if why == "it has left":
            dongle.backpacks[NodeId(4)].is_away = True
        else:
            dongle.radio_status = RadioStatus.NO_ACK
        dongle.backpacks[NodeId(4)].say_status()
        patience = Patience(open_s=2.0, radio_s=1.0, reply_s=0.2, first_payload_s=0.5, throughput_s=0.1, broadcast_s=0.1)
        async with on_pty(dongle, tmp_path / "dongle"):
            spec = parse_port_spec(f"serial:{tmp_path}/dongle")
            return await check_radio(spec, Plan(patience=patience), on_result=lambda _: None)

    report = asyncio.run(run())
    found = outcomes(report)
    details = {one.name: one.detail for one in report.results}

    assert found["hears biobots"] is Outcome.PASSED
    needing = ("time sync round trip", "hello request answered", "carries payloads down", "survives garbage on the line")
    assert {found[name] for name in needing} == {Outcome.SKIPPED}
    assert "none of 1 heard biobots answers: none is in range now" in details["survives garbage on the line"]
    # One that has left says nothing about broadcasts; a radio that says it sent nothing does.
    assert found["broadcasts"] is (Outcome.SKIPPED if why == "it has left" else Outcome.FAILED)
    assert not report.is_passed


def test_the_command_tells_each_verdict_and_its_exit_status(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gateway", "check-radio", str(tmp_path / "nothing")]
    failed = subprocess.run([*command, "--json"], cwd=_ROOT, capture_output=True, text=True, check=False, timeout=60)
    usage = subprocess.run([*command, "--stimulate"], cwd=_ROOT, capture_output=True, text=True, check=False, timeout=60)

    assert failed.returncode == 1
    report = json.loads(failed.stdout)
    assert (report["is_passed"], report["results"][0]["outcome"]) == (False, "failed")
    assert "list-ports" in report["results"][0]["detail"]
    assert (usage.returncode, "--node" in usage.stderr) == (2, True)
