"""The emergency stop: it reaches every gateway, whatever else is full, busy or away, and says who told nothing."""

import asyncio
import threading
from collections.abc import Iterator
from http import HTTPStatus

import httpx
import pytest

from firmware_protocol.contract.commands import PulseRequest, Refusal, Stage, StimulationAction, StimulationRequest
from firmware_protocol.units import EVERYBODY, NodeId
from mapper import commands, emergency_stop
from mapper.commands import Wish
from studies.ports import free_port
from tests.mapper.fake_gateway import FakeGateway
from tests.mapper.mapper_side import DEADLINE_S, Side, mapper_side, until
from tests.mapper.web_side import check_against, client_of, meet, openapi_of, run_story

STOP = "/api/v1/stop"


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gateways of a busy machine say their first words later than real ones do."""
    monkeypatch.setattr(emergency_stop, "_FIRST_WORDS_S", DEADLINE_S)


async def stop_until_told(client: httpx.AsyncClient, body: dict[str, object], *, by: str) -> httpx.Response:
    """Give a stop that a gateway does not answer again until another has: on a busy machine that is not in its first words."""
    async with asyncio.timeout(DEADLINE_S):
        while True:
            answer = await client.post(STOP, json=body)
            assert answer.status_code == HTTPStatus.SERVICE_UNAVAILABLE
            if any(one["gateway"] == by and one["outcome"] for one in answer.json()["answers"]):
                return answer


@pytest.mark.usefixtures("patient")
def test_a_stop_of_all_reaches_every_gateway_and_answers_with_what_each_says() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        gateways[1].answer = lambda _request: (Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.UNKNOWN)
        answer = await client.post(STOP, json={"wait_s": DEADLINE_S, "id": "one"})
        assert answer.status_code == HTTPStatus.OK
        check_against(openapi_of(side), STOP, answer, method="post")
        assert [(one["gateway"], one["biobot"], one["outcome"]) for one in answer.json()["answers"]] == [
            ("gateway1", None, "biobot_confirmed"),
            ("gateway2", None, "unknown"),
        ]
        for gateway in gateways:
            (request,) = gateway.commands
            assert (request.command_id, request.node, request.action) == ("one", EVERYBODY, StimulationAction.STOP_ALL)
            assert request.operator == "anna"
        assert (await client.get("/api/v1/commands/one")).json()["outcome"] == "unknown"
        bare = await client.post(STOP, params={}, content=b"")
        assert bare.status_code in {HTTPStatus.OK, HTTPStatus.ACCEPTED}
        assert (gateways[0].commands[1].operator, gateways[0].commands[1].action) == ("anna", StimulationAction.STOP_ALL)
        other = await client.post(STOP, json={"id": "one", "biobots": [5]})
        assert other.status_code in {HTTPStatus.OK, HTTPStatus.ACCEPTED}
        assert other.json()["id"] != "one"
        for content_type in ("application/x-www-form-urlencoded", "text/plain"):
            n_before = len(gateways[0].commands)
            answer = await client.post(STOP, content=b'{"wait_s": 20}', headers={"content-type": content_type})
            assert answer.status_code in {HTTPStatus.OK, HTTPStatus.ACCEPTED}
            assert len(gateways[0].commands) == n_before + 1
        broken = await client.post(STOP, content=b"{", headers={"content-type": "application/json"})
        assert broken.status_code == HTTPStatus.UNPROCESSABLE_ENTITY
        assert broken.json()["detail"].startswith("nothing was stopped")

    run_story(story, n_gateways=2)


def test_a_gateway_that_tells_nothing_is_named_and_asked_again_under_the_same_id(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "_ASKED_FOR_S", 10 * DEADLINE_S)

    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        is_free = threading.Event()

        def hang(_request: StimulationRequest) -> Iterator[Stage]:
            is_free.wait(DEADLINE_S)
            yield Stage.BIOBOT_CONFIRMED

        gateways[1].answer = hang
        try:
            answer = await stop_until_told(client, {"id": "one"}, by="gateway1")
            check_against(openapi_of(side), STOP, answer, method="post")
            told = answer.json()
            assert told["unanswered"] == ["gateway2"]
            assert "'gateway2'" in told["detail"]
            assert told["answers"][0]["outcome"] == "biobot_confirmed"
            await until(lambda: len(gateways[1].asked) > 1)
        finally:
            is_free.set()
        again = await client.post(STOP, json={"id": "one", "wait_s": DEADLINE_S})
        assert (again.status_code, again.json()["has_ended"]) == (HTTPStatus.OK, True)
        assert {request.command_id for gateway in gateways for request in gateway.asked} == {"one"}

    run_story(story, n_gateways=2)


def test_nothing_that_is_full_or_busy_holds_a_stop_back() -> None:
    """256 commands under way, the store's thread and every thread of the default pool busy."""

    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        (gateway,) = gateways
        await meet(side, gateway, 5)
        is_free = threading.Event()

        def hang_unless_stop(request: StimulationRequest) -> Iterator[Stage]:
            yield Stage.ACCEPTED
            if request.action is StimulationAction.START:
                is_free.wait(DEADLINE_S)
            yield Stage.BIOBOT_CONFIRMED

        gateway.answer = hang_unless_stop
        start = {"biobot": 5, "action": "start", "wait_s": 0}
        try:
            for _ in range(256):
                await side.desk.submit(Wish(node=NodeId(5), action=StimulationAction.START, operator="anna"))
            assert (await client.post("/api/v1/commands", json=start)).status_code == HTTPStatus.TOO_MANY_REQUESTS
            loop = asyncio.get_running_loop()
            busy = [loop.run_in_executor(None, is_free.wait, DEADLINE_S) for _ in range(64)]
            reading = asyncio.ensure_future(side.records.call(lambda _store: is_free.wait(DEADLINE_S)))
            everybody = await client.post(STOP, json={"wait_s": DEADLINE_S})
            one = await client.post(STOP, json={"wait_s": DEADLINE_S, "biobots": [5, "5"]})
            command = await client.post("/api/v1/commands", json={"biobot": 5, "action": "stop"})
            assert not is_free.is_set()
            for answer in (everybody, one):
                assert answer.status_code == HTTPStatus.OK
                assert [told["outcome"] for told in answer.json()["answers"]] == ["biobot_confirmed"]
            assert command.json()["outcome"] == "biobot_confirmed"
        finally:
            is_free.set()
        await asyncio.gather(*busy, reading)

    run_story(story)


