"""The endpoints under ``/api/v1``, and those that watch the process.

Answers are bytes made once for a version of the map, or small objects; no large one passes through a model. Before the
first map the map's endpoints answer 503 with what is awaited and ``Retry-After``. Commands are in ``command_routes``.
"""

import time
from http import HTTPStatus
from typing import Annotated, Final

from fastapi import APIRouter, Query, Request, Response

from mapper.api.command_routes import add_command_routes, add_mission_routes
from mapper.api.descriptions import describe_answers
from mapper.api.event_stream import EventStream
from mapper.api.schemas import (
    BiobotList,
    DiagramView,
    EncounterList,
    GatewayList,
    HealthView,
    MapStatusView,
    MapView,
    ReadyView,
    RoutesView,
)
from mapper.api.services import Services
from mapper.api.token_routes import add_access_routes
from mapper.api.views import (
    JSON_TYPE,
    json_response,
    versioned_response,
    view_biobot,
    view_encounter,
    view_gateway,
    view_gateways,
    view_map_status,
)
from mapper.map_snapshot import MapSnapshot
from mapper.places import parse_place
from mapper.routes import MAX_CLASSES
from mapper.store import Store

_MAP_PROBLEMS: Final = (HTTPStatus.SERVICE_UNAVAILABLE,)
_PICTURE_PROBLEMS: Final = (HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.INTERNAL_SERVER_ERROR)
_ROUTE_PROBLEMS: Final = (
    HTTPStatus.NOT_FOUND,
    HTTPStatus.UNPROCESSABLE_ENTITY,
    HTTPStatus.TOO_MANY_REQUESTS,
    HTTPStatus.SERVICE_UNAVAILABLE,
    HTTPStatus.INTERNAL_SERVER_ERROR,
)
_PLACE_FORMS: Final = "landmark:ID, landmark:ID@T, biobot:ID@T, point:INDEX, or xy:X,Y[,COMPONENT]; T in seconds since 1970"
GEOJSON_TYPE: Final = "application/geo+json"
_MAX_CURSOR: Final = 2**63 - 1


def make_router(services: Services, stream: EventStream) -> APIRouter:
    """Make all endpoints."""
    router = APIRouter()
    _add_map_routes(router, services)
    _add_geometry_routes(router, services)
    _add_record_routes(router, services)
    add_command_routes(router, services)
    add_mission_routes(router, services)
    add_access_routes(router, services)
    _add_watch_routes(router, services, stream)
    return router


def _add_map_routes(router: APIRouter, services: Services) -> None:
    @router.get("/api/v1/map", tags=["map"], responses=describe_answers(MapView, _MAP_PROBLEMS, is_versioned=True))
    async def get_map(request: Request) -> Response:
        """Return the newest finished map: points, Rips complex, holes, intervals, landmarks."""
        snapshot = services.current_map.require()
        return versioned_response(
            request, snapshot.map_json, etag=snapshot.etag, media_type=JSON_TYPE, headers=_freshness(services, snapshot)
        )

    @router.get("/api/v1/map/status", tags=["map"], responses=describe_answers(MapStatusView))
    async def get_map_status() -> Response:
        """Say what the newest finished map is of, how old it is, and how many records it waits to take in; small, to be asked often."""
        return json_response(view_map_status(services.current_map.status))

    @router.get("/api/v1/diagram", tags=["map"], responses=describe_answers(DiagramView, _MAP_PROBLEMS, is_versioned=True))
    async def get_diagram(request: Request) -> Response:
        """Return the persistence diagram of the newest finished map."""
        snapshot = services.current_map.require()
        return versioned_response(
            request, snapshot.diagram_json, etag=snapshot.etag, media_type=JSON_TYPE, headers=_freshness(services, snapshot)
        )

    @router.get("/api/v1/map.svg", tags=["map"], responses=describe_answers("image/svg+xml", _PICTURE_PROBLEMS, is_versioned=True))
    async def get_map_svg(request: Request) -> Response:
        """Draw the newest finished map as SVG."""
        snapshot, picture = await services.current_map.picture("svg")
        return versioned_response(request, picture, etag=snapshot.etag, media_type="image/svg+xml", headers=_freshness(services, snapshot))

    @router.get("/api/v1/map.png", tags=["map"], responses=describe_answers("image/png", _PICTURE_PROBLEMS, is_versioned=True))
    async def get_map_png(request: Request) -> Response:
        """Draw the newest finished map as PNG."""
        snapshot, picture = await services.current_map.picture("png")
        return versioned_response(request, picture, etag=snapshot.etag, media_type="image/png", headers=_freshness(services, snapshot))


