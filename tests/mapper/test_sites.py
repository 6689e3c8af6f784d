"""What is beside the map: sites on the bus, and recordings of gateways."""

import httpx

from firmware_protocol.contract.recordings import RecordingEntry, RecordingList
from firmware_protocol.units import Nanoseconds
from tests.mapper.fake_gateway import SITE, FakeGateway
from tests.mapper.mapper_side import Side, until
from tests.mapper.web_side import check_against, openapi_of, run_story


def test_sites_on_the_bus_are_listed_with_the_gateways_that_are_there() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        gateways[0].be_alive_at("annex")
        await until(lambda: "annex" in side.bus.sites() and len(side.bus.sites()[SITE]) == 2)
        answer = await client.get("/api/v1/sites")
        check_against(openapi_of(side), "/api/v1/sites", answer)
        assert answer.json()["sites"] == [
            {"name": "annex", "gateways": ["gateway1"], "is_mapped": False},
            {"name": SITE, "gateways": ["gateway1", "gateway2"], "is_mapped": True},
        ]
        gateways[1].__exit__()
        await until(lambda: side.bus.sites()[SITE] == ["gateway1"])

    run_story(story, n_gateways=2)


def test_recordings_of_all_gateways_are_listed_and_of_none_an_empty_list() -> None:
    async def story(side: Side, gateways: list[FakeGateway], client: httpx.AsyncClient) -> None:
        empty = {"recordings": [], "recording": [], "n_left_out": 0}
        assert (await client.get("/api/v1/recordings")).json() == empty
        entries = [
            RecordingEntry(name=name, radio="usb", begin_wall_ns=Nanoseconds(5), end_wall_ns=end, n_bytes=7)
            for name, end in (("usb-1.biorec", Nanoseconds(9)), ("usb-2.biorec", None))
        ]
        gateways[1].recordings = RecordingList(gateway="gateway2", is_recording=True, recordings=tuple(entries), n_left_out=3)
        answer = await client.get("/api/v1/recordings")
        check_against(openapi_of(side), "/api/v1/recordings", answer)
        assert answer.json() == {
            "recordings": [
                {"gateway": "gateway2", "name": "usb-1.biorec", "radio": "usb", "begin_wall_ns": 5, "end_wall_ns": 9, "n_bytes": 7},
                {"gateway": "gateway2", "name": "usb-2.biorec", "radio": "usb", "begin_wall_ns": 5, "end_wall_ns": None, "n_bytes": 7},
            ],
            "recording": ["gateway2"],
            "n_left_out": 3,
        }

    run_story(story, n_gateways=2)
