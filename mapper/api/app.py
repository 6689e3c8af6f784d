"""The web application: endpoints, page, and what every request passes."""

from collections.abc import Collection
from http import HTTPStatus
from importlib import resources
from importlib.metadata import version
from typing import Final

from fastapi import FastAPI, Response
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

from mapper.api.descriptions import describe_problem
from mapper.api.door import Door
from mapper.api.errors import add_error_handlers
from mapper.api.event_stream import EventStream
from mapper.api.guards import Guard
from mapper.api.map_routes import quick_answers
from mapper.api.packing import Packing
from mapper.api.quick_answers import QuickAnswers
from mapper.api.refusals import CHECKED
from mapper.api.routes import make_router
from mapper.api.schemas import Problem
from mapper.api.security import describe_access
from mapper.api.services import Services

_ABOUT = """From encounters between walking biobots to a map of the space they walked.

Instants are nanoseconds on the wall clock; lengths have the map's `parameters.length_unit`. Errors are
`application/problem+json`. Maps have an `ETag`. Each person has a token, shown as `Authorization: Bearer biobot_...` and never in a
URL; `GET /api/v1/me` says whose it is. The service listens on loopback unless told otherwise.
"""

_TAGS: Final = [
    {"name": "map", "description": "The newest finished map and its numbers"},
    {"name": "pictures", "description": "The same as SVG, PNG and GeoJSON"},
    {"name": "places", "description": "Routes, distances, and the operator's pins"},
    {"name": "past", "description": "Maps of the past and how they differ, alerts, sites, recordings, the report"},
    {"name": "jobs", "description": "Maps of other times and methods, computed beside the live one"},
    {"name": "records", "description": "Encounters as the gateways recorded them"},
    {"name": "biobots", "description": "Biobots and gateways"},
    {"name": "commands", "description": "Commands and stops"},
    {"name": "mission", "description": "The mission and orders to it"},
    {"name": "access", "description": "Who one is here, and who has tokens"},
    {"name": "access", "description": "Who asks, and (for admins) who has tokens"},
    {"name": "watch", "description": "Changes, health, readiness"},
]


def create_app(services: Services, *, stream: EventStream, allowed_hosts: Collection[str] | None, is_tls: bool = False) -> Guard:
    """Make the application; ``allowed_hosts`` and ``is_tls`` as in `Guard`."""
    app = Packing(create_unguarded_app(services, stream=stream))
    door = Door(QuickAnswers(app, quick_answers(services)), access=services.access)
    return Guard(door, allowed_hosts=allowed_hosts, is_tls=is_tls)


def create_unguarded_app(services: Services, *, stream: EventStream) -> FastAPI:
    """Make the application without its outer layers, for its OpenAPI document."""
    # The usual documentation pages load scripts from elsewhere; operators have no internet.
    app = FastAPI(
        title="biobot mapper",
        version=version("biobot-gateway"),
        description=_ABOUT,
        docs_url=None,
        redoc_url=None,
        # What the document does not have is not there, nor is it by another spelling.
        redirect_slashes=False,
        openapi_tags=_TAGS,
        # Endpoints say themselves what they answer with; by default the document would say JSON besides.
        default_response_class=Response,
        servers=[{"url": "/", "description": "This mapper"}],
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        # A generated client calls its functions by these names: they stay.
        generate_unique_id_function=lambda route: route.name,
    )
    add_error_handlers(app)
    app.include_router(make_router(services, stream))
    web = resources.files("mapper") / "web"

    @app.get("/", include_in_schema=False)
    async def get_page() -> FileResponse:
        return FileResponse(str(web / "index.html"))

    app.mount("/static", StaticFiles(directory=str(web)), name="static")
    _complete_description(app, services)
    return app


def _complete_description(app: FastAPI, services: Services) -> None:
    """Put what no endpoint says by itself into the OpenAPI document: whom it is for, what is refused of every one, the schema of errors."""
    document = app.openapi()
    document.setdefault("components", {}).setdefault("schemas", {})[Problem.__name__] = Problem.model_json_schema()
    for path, operations in document["paths"].items():
        for operation in operations.values() if path.startswith(CHECKED) else ():
            operation["responses"].setdefault("422", describe_problem(HTTPStatus.UNPROCESSABLE_ENTITY))
    describe_access(document, allows_anonymous_reading=services.access.allows_anonymous_reading)
    app.openapi_schema = document