def _add_geometry_routes(router: APIRouter, services: Services) -> None:
    @router.get("/api/v1/map.geojson", tags=["map"], responses=describe_answers(GEOJSON_TYPE, _PICTURE_PROBLEMS, is_versioned=True))
    async def get_map_geojson(request: Request) -> Response:
        """Return the newest finished map as GeoJSON: points, holes, landmarks, hulls. Not WGS 84: `coordinate_frame` says what it is."""
        snapshot, document = await services.current_map.geojson()
        return versioned_response(request, document, etag=snapshot.etag, media_type=GEOJSON_TYPE, headers=_freshness(services, snapshot))

    @router.get("/api/v1/route", tags=["map"], responses=describe_answers(RoutesView, _ROUTE_PROBLEMS))
    async def get_route(
        begin: Annotated[str, Query(alias="from", max_length=100, description=_PLACE_FORMS)],
        end: Annotated[str, Query(alias="to", max_length=100, description=_PLACE_FORMS)],
        classes: Annotated[int, Query(ge=1, le=MAX_CLASSES, description="Routes that pass obstacles on different sides, at most")] = 3,
    ) -> Response:
        """Find routes around obstacles between two places of the newest finished map: the shortest of each kind, the shortest first."""
        snapshot, found = await services.current_map.routes(str(parse_place(begin)), str(parse_place(end)), classes=classes)
        headers = {"Cache-Control": "no-store", **_freshness(services, snapshot)}
        return Response(found, media_type=JSON_TYPE, headers=headers)


def _add_record_routes(router: APIRouter, services: Services) -> None:
    @router.get("/api/v1/biobots", tags=["biobots"], responses=describe_answers(BiobotList))
    async def get_biobots() -> Response:
        """List all biobots and gateways with their last known state."""
        now_ns = time.monotonic_ns()
        return json_response(
            {
                "now_wall_ns": time.time_ns(),
                "gateways": [view_gateway(view) for view in services.fleet.gateways(now_ns=now_ns)],
                "mappers": services.fleet.mappers(),
                "commanders": services.fleet.commanders(),
                "biobots": [view_biobot(view) for view in services.fleet.biobots(now_ns=now_ns)],
            }
        )

    @router.get("/api/v1/gateways", tags=["biobots"], responses=describe_answers(GatewayList))
    async def get_gateways() -> Response:
        """List all gateways, and how far the clock of each of their starts is from the site's."""
        views = services.fleet.gateways(now_ns=time.monotonic_ns())
        return json_response({"gateways": view_gateways(views, services.records.clocks)})

    @router.get("/api/v1/encounters", tags=["records"], responses=describe_answers(EncounterList, (HTTPStatus.UNPROCESSABLE_ENTITY,)))
    async def get_encounters(
        after: Annotated[int, Query(ge=0, le=_MAX_CURSOR, description="The cursor of the page before")] = 0,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    ) -> Response:
        """List records of encounters in the order in which they were last changed; a void one was a part of another and counts no more.

        What several gateways told of is in as many records; each says what it is a part of, as things stand now.
        """
        page = await services.records.call(Store.encounters, after=after, limit=limit)
        return json_response(
            {
                "encounters": [
                    view_encounter(record, shift_ns=shift_ns, bound_ns=bound_ns, joint=joint)
                    for record, shift_ns, bound_ns, joint in zip(page.records, page.shifts_ns, page.bounds_ns, page.joint, strict=True)
                ],
                "cursor": page.cursor,
                "next": page.cursor if page.has_more else None,
            }
        )


def _add_watch_routes(router: APIRouter, services: Services, stream: EventStream) -> None:
    @router.get("/api/v1/events", tags=["watch"], responses=describe_answers("text/event-stream", (HTTPStatus.TOO_MANY_REQUESTS,)))
    async def get_events() -> Response:
        """Tell of changes as server-sent events: the version numbers of map, records, biobots, commands and mission, the newest only."""
        return stream.open()

    @router.get("/healthz", tags=["watch"], responses=describe_answers(HealthView))
    async def get_health() -> Response:
        """Say that the process answers, and what it has counted."""
        status, faults = services.current_map.status, services.faults()
        return json_response(
            {
                "status": "degraded" if faults else "ok",
                "wall_ns": time.time_ns(),
                "n_encounters": status.n_known,
                "map_version": status.snapshot.version if status.snapshot else None,
                "waiting": status.waiting,
                "counters": services.counters(),
                "faults": faults,
                "engines": {"kernels": services.engines.kernels, "persistence": services.engines.persistence},
            }
        )

    @router.get(
        "/readyz", tags=["watch"], responses=describe_answers(ReadyView) | {503: {"model": ReadyView, "description": "Not connected"}}
    )
    async def get_readiness() -> Response:
        """Say whether the bus is joined: 200 if a gateway or router is connected, 503 if not."""
        is_connected = services.is_connected()
        latest = services.current_map.latest
        gateways = services.fleet.gateways(now_ns=time.monotonic_ns())
        document = {
            "is_ready": is_connected,
            "is_connected": is_connected,
            "n_gateways_alive": sum(view.is_alive for view in gateways),
            "map_version": latest.version if latest else None,
        }
        return json_response(document, status=HTTPStatus.OK if is_connected else HTTPStatus.SERVICE_UNAVAILABLE)


def _freshness(services: Services, snapshot: MapSnapshot) -> dict[str, str]:
    """Make the headers that say how far this map is behind [s], and how many records it lacks; a newer one may have come meanwhile."""
    n_waiting, behind_s = services.current_map.lag_of(snapshot)
    return {"Map-Behind": f"{behind_s:.3f}", "Map-Waiting": str(n_waiting)}
