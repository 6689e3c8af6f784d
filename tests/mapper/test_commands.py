"""Commands over HTTP: trains of one's own, stages while they happen, and what others command."""

import asyncio
import threading
from collections.abc import Iterator
from http import HTTPStatus

import httpx
import pytest

from firmware_protocol.contract.commands import PulseRequest, Stage, StimulationAction, StimulationRequest, WaveformName
from firmware_protocol.units import Nanoseconds, NodeId
from mapper import commands
from mapper.changes import Topic
from tests.mapper.fake_gateway import ANCHOR_NS, DEADLINE_NS, FakeGateway, account
from tests.mapper.mapper_side import DEADLINE_S, Side, until
from tests.mapper.web_side import check_against, meet, openapi_of, run_story

COMMANDS = "/api/v1/commands"


def test_a_train_of_ones_own_reaches_the_gateway() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        await meet(side, gateways[0], 5)
        pulse = {
            "frequency_hz": 40,
            "pulse_width_us": 300,
            "amplitude_mv": 1500,
            "duration_ms": 200,
            "channel": 1,
            "waveform": "asymmetric",
        }
        start = {"biobot": 5, "action": "start"}
        told = (await client.post(COMMANDS, json={**start, "pulse": pulse, "id": "one"})).json()
        assert told["pulse"] == pulse
        await client.post(COMMANDS, json={**start, "pulse": {"duration_ms": 100}})
        await client.post(COMMANDS, json=start)
        assert [request.pulse for request in gateways[0].commands] == [
            PulseRequest(
                frequency_hz=40, pulse_width_us=300, amplitude_mv=1500, duration_ms=200, channel=1, waveform=WaveformName.ASYMMETRIC
            ),
            PulseRequest(duration_ms=100),
            None,
        ]
        other = await client.post(COMMANDS, json={**start, "id": "one"})
        assert (other.status_code, other.json()["refusal"]) == (HTTPStatus.CONFLICT, "id_reused")

    run_story(story)


def test_stages_are_seen_while_they_happen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "_PATIENCE_S", DEADLINE_S)

    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        (gateway,) = gateways
        await meet(side, gateway, 5)
        steps = [threading.Event() for _ in range(2)]

        def slowly(_request: StimulationRequest) -> Iterator[Stage]:
            yield Stage.ACCEPTED
            steps[0].wait(DEADLINE_S)
            yield Stage.RADIO_CONFIRMED
            steps[1].wait(DEADLINE_S)
            yield Stage.BIOBOT_CONFIRMED

        gateway.answer = slowly
        try:
            given = await client.post(COMMANDS, json={"biobot": 5, "action": "start", "id": "one", "wait_s": 0})
            assert given.status_code == HTTPStatus.ACCEPTED
            check_against(openapi_of(side), COMMANDS, given, method="post")
            path = f"{COMMANDS}/one"
            first = (await client.get(path, params={"wait_s": DEADLINE_S, "seen": 0})).json()
            assert ([stage["stage"] for stage in first["stages"]], first["outcome"]) == (["accepted"], None)
            assert first["stages"][0]["deadline_wall_ns"] == DEADLINE_NS
            before = side.changes.versions[Topic.COMMANDS]
            second = asyncio.create_task(client.get(path, params={"wait_s": DEADLINE_S, "seen": 1}))
            end = asyncio.create_task(client.get(path, params={"wait_s": DEADLINE_S}))
            steps[0].set()
            assert [stage["stage"] for stage in (await second).json()["stages"]] == ["accepted", "radio_confirmed"]
            assert side.changes.versions[Topic.COMMANDS] > before
            assert not end.done()
            steps[1].set()
            assert (await end).json()["outcome"] == "biobot_confirmed"
        finally:
            for step in steps:
                step.set()
        for bad in ({"wait_s": "x"}, {"wait_s": 61}, {"wait_s": -1}, {"seen": -1}):
            assert (await client.get(path, params=bad)).status_code == HTTPStatus.UNPROCESSABLE_ENTITY

    run_story(story)


def test_what_others_command_is_listed_with_who_gave_it() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        (gateway,) = gateways
        await meet(side, gateway, 5)
        await client.post(COMMANDS, json={"biobot": 5, "action": "stop", "id": "mine"})
        by_dead_man = StimulationRequest(
            command_id="theirs", node=NodeId(6), action=StimulationAction.STOP, operator="dead-man", issued_wall_ns=Nanoseconds(0)
        )
        gateway.publish_stage(gateway.stage_of(by_dead_man, Stage.ACCEPTED))
        gateway.publish_stage(gateway.stage_of(by_dead_man, Stage.BIOBOT_CONFIRMED))
        part = StimulationRequest(
            command_id="part", node=NodeId(7), action=StimulationAction.STOP, operator="dead-man", issued_wall_ns=Nanoseconds(0)
        )
        gateway.publish_stage(gateway.stage_of(part, Stage.ACCEPTED, part_of="all"))
        await until(lambda: side.desk.log.find("part") is not None)
        listed = await client.get(COMMANDS)
        check_against(openapi_of(side), COMMANDS, listed)
        told = [(one["id"], one["operator"], one["origin"], one["biobot"], one["outcome"]) for one in listed.json()["commands"]]
        assert told == [("theirs", "dead-man", "elsewhere", 6, "biobot_confirmed"), ("mine", "anna", "here", 5, "biobot_confirmed")]
        # The gateway published what it had answered too: each stage is there once.
        assert len(listed.json()["commands"][1]["stages"]) == 3
        parts = (await client.get(COMMANDS, params={"part_of": "all"})).json()["commands"]
        assert [(one["id"], one["part_of"], one["outcome"]) for one in parts] == [("part", "all", None)]

    run_story(story)


def test_accounts_of_stimulation_are_told_as_gateways_last_gave_them() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        await meet(side, gateways[0], 5)
        path = "/api/v1/biobots/{biobot}/stimulation"
        assert (await client.get("/api/v1/biobots/5/stimulation")).json() == {"accounts": []}
        assert (await client.get("/api/v1/biobots/6/stimulation")).status_code == HTTPStatus.NOT_FOUND
        for bad in ("x", "-1", str(2**64)):
            assert (await client.get(f"/api/v1/biobots/{bad}/stimulation")).status_code == HTTPStatus.UNPROCESSABLE_ENTITY
        gateways[0].publish_account(account(5, n_trains=1))
        gateways[0].publish_account(account(5, n_trains=2, ready_in_ms=1500))
        gateways[1].publish_account(account(5, gateway="gateway2"))
        gateways[1].publish_account(account(6, gateway="gateway2"))
        await until(lambda: len(side.accounts.all()) == 3 and side.accounts.of(NodeId(5))[0].n_trains == 2)
        answer = await client.get("/api/v1/biobots/5/stimulation")
        check_against(openapi_of(side), path, answer)
        told = answer.json()["accounts"]
        assert [(one["gateway"], one["n_trains"], one["controlled_by"]) for one in told] == [("gateway1", 2, None), ("gateway2", 3, None)]
        assert told[0]["ready_wall_ns"] == ANCHOR_NS + 1_500_000_000
        everybody = (await client.get("/api/v1/stimulation")).json()["accounts"]
        assert [(one["biobot"], one["gateway"]) for one in everybody] == [(5, "gateway1"), (5, "gateway2"), (6, "gateway2")]

    run_story(story, n_gateways=2)
