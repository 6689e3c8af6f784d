"""The endpoints of what was: maps of the past, and what is different between them."""

from http import HTTPStatus
from typing import Annotated, Final

from fastapi import APIRouter, Path, Query, Request, Response

from mapper.api.data_schemas import DiagramView
from mapper.api.descriptions import describe_answers
from mapper.api.past_schemas import DifferenceView, PastMapList
from mapper.api.quick_answers import served
from mapper.api.schemas import MapView
from mapper.api.services import Services
from mapper.api.views import JSON_TYPE, json_response
from mapper.map_archive import PastMap
from mapper.served_bytes import ServedBytes

_MAX_VERSION: Final = 2**63 - 1
_PROBLEMS: Final = (HTTPStatus.NOT_FOUND, HTTPStatus.UNPROCESSABLE_ENTITY, HTTPStatus.SERVICE_UNAVAILABLE)

Version = Annotated[int, Path(ge=1, le=_MAX_VERSION, description="The number of a map that `/api/v1/maps` lists")]


def add_past_routes(router: APIRouter, services: Services) -> None:
    """Add maps of the past."""

    @router.get("/api/v1/maps", tags=["past"], responses=describe_answers(PastMapList, (HTTPStatus.UNPROCESSABLE_ENTITY,)))
    async def get_maps(
        after: Annotated[int, Query(ge=0, le=_MAX_VERSION, description="Only maps of higher versions")] = 0,
        limit: Annotated[int, Query(ge=1, le=10_000, description="Maps, at most")] = 1000,
    ) -> Response:
        """List the maps that are kept, the newest last: all of the last minutes, fewer of the time before."""
        found, has_more = services.history.page(after=after, limit=limit)
        return json_response({"maps": [_view(facts) for facts in found], "next": found[-1].version if has_more else None})

    @router.get(
        "/api/v1/maps/{version}", tags=["past"], responses=describe_answers(MapView, _PROBLEMS, is_versioned=True, has_freshness=False)
    )
    async def get_past_map(request: Request, version: Version) -> Response:
        """Return a map of the past as `/api/v1/map` gave it; each lies as the one before."""
        facts, map_json, _ = await services.history.documents(version)
        return await served(request.headers, ServedBytes(map_json, tag=facts.tag), media_type=JSON_TYPE, headers={})

    @router.get(
        "/api/v1/maps/{version}/diagram",
        tags=["past"],
        responses=describe_answers(DiagramView, _PROBLEMS, is_versioned=True, has_freshness=False),
    )
    async def get_past_diagram(request: Request, version: Version) -> Response:
        """Return the persistence diagram of a map of the past."""
        facts, _, diagram_json = await services.history.documents(version)
        return await served(request.headers, ServedBytes(diagram_json, tag=facts.tag), media_type=JSON_TYPE, headers={})

    @router.get("/api/v1/maps/{version}/difference", tags=["past"], responses=describe_answers(DifferenceView, _PROBLEMS))
    async def get_map_difference(
        version: Version, since: Annotated[int, Query(ge=1, le=_MAX_VERSION, description="The version to compare it with")]
    ) -> Response:
        """Say what is different in a map from another one: holes that appeared, vanished and stayed, landmarks, components, size."""
        return json_response(await services.history.difference(since=since, version=version))


def _view(facts: PastMap) -> dict[str, object]:
    b0, b1 = facts.betti_numbers
    return {
        "version": facts.version,
        "wall_ns": facts.wall_ns,
        "begun_wall_ns": facts.begun_wall_ns,
        "n_encounters": facts.n_encounters,
        "b0": b0,
        "b1": b1,
        "hole_count_probability": facts.hole_probability,
        "is_enough": facts.is_enough,
        "made_by": facts.made_by,
    }
