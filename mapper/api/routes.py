"""The endpoints under ``/api/v1``, and those that watch the process.

Answers are bytes made once for a version of the map, or small objects; no large one passes through a model. Here are those about biobots,
records and the process; the map's are in ``map_routes``, ``picture_routes`` and ``place_routes``, commands in ``command_routes``.
"""

import time
from http import HTTPStatus
from importlib.metadata import version
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Request, Response

from mapper.access import person_of
from mapper.api.alert_routes import add_alert_routes
from mapper.api.command_routes import add_command_routes, add_mission_routes
from mapper.api.descriptions import describe_answers
from mapper.api.event_stream import EventStream
from mapper.api.export_routes import add_export_routes
from mapper.api.job_routes import add_job_routes
from mapper.api.map_routes import add_map_routes
from mapper.api.past_routes import add_past_routes
from mapper.api.picture_routes import add_picture_routes
from mapper.api.place_routes import add_place_routes
from mapper.api.refusals import refuse_unknown_parameters
from mapper.api.report_routes import add_report_routes
from mapper.api.schemas import (
    BiobotList,
    EncounterList,
    GatewayList,
    HealthView,
    ReadyView,
)
from mapper.api.services import Services
from mapper.api.site_routes import add_site_routes
from mapper.api.token_routes import add_access_routes
from mapper.api.views import (
    json_response,
    view_biobot,
    view_encounter,
    view_gateway,
    view_gateways,
)
from mapper.presence import presence_of
from mapper.store import Store

_MAX_CURSOR: Final = 2**63 - 1


def make_router(services: Services, stream: EventStream) -> APIRouter:
    """Make all endpoints."""
    router = APIRouter(dependencies=[Depends(refuse_unknown_parameters)])
    add_map_routes(router, services)
    add_picture_routes(router, services)
    add_place_routes(router, services)
    _add_record_routes(router, services)
    add_export_routes(router, services)
    add_job_routes(router, services)
    add_command_routes(router, services)
    add_mission_routes(router, services)
    add_past_routes(router, services)
    add_alert_routes(router, services)
    add_site_routes(router, services)
    add_report_routes(router, services)
    add_access_routes(router, services)
    _add_watch_routes(router, services, stream)
    return router


def _add_record_routes(router: APIRouter, services: Services) -> None:
    @router.get("/api/v1/biobots", tags=["biobots"], responses=describe_answers(BiobotList))
    async def get_biobots() -> Response:
        """List all biobots and gateways with their last known state."""
        now_ns, lost_s = time.monotonic_ns(), services.alerts.lost_s
        gateways = {view.name: view for view in services.fleet.gateways(now_ns=now_ns)}
        return json_response(
            {
                "now_wall_ns": time.time_ns(),
                "lost_after_s": lost_s,
                "gateways": [view_gateway(view) for view in gateways.values()],
                "mappers": services.fleet.mappers(),
                "commanders": services.fleet.commanders(),
                "biobots": [
                    view_biobot(view, presence_of(view, gateways=gateways, lost_s=lost_s)) for view in services.fleet.biobots(now_ns=now_ns)
                ],
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
        limit: Annotated[int, Query(ge=1, le=1000, description="Records, at most")] = 100,
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
    async def get_events(request: Request) -> Response:
        """Tell of changes as server-sent events: the version numbers of map, records, biobots, commands and mission, the newest only."""
        person, register = person_of(request), services.access.register
        return stream.open(is_welcome=lambda: register.is_welcome(person))

    @router.get("/healthz", tags=["watch"], responses=describe_answers(HealthView))
    async def get_health() -> Response:
        """Say that the process answers, and what it has counted."""
        status, faults = services.current_map.status, services.faults()
        return json_response(
            {
                "status": "degraded" if faults else "ok",
                "software": version("biobot-gateway"),
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
