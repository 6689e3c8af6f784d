"""Orders to missions, and what the site's missions do, over HTTP and real Zenoh."""

from http import HTTPStatus

import httpx

from firmware_protocol.contract.mission_orders import MissionAction
from firmware_protocol.contract.records import MissionPhase
from mapper.store import Store
from tests.mapper.fake_gateway import FakeGateway, mission
from tests.mapper.mapper_side import Side
from tests.mapper.web_side import check_against, openapi_of, run_story

ORDERS = "/api/v1/mission/orders"


def test_an_order_goes_to_each_mission_or_to_one_and_refusals_say_why() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        gateways[1].order_answer = lambda _order: (False, "nothing is paused; orders now: start")
        both = await client.post(ORDERS, json={"action": "resume", "id": "one"})
        check_against(document, ORDERS, both, method="post")
        answers = both.json()["answers"]
        assert [(answer["gateway"], answer["is_taken"], answer["reason"]) for answer in answers] == [
            ("gateway1", True, ""),
            ("gateway2", False, "nothing is paused; orders now: start"),
        ]
        second = await client.post(ORDERS, json={"action": "resume", "gateway": "gateway2"})
        assert second.status_code == HTTPStatus.CONFLICT
        check_against(document, ORDERS, second, method="post")
        assert "gateway2: nothing is paused" in second.json()["detail"]
        (first,) = gateways[0].orders
        assert (first.order_id, first.action, first.operator) == ("one", MissionAction.RESUME, "anna")
        absent = await client.post(ORDERS, json={"action": "start", "gateway": "elsewhere"})
        assert absent.status_code == HTTPStatus.SERVICE_UNAVAILABLE
        assert "gateway 'elsewhere' does not answer" in absent.json()["detail"]
        for bad in ({}, {"action": "dance"}, {"action": "start", "operator": "a"}, {"action": "start", "gateway": "*"}):
            answer = await client.post(ORDERS, json=bad)
            assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY
        assert len(gateways[0].orders) == 1

    run_story(story, n_gateways=2)


def test_the_newest_phase_of_each_gateway_is_told() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        phases = (MissionPhase.DISPERSION, MissionPhase.PAUSED)
        await side.take_in([mission(n, phase=phase, t_ns=n) for n, phase in enumerate(phases, 1)])
        await side.until(lambda store: len(Store.missions(store)) == 2)
        answer = await client.get("/api/v1/mission")
        check_against(openapi_of(side), "/api/v1/mission", answer)
        told = answer.json()
        assert [phase["phase"] for phase in told["phases"]] == ["dispersion", "paused"]
        assert [(phase["gateway"], phase["phase"]) for phase in told["gateways"]] == [(gateways[0].name, "paused")]

    run_story(story)
