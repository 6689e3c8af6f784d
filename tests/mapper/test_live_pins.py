"""The operator's pins: kept over a restart, found on every new map, and the frame of the map once there are three."""

import asyncio
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from math import dist
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapper.frames import Similarity
from mapper.map_codec import decode_map
from mapper.map_framing import frame_map
from mapper.named_pins import NamedPin
from mapper.pin_board import MAX_PINS
from mapper.report import to_json_object
from tests.mapper.fake_gateway import encounter
from tests.mapper.mapper_side import Side, mapper_side, until
from tests.mapper.ring import ring_map, ring_records
from tests.mapper.web_side import check_against, client_of, openapi_of

PINS = "/api/v1/pins"
CORNERS = {"door": ("landmark:1001", 0.0, 0.0), "shaft": ("landmark:1006", 10.0, 0.0), "tree": ("landmark:1011", 10.0, 10.0)}


def run(story: Callable[[Side, httpx.AsyncClient], Awaitable[None]], *, store: Path | None = None) -> None:
    async def whole() -> None:
        async with mapper_side(1, with_map=True, store=store) as side, client_of(side) as client:
            if side.current_map.latest is None:
                await side.take_in(ring_records())
                await until(lambda: side.current_map.latest is not None)
            await story(side, client)

    asyncio.run(whole())


async def get(client: httpx.AsyncClient, path: str) -> Any:
    answer = await client.get(path)
    assert answer.status_code == HTTPStatus.OK, answer.text
    return answer.json()


async def pin(client: httpx.AsyncClient, name: str) -> httpx.Response:
    place, x, y = CORNERS[name]
    return await client.put(f"{PINS}/{name}", json={"place": place, "x": x, "y": y})


def test_three_pins_put_map_numbers_and_files_into_the_frame_and_outlive_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "records.db"

    async def first(side: Side, client: httpx.AsyncClient) -> None:
        document = openapi_of(side)
        bare = await client.get("/api/v1/map")
        assert bare.json()["frame"] is None
        for name, frame_is_there in (("door", False), ("shaft", False), ("tree", True)):
            answer = await pin(client, name)
            assert answer.status_code == HTTPStatus.CREATED
            check_against(document, PINS + "/{name}", answer, method="put")
            listed = await get(client, PINS)
            assert (listed["frame"] is not None) is frame_is_there
            assert bool(listed["problems"]) is not frame_is_there
        framed = await client.get("/api/v1/map", headers={"If-None-Match": bare.headers["etag"]})
        assert framed.status_code == HTTPStatus.OK
        map_ = framed.json()
        assert (map_["version"], map_["frame"]["kind"]) == (bare.json()["version"], "operator")
        assert map_["frame"] == listed["frame"]
        (fit,) = map_["frame"]["components"]
        to_frame = np.array(fit["matrix"]), np.array(fit["shift"])
        for item in listed["pins"]:
            known = (item["x"], item["y"])
            assert abs(dist(to_frame[0] @ [item["map_x"], item["map_y"]] + to_frame[1], known) - item["residual_m"]) < 1e-9
            assert item["residual_m"] < 0.5
        (hole,) = (await get(client, "/api/v1/holes"))["holes"]
        assert np.allclose(to_frame[0] @ hole["centre"] + to_frame[1], hole["in_frame"]["centre"])
        assert np.isclose(hole["in_frame"]["area"], hole["area"] * fit["scale"] ** 2)
        assert 2 < hole["in_frame"]["centre"][0] < 8
        assert await get(client, "/api/v1/holes/1") == await get(client, "/api/v1/holes/1") | hole
        far = await get(client, "/api/v1/distance?from=landmark:1001&to=landmark:1006")
        assert abs(far["in_frame"]["straight"] - 10) < 0.5
        assert far["distance"] >= far["straight"] * (1 - 1e-9)
        assert (await get(client, "/api/v1/map.geojson"))["coordinate_frame"]["kind"] == "operator"

    async def second(side: Side, client: httpx.AsyncClient) -> None:
        listed = await get(client, PINS)
        assert [item["name"] for item in listed["pins"]] == sorted(CORNERS)
        assert listed["frame"] is not None
        version = side.current_map.require().version
        last = max(record.offset for record in ring_records())
        await side.take_in([encounter(last + 1, nodes=(1, 2))])
        await until(lambda: side.current_map.require().version > version)
        assert (await get(client, "/api/v1/map"))["frame"] is not None
        assert (await client.delete(f"{PINS}/tree")).status_code == HTTPStatus.NO_CONTENT
        assert (await get(client, "/api/v1/map"))["frame"] is None
        gone = await client.delete(f"{PINS}/tree")
        assert gone.status_code == HTTPStatus.NOT_FOUND
        check_against(openapi_of(side), PINS + "/{name}", gone, method="delete")

    run(first, store=path)
    run(second, store=path)


