"""The endpoints of places on the newest finished map: routes and distances between them, and pins, the operator's names for them."""

from http import HTTPStatus
from typing import Annotated, Final

import msgspec
from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.openapi.models import Example

from mapper.api.data_schemas import DistanceView, PinBody, PinItem, PinList, PinName
from mapper.api.descriptions import BODY_PROBLEMS, describe_answers
from mapper.api.map_routes import freshness
from mapper.api.quick_answers import served
from mapper.api.schemas import RoutesView
from mapper.api.services import Services
from mapper.api.views import JSON_TYPE, json_response
from mapper.map_extracts import settle_place
from mapper.named_pins import NamedPin, PinOnMap
from mapper.places import MapPlace, PointPlace, parse_place
from mapper.routes import MAX_CLASSES
from mapper.served_bytes import ServedBytes

_PROBLEMS: Final = (
    HTTPStatus.NOT_FOUND,
    HTTPStatus.UNPROCESSABLE_ENTITY,
    HTTPStatus.TOO_MANY_REQUESTS,
    HTTPStatus.SERVICE_UNAVAILABLE,
    HTTPStatus.INTERNAL_SERVER_ERROR,
)
_PLACE_FORMS: Final = (
    "landmark:ID, landmark:ID@T, biobot:ID (at its newest encounter), biobot:ID@T, point:INDEX, or xy:X,Y[,COMPONENT]; "
    "T in seconds since 1970"
)
_EXAMPLES: Final = {
    "landmark": Example(summary="Where landmark 7 stands", value="landmark:7"),
    "biobot": Example(summary="Where biobot 3 met somebody last", value="biobot:3"),
    "map": Example(summary="Coordinates of the map", value="xy:1.5,-2"),
}
Begin = Annotated[str, Query(alias="from", max_length=100, description=_PLACE_FORMS, openapi_examples=_EXAMPLES)]
End = Annotated[str, Query(alias="to", max_length=100, description=_PLACE_FORMS, openapi_examples=_EXAMPLES)]
Name = Annotated[PinName, Path(description="What the operator calls the place", examples=["door"])]


def add_place_routes(router: APIRouter, services: Services) -> None:
    """Add routes, distances and pins."""

    @router.get("/api/v1/route", tags=["places"], responses=describe_answers(RoutesView, _PROBLEMS))
    async def get_route(
        begin: Begin,
        end: End,
        classes: Annotated[int, Query(ge=1, le=MAX_CLASSES, description="Routes that pass obstacles on different sides, at most")] = 3,
    ) -> Response:
        """Find routes around obstacles between two places of the newest finished map: the shortest of each kind, the shortest first."""
        first, last = str(parse_place(begin)), str(parse_place(end))
        snapshot, found = await services.current_map.artist.routes(first, last, classes=classes)
        return Response(found, media_type=JSON_TYPE, headers={"Cache-Control": "no-store", **freshness(services, snapshot)})

    @router.get("/api/v1/distance", tags=["places"], responses=describe_answers(DistanceView, _PROBLEMS))
    async def get_distance(begin: Begin, end: End) -> Response:
        """Say how far it is from one place to another, around obstacles where biobots walked, and how wrong that may be."""
        snapshot, found = await services.current_map.artist.distance(str(parse_place(begin)), str(parse_place(end)))
        return Response(found, media_type=JSON_TYPE, headers={"Cache-Control": "no-store", **freshness(services, snapshot)})

    _add_pins(router, services)


def _add_pins(router: APIRouter, services: Services) -> None:
    @router.get("/api/v1/pins", tags=["places"], responses=describe_answers(PinList, is_versioned=True, has_freshness=False))
    async def get_pins(request: Request) -> Response:
        """List the operator's pins, where they are on the newest map, and the frame that three and more with coordinates fix."""
        body = ServedBytes.of(msgspec.json.encode(view_pins(services)))
        return await served(request.headers, body, media_type=JSON_TYPE, headers={})

    @router.put(
        "/api/v1/pins/{name}",
        tags=["places"],
        responses=describe_answers(
            PinItem,
            (*BODY_PROBLEMS, HTTPStatus.CONFLICT, HTTPStatus.SERVICE_UNAVAILABLE),
            made="The pin is a new one",
        ),
    )
    async def put_pin(name: Name, body: PinBody) -> Response:
        """Name a place, or say where a named one is; three with coordinates, not on one line, put the map into the operator's frame.

        A point or coordinates of the map are kept as where a biobot was when, because another map has other points.
        """
        place = parse_place(body.place)
        if isinstance(place, PointPlace | MapPlace):
            place = settle_place(services.current_map.require().map_json, place)
        pin = NamedPin(name=name, place=str(place), x=body.x, y=body.y)
        is_new = await services.pins.put(pin)
        await services.current_map.frame_again()
        # It may be another by now, or gone: what was put is told.
        return json_response(_view(pin, pin_places(services).get(pin, PinOnMap())), status=HTTPStatus.CREATED if is_new else HTTPStatus.OK)

    @router.delete(
        "/api/v1/pins/{name}",
        tags=["places"],
        status_code=HTTPStatus.NO_CONTENT,
        responses=describe_answers(
            None, (HTTPStatus.FORBIDDEN, HTTPStatus.NOT_FOUND, HTTPStatus.UNPROCESSABLE_ENTITY, HTTPStatus.SERVICE_UNAVAILABLE)
        ),
    )
    async def delete_pin(name: Name) -> Response:
        """Forget a pin."""
        await services.pins.drop(name)
        await services.current_map.frame_again()
        return Response(status_code=HTTPStatus.NO_CONTENT)


def view_pins(services: Services) -> dict[str, object]:
    """Describe all pins."""
    latest = services.current_map.latest
    framing = None if latest is None else latest.finished.documents.framing
    return {
        "pins": _view_all(services),
        "map_version": latest and latest.version,
        "frame": msgspec.Raw(b"null" if framing is None else framing.frame_json),
        "problems": [] if framing is None else list(framing.problems),
    }


def _view_all(services: Services) -> list[dict[str, object]]:
    places = pin_places(services)
    return [_view(pin, places.get(pin, PinOnMap())) for pin in services.pins.pins]


def pin_places(services: Services) -> dict[NamedPin, PinOnMap]:
    """Say where pins are on the newest map; one that came since is not there."""
    latest = services.current_map.latest
    framing = None if latest is None else latest.finished.documents.framing
    return {} if framing is None else dict(zip(framing.pins, framing.places, strict=True))


def _view(pin: NamedPin, place: PinOnMap) -> dict[str, object]:
    return {
        "name": pin.name,
        "place": pin.place,
        "x": pin.x,
        "y": pin.y,
        "map_x": place.x,
        "map_y": place.y,
        "component": place.component,
        "gap_s": place.gap_s,
        "residual_m": place.residual_m,
        "problem": place.problem,
    }