def test_a_stop_of_a_biobot_that_nobody_here_knows_goes_to_all_gateways() -> None:
    async def story(_side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        gateways[0].answer = lambda _request: (Stage.REFUSED,)
        gateways[0].refusal = Refusal.UNKNOWN_BIOBOT
        stop = {"biobot": 9, "action": "stop", "id": "nine"}
        answer = await client.post("/api/v1/commands", json=stop)
        assert (answer.status_code, answer.json()["outcome"]) == (HTTPStatus.OK, "biobot_confirmed")
        assert [len(gateway.commands) for gateway in gateways] == [1, 1]
        gateways[1].answer, gateways[1].refusal = gateways[0].answer, Refusal.UNKNOWN_BIOBOT
        unknown = await client.post("/api/v1/commands", json={**stop, "id": "ten"})
        assert unknown.status_code == HTTPStatus.NOT_FOUND

    run_story(story, n_gateways=2)


def test_a_stop_leaves_after_the_starts_that_were_given_before_it() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        await meet(side, gateways[0], 5)
        actions = ["start", "stop", "start", "turn_left", "stop"] * 8
        names = [f"{number:02}" for number in range(len(actions))]
        for name, action in zip(names, actions, strict=True):
            body = {"biobot": 5, "action": action, "wait_s": 0, "id": name}
            assert (await client.post("/api/v1/commands", json=body)).status_code in {HTTPStatus.OK, HTTPStatus.ACCEPTED}
        await until(lambda: len(gateways[0].commands) == len(actions))
        assert [request.action.value for request in gateways[0].commands] == actions
        # On a machine that is kept from its work a stop may be asked twice, but never after what was given later.
        asked = [request.command_id for request in gateways[0].asked]
        assert asked == sorted(asked)

    run_story(story)


def test_a_stop_that_nobody_answers_is_not_repeated_once_its_biobot_was_told_something_else() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        await meet(side, gateways[0], 5)
        gateways[0].answer = lambda _request: ()
        for name, action in (("one", "stop"), ("two", "start")):
            body = {"biobot": 5, "action": action, "wait_s": 0, "id": name}
            assert (await client.post("/api/v1/commands", json=body)).status_code in {HTTPStatus.OK, HTTPStatus.ACCEPTED}
        await until(lambda: side.desk.log.get("one").is_closed and side.desk.log.get("two").is_closed)
        asked = [request.command_id for request in gateways[0].asked]
        assert (asked[-1], asked.count("two")) == ("two", 1)
        start = side.desk.log.get("two")
        assert (str(start.outcome), start.reason) == ("unknown", "the gateway is on the bus, but told nothing of it")

    run_story(story)


def test_a_stop_that_one_gateway_may_have_given_is_not_told_as_undelivered_because_another_is_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "_ASKED_FOR_S", 1.0)

    async def story() -> None:
        ports = [free_port(), free_port()]
        with FakeGateway(port=ports[1], name="gateway2") as other:
            async with mapper_side(ports[0], more_ports=ports[1:]) as side, client_of(side) as client:
                with FakeGateway(port=ports[0]) as gateway:
                    await until(lambda: gateway.is_heard and other.is_heard)
                    await meet(side, gateway, 5)
                await until(lambda: not side.fleet.is_on_bus("gateway1") and side.fleet.is_on_bus("gateway2"))
                other.answer = lambda _request: (Stage.ACCEPTED, Stage.UNKNOWN)
                body = {"biobot": 5, "action": "stop", "id": "five"}
                answer = await client.post("/api/v1/commands", json=body)
                assert (answer.status_code, answer.json()["outcome"]) == (HTTPStatus.OK, "unknown")
                told = {one["gateway"]: one["outcome"] for one in answer.json()["answers"]}
                assert told == {"gateway1": "undelivered", "gateway2": "unknown"}

    asyncio.run(story())