def test_a_place_of_one_map_is_kept_as_who_was_there_and_no_bad_pin_is_kept() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        points = (await get(client, "/api/v1/map"))["points"]
        for place, point in (("point:3", points[3]), (f"xy:{points[5]['x']:.9g},{points[5]['y']:.9g}", points[5])):
            item = (await client.put(f"{PINS}/here", json={"place": place})).json()
            assert item["place"].startswith("biobot:")
            assert dist((item["map_x"], item["map_y"]), (point["x"], point["y"])) < 1e-3
        for place in ("landmark:77", "biobot:77"):
            item = (await client.put(f"{PINS}/there", json={"place": place, "x": 1, "y": 2})).json()
            assert (item["map_x"], item["residual_m"]) == (None, None)
            assert "77" in item["problem"]
        newest = (await client.put(f"{PINS}/walker", json={"place": "biobot:3"})).json()
        last = max((point["t"], index) for index, point in enumerate(points) if 3 in {point["id1"], point["id2"]})[1]
        assert dist((newest["map_x"], newest["map_y"]), (points[last]["x"], points[last]["y"])) < 1e-9

        document = openapi_of(side)
        fine = {"place": "landmark:1001"}
        for name, body in (
            ("a", {}),
            ("a", {"place": "nowhere"}),
            ("a", {"place": "point:99999"}),
            ("a", {"place": "xy:0,0,9"}),
            ("a", fine | {"x": 1.0}),
            ("a", fine | {"x": "1", "y": 2.0}),
            ("a", fine | {"x": 1e9, "y": 2.0}),
            ("a", fine | {"more": 1}),
            ("a" * 65, fine),
            ("%20a", fine),
            ("a%0Ab", fine),
        ):
            answer = await client.put(f"{PINS}/{name}", json=body)
            assert answer.status_code == HTTPStatus.UNPROCESSABLE_ENTITY, (name, body)
            check_against(document, PINS + "/{name}", answer, method="put")
        assert {one.name for one in side.pins.pins} == {"here", "there", "walker"}
        for number in range(MAX_PINS - 3):
            await side.pins.put(NamedPin(name=f"pin {number}", place="landmark:1"))
        full = await client.put(f"{PINS}/one more", json=fine)
        assert full.status_code == HTTPStatus.CONFLICT
        assert (await client.put(f"{PINS}/pin 1", json=fine)).status_code == HTTPStatus.OK

    run(story)


@settings(max_examples=20)
@given(
    scale=st.floats(0.1, 10),
    turn=st.floats(-3.1, 3.1),
    is_mirrored=st.booleans(),
    shift=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
)
def test_any_similarity_is_found_again_from_pins(scale: float, turn: float, is_mirrored: bool, shift: tuple[float, float]) -> None:
    result = decode_map(ring_map())
    wanted = Similarity(scale=scale, turn_rad=turn, is_mirrored=is_mirrored, shift=shift)
    chosen = [landmark for landmark in result.landmarks if landmark.node % 4 == 1]
    known = wanted(np.array([(landmark.x, landmark.y) for landmark in chosen]))
    pins = [
        NamedPin(name=str(landmark.node), place=f"landmark:{landmark.node}", x=x, y=y)
        for landmark, (x, y) in zip(chosen, known.tolist(), strict=True)
    ]
    lost = NamedPin(name="lost", place="landmark:3", x=0.0, y=0.0)
    framing = frame_map(result, [*pins, lost])
    assert framing.places[-1].problem is not None
    assert max(place.residual_m or 0.0 for place in framing.places) < 1e-6 * (1 + 100 * scale)
    assert b'"is_mirrored":' + (b"true" if is_mirrored else b"false") in framing.frame_json
    assert len(to_json_object(result)["landmarks"]) == 20  # type: ignore[arg-type]  # a list
    assert frame_map(result, pins[:2]).frame_json == b"null"


def test_whoever_puts_a_pin_is_told_what_was_put_though_it_is_dropped_before_the_answer() -> None:
    async def story(side: Side, client: httpx.AsyncClient) -> None:
        for _ in range(5):
            putting = asyncio.create_task(pin(client, "door"))
            for _ in iter(lambda: bool(side.services.pins.pins), True):
                await asyncio.sleep(0)
            assert (await client.delete(f"{PINS}/door")).status_code == HTTPStatus.NO_CONTENT
            put = await putting
            assert (put.status_code, put.json()["name"]) == (HTTPStatus.CREATED, "door")

    run(story)
