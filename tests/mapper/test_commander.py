"""The mapper as a commander: whom it moves is stopped when it is gone, whichever way it goes."""

import asyncio
import signal
import time
from http import HTTPStatus
from pathlib import Path

import httpx

from firmware_protocol.contract.commands import Stage, StimulationAction, StimulationRequest
from studies.ports import free_port
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.mapper_side import Side, until
from tests.mapper.serving import STOP_S, serving, shown
from tests.mapper.web_side import meet, run_story

TURN = {"biobot": 5, "action": "turn_left", "hold_ms": 60_000}
DEADLINE_S = 60.0


def test_a_command_with_a_hold_names_a_commander_that_is_there_and_beats_until_it_has_stopped_everybody() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        (gateway,) = gateways
        await meet(side, gateway, 5)
        early = await client.post("/api/v1/commands", json={**TURN, "ttl_ms": 1})
        assert (early.status_code, early.json()["refusal"]) == (HTTPStatus.CONFLICT, "no_commander")
        await side.bus.claim("mapper1", settle_s=0.05)
        seen: list[bool] = []

        def note(request: StimulationRequest) -> tuple[Stage, ...]:
            seen.append(request.commander in gateway.commanders)
            return (Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)

        await until(lambda: bool(gateway.commanders))
        gateway.answer = note
        free = (await client.post("/api/v1/commands", json={**TURN, "hold_ms": 0})).json()
        held = (await client.post("/api/v1/commands", json=TURN)).json()
        assert [free["commander"], held["commander"]] == [None, "mapper1"]
        assert seen == [False, True]
        assert gateway.commanders == {"mapper1"}
        assert (await client.get("/api/v1/biobots")).json()["commanders"] == ["mapper1"]
        await until(lambda: len(gateway.beats) >= 2)
        assert gateway.beats[1].number > gateway.beats[0].number
        await side.desk.release()
        last = gateway.commands[-1]
        assert (last.node, last.action, last.operator) == (5, StimulationAction.STOP, "mapper-shutdown")
        assert side.commander.motion.nodes(now_ns=time.monotonic_ns()) == []
        late = await client.post("/api/v1/commands", json=TURN)
        assert (late.status_code, late.json()["refusal"]) == (HTTPStatus.CONFLICT, "stopping")
        assert (await client.post("/api/v1/stop", json={"wait_s": DEADLINE_S})).status_code == HTTPStatus.OK
        await side.commander.resign()
        await until(lambda: not gateway.commanders)

    run_story(story)


def test_a_mapper_that_is_ended_stops_whom_it_moves_and_then_lets_its_token_go(tmp_path: Path) -> None:
    port = free_port()
    with FakeGateway(port=port) as gateway, serving(tmp_path, connect=port, arguments=["--name", "map1"]) as (url, process):

        def is_moved() -> bool:
            gateway.publish_status()
            gateway.publish_node(5, heard_ns=time.time_ns())
            return httpx.post(url + "api/v1/commands", json=TURN, headers=shown(tmp_path), timeout=60).status_code == HTTPStatus.OK

        deadline = time.monotonic() + DEADLINE_S
        while not is_moved():
            assert time.monotonic() < deadline
        while gateway.commanders != {"map1"}:  # its token and its command come by different queues
            assert time.monotonic() < deadline
            time.sleep(0.01)
        tokens_at_stop: list[set[str]] = []

        def note(_request: StimulationRequest) -> tuple[Stage, ...]:
            tokens_at_stop.append(set(gateway.commanders))
            return (Stage.ACCEPTED, Stage.BIOBOT_CONFIRMED)

        gateway.answer = note
        process.send_signal(signal.SIGTERM)
        assert process.wait(STOP_S) == 0
        assert (gateway.commands[-1].node, gateway.commands[-1].action) == (5, StimulationAction.STOP)
        # A stop is asked once more where its answer is late, as on a busy machine; the token may have gone by then.
        assert tokens_at_stop[0] == {"map1"}
        while gateway.commanders:
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_a_start_that_waits_for_its_commander_is_overtaken_by_a_stop() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        (gateway,) = gateways
        await meet(side, gateway, 5)
        await meet(side, gateway, 6)
        waiting = [asyncio.create_task(client.post("/api/v1/commands", json={**TURN, "biobot": biobot})) for biobot in (5, 6)]
        await until(lambda: len(side.desk._held_back) == 2)
        await client.post("/api/v1/stop", json={"biobots": [5], "wait_s": DEADLINE_S})
        await side.bus.claim("mapper1", settle_s=0.05)
        overtaken, other = [await answer for answer in waiting]
        assert (overtaken.status_code, overtaken.json()["refusal"]) == (HTTPStatus.CONFLICT, "overtaken")
        assert other.status_code == HTTPStatus.OK
        assert [(request.node, request.action) for request in gateway.commands] == [
            (5, StimulationAction.STOP),
            (6, StimulationAction.TURN_LEFT),
        ]

    run_story(story)