def test_a_biobot_whose_gateway_is_away_is_stopped_by_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "_ASKED_FOR_S", 10 * DEADLINE_S)

    async def story() -> None:
        ports = [free_port(), free_port()]
        with FakeGateway(port=ports[1], name="gateway2") as other:
            async with mapper_side(ports[0], more_ports=ports[1:]) as side, client_of(side) as client:
                with FakeGateway(port=ports[0]) as gateway:
                    await until(lambda: gateway.is_heard and other.is_heard)
                    await meet(side, gateway, 5)
                await until(lambda: not side.fleet.is_on_bus("gateway1") and side.fleet.is_on_bus("gateway2"))
                answer = await stop_until_told(client, {"biobots": [5], "id": "one"}, by="gateway2")
                told = {one["gateway"]: one["outcome"] for one in answer.json()["answers"]}
                assert told["gateway2"] == "biobot_confirmed"
                assert answer.json()["unanswered"] == ["gateway1"]

    asyncio.run(story())


def test_a_stop_goes_to_every_gateway_that_has_heard_the_biobot_and_one_alone_may_give_a_train() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        await meet(side, gateways[0], 5)
        gateways[1].publish_node(5)
        await until(lambda: set(side.fleet.hearers_of(NodeId(5))) == {"gateway1", "gateway2"})
        nearest, other = side.fleet.hearers_of(NodeId(5))
        by_name = {"gateway1": gateways[0], "gateway2": gateways[1]}
        by_name[nearest].answer = lambda _request: (Stage.ACCEPTED, Stage.UNKNOWN)
        answer = await client.post("/api/v1/commands", json={"biobot": 5, "action": "stop", "id": "five"})
        assert (answer.status_code, answer.json()["outcome"]) == (HTTPStatus.OK, "biobot_confirmed")
        await until(lambda: side.desk.log.get("five").is_settled)
        assert {name: str(one.outcome) for name, one in side.desk.log.get("five").answers.items()} == {
            nearest: "unknown",
            other: "biobot_confirmed",
        }
        assert [request.pulse for request in by_name[nearest].commands] == [None]
        assert [request.pulse for request in by_name[other].commands] == [PulseRequest(duration_ms=0)]

    run_story(story, n_gateways=2)


def test_a_biobot_that_walks_to_another_gateway_while_it_is_stopped_is_stopped_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gateway that alone had heard it gets no answer from it; the one that hears it next is asked too, and gives no second train."""
    monkeypatch.setattr(commands, "_ASKED_FOR_S", 10 * DEADLINE_S)

    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        await meet(side, gateways[0], 5)
        gateways[0].answer = lambda _request: (Stage.ACCEPTED, Stage.UNKNOWN)
        answer = await client.post("/api/v1/commands", json={"biobot": 5, "action": "stop", "id": "five"})
        assert (answer.status_code, answer.json()["outcome"]) == (HTTPStatus.OK, "unknown")
        assert gateways[1].commands == []
        gateways[1].publish_node(5)
        await until(lambda: side.desk.log.get("five").is_done)
        (request,) = gateways[1].commands
        assert (request.command_id, request.node, request.pulse) == ("five", NodeId(5), PulseRequest(duration_ms=0))
        assert (await client.get("/api/v1/commands/five")).json()["outcome"] == "biobot_confirmed"

    run_story(story, n_gateways=2)


def test_a_gateway_that_comes_back_is_stopped_all_the_same() -> None:
    async def story() -> None:
        port = free_port()
        async with mapper_side(port) as side, client_of(side) as client:
            answer = await client.post(STOP, json={"id": "one"})
            assert answer.status_code == HTTPStatus.SERVICE_UNAVAILABLE
            assert answer.json()["unanswered"] == []
            assert "no gateway is on the bus" in answer.json()["detail"]
            with FakeGateway(port=port) as gateway:
                await until(lambda: bool(gateway.commands))
                told = await client.get("/api/v1/commands/one", params={"wait_s": DEADLINE_S})
                assert told.json()["outcome"] in {"biobot_confirmed", "undelivered"}
                await until(lambda: side.desk.log.get("one").is_answered)
            assert side.desk.log.get("one").answers["gateway1"].outcome == "biobot_confirmed"

    asyncio.run(story())


def test_a_stop_that_makes_no_sense_is_not_given() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        bad: list[object] = [[], 5, "all", {"biobots": []}, {"biobots": [-1]}, {"biobots": list(range(257))}, {"operator": "ann"}]
        bad += [{"id": "a/b"}, {"id": "a" * 41}, {"wait_s": -1}, {"wait_s": 61}, {"biobot": 5}]
        for body in bad:
            answer = await client.post(STOP, json=body)
            assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, body
            check_against(document, STOP, answer, method="post")
        foreign = await client.post(STOP, headers={"Origin": "http://evil.example"})
        assert foreign.status_code == HTTPStatus.FORBIDDEN
        assert gateways[0].commands == []

    run_story(story)
