"""The endpoints of the newest finished map: all of it, and its numbers. Before the first map they answer 503 with what is awaited."""

import time
from collections.abc import Mapping
from http import HTTPStatus
from typing import Annotated, Final

from fastapi import APIRouter, Path, Query, Request, Response
from starlette.datastructures import Headers

from mapper.api.data_schemas import BarcodeView, BettiView, CoverageView, DiagramView, HoleList, HoleView
from mapper.api.descriptions import describe_answers
from mapper.api.quick_answers import Answer, served
from mapper.api.schemas import MapStatusView, MapView
from mapper.api.services import Services
from mapper.api.views import JSON_TYPE, json_response, view_map_status
from mapper.map_extracts import extract_betti, extract_hole, extract_holes
from mapper.map_snapshot import MapSnapshot
from mapper.request_errors import LengthsNotKeptError, OtherVersionError
from mapper.served_bytes import ServedBytes
from mapper.wait_promise import judge_promise

MAP_PATH: Final = "/api/v1/map"
MAP_PROBLEMS: Final = (HTTPStatus.SERVICE_UNAVAILABLE,)
_HOLE_PROBLEMS: Final = (HTTPStatus.NOT_FOUND, HTTPStatus.UNPROCESSABLE_ENTITY, HTTPStatus.SERVICE_UNAVAILABLE)
_LENGTHS_PROBLEMS: Final = (HTTPStatus.CONFLICT, HTTPStatus.UNPROCESSABLE_ENTITY, HTTPStatus.SERVICE_UNAVAILABLE)
_MOST_HOLES: Final = 10_000
_MAX_VERSION: Final = 2**63 - 1
BYTES_TYPE: Final = "application/octet-stream"


def quick_answers(services: Services) -> Mapping[str, Answer]:
    """Return the answers to what is asked for most: the map."""

    async def map_answer(request: Headers) -> Response:
        snapshot = services.current_map.require()
        return await served(request, snapshot.map, media_type=JSON_TYPE, headers=freshness(services, snapshot))

    return {MAP_PATH: map_answer}


def add_map_routes(router: APIRouter, services: Services) -> None:
    """Add the map and what it says."""
    answers = quick_answers(services)

    @router.get(MAP_PATH, tags=["map"], responses=describe_answers(MapView, MAP_PROBLEMS, is_versioned=True))
    async def get_map(request: Request) -> Response:
        """Return the newest finished map: points, Rips complex, holes, intervals, landmarks, and the operator's frame."""
        return await answers[MAP_PATH](request.headers)

    @router.get("/api/v1/map/status", tags=["map"], responses=describe_answers(MapStatusView))
    async def get_map_status() -> Response:
        """Say what the newest finished map is of, how old it is, and how many records it waits to take in; small, to be asked often."""
        return json_response(view_map_status(services.current_map.status))

    @router.get("/api/v1/diagram", tags=["map"], responses=describe_answers(DiagramView, MAP_PROBLEMS, is_versioned=True))
    async def get_diagram(request: Request) -> Response:
        """Return the persistence diagram of the newest finished map."""
        snapshot = services.current_map.require()
        return await served(request.headers, snapshot.diagram, media_type=JSON_TYPE, headers=freshness(services, snapshot))

    @router.get("/api/v1/barcode", tags=["map"], responses=describe_answers(BarcodeView, MAP_PROBLEMS, is_versioned=True))
    async def get_barcode(request: Request) -> Response:
        """Return the same intervals as a barcode, those that count first."""
        snapshot = services.current_map.require()
        return await served(request.headers, snapshot.barcode, media_type=JSON_TYPE, headers=freshness(services, snapshot))

    @router.get("/api/v1/map/lengths", tags=["map"], responses=describe_answers(BYTES_TYPE, _LENGTHS_PROBLEMS, is_versioned=True))
    async def get_lengths(
        request: Request,
        version: Annotated[
            int | None, Query(ge=0, le=_MAX_VERSION, description="Of the map that it must be of; none: of the newest")
        ] = None,
    ) -> Response:
        """Return the lengths between all points, from which the complex follows at any scale.

        Unsigned numbers of 16 bits, little-endian, in 65,535ths of the map's `diameter`: for each component the upper triangle of its
        matrix, row by row, without the diagonal, its points in the order of the map's.
        """
        snapshot = services.current_map.require()
        if version is not None and version != snapshot.version:
            raise OtherVersionError(asked=version, newest=snapshot.version)
        if snapshot.lengths is None:
            raise LengthsNotKeptError(version=snapshot.version)
        return await served(request.headers, snapshot.lengths, media_type=BYTES_TYPE, headers=freshness(services, snapshot))

    _add_number_routes(router, services)


def _add_number_routes(router: APIRouter, services: Services) -> None:
    @router.get("/api/v1/betti", tags=["map"], responses=describe_answers(BettiView, MAP_PROBLEMS, is_versioned=True))
    async def get_betti(request: Request) -> Response:
        """Say how many components and holes there are, and how sure that is."""
        snapshot = services.current_map.require()
        return await _extracted(request, services, snapshot, extract_betti(snapshot.map_json))

    @router.get("/api/v1/holes", tags=["map"], responses=describe_answers(HoleList, MAP_PROBLEMS, is_versioned=True))
    async def get_holes(request: Request) -> Response:
        """List the holes with outline, centre, size, errors and probability, and the loops that may be some."""
        snapshot = services.current_map.require()
        return await _extracted(request, services, snapshot, extract_holes(snapshot.map_json))

    @router.get("/api/v1/holes/{number}", tags=["map"], responses=describe_answers(HoleView, _HOLE_PROBLEMS, is_versioned=True))
    async def get_hole(
        request: Request,
        number: Annotated[int, Path(ge=1, le=_MOST_HOLES, description="Its number in the map's list, from 1", examples=[1])],
    ) -> Response:
        """Return one hole."""
        snapshot = services.current_map.require()
        return await _extracted(request, services, snapshot, extract_hole(snapshot.map_json, number))

    @router.get("/api/v1/coverage", tags=["map"], responses=describe_answers(CoverageView, MAP_PROBLEMS, is_versioned=True))
    async def get_coverage(request: Request) -> Response:
        """Say how fast encounters come, whose they are, whether they hang together, what is missing, and how long that takes.

        It is there before the first map, too. Where nothing arrives any more, no wait is told, but why.
        """
        current = services.current_map
        now_ns = time.time_ns()
        coverage = judge_promise(
            current.require_coverage(),
            now_ns=now_ns,
            has_newer=current.status.n_waiting > 0,
            is_connected=services.is_connected(),
            are_alive=[gateway.is_alive for gateway in services.fleet.gateways(now_ns=now_ns)],
        )
        return await served(request.headers, coverage, media_type=JSON_TYPE, headers={})


async def _extracted(request: Request, services: Services, snapshot: MapSnapshot, body: bytes) -> Response:
    part = ServedBytes(body, tag=snapshot.map.tag)
    return await served(request.headers, part, media_type=JSON_TYPE, headers=freshness(services, snapshot))


def freshness(services: Services, snapshot: MapSnapshot) -> dict[str, str]:
    """Make the headers that say how far this map is behind [s], and how many records it lacks; a newer one may have come meanwhile."""
    n_waiting, behind_s = services.current_map.lag_of(snapshot)
    return {"Map-Behind": f"{behind_s:.3f}", "Map-Waiting": str(n_waiting)}
