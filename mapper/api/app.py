"""The web application: endpoints, page, and what every request passes."""

from collections.abc import Collection
from importlib import resources
from importlib.metadata import version

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

from mapper.api.errors import add_error_handlers
from mapper.api.event_stream import EventStream
from mapper.api.guards import Guard
from mapper.api.routes import make_router
from mapper.api.schemas import Problem
from mapper.api.services import Services

_ABOUT = """From encounters between walking biobots to a map of the space they walked.

Instants are nanoseconds on the wall clock; lengths have the map's `parameters.length_unit`. Errors are
`application/problem+json`. Maps have an `ETag`. There are no users: the service listens on loopback unless told otherwise.
"""


def create_app(services: Services, *, stream: EventStream, allowed_hosts: Collection[str] | None) -> Guard:
    """Make the application; ``allowed_hosts`` as in `Guard`."""
    return Guard(create_unguarded_app(services, stream=stream), allowed_hosts=allowed_hosts)


def create_unguarded_app(services: Services, *, stream: EventStream) -> FastAPI:
    """Make the application without its outermost layer, for its OpenAPI document."""
    # The usual documentation pages load scripts from elsewhere; operators have no internet.
    app = FastAPI(title="biobot mapper", version=version("biobot-gateway"), description=_ABOUT, docs_url=None, redoc_url=None)
    add_error_handlers(app)
    app.include_router(make_router(services, stream))
    web = resources.files("mapper") / "web"

    @app.get("/", include_in_schema=False)
    async def get_page() -> FileResponse:
        return FileResponse(str(web / "index.html"))

    app.mount("/static", StaticFiles(directory=str(web)), name="static")
    _describe_problems(app)
    return app


def _describe_problems(app: FastAPI) -> None:
    """Put the schema of errors into the OpenAPI document: answers refer to it by name only."""
    document = app.openapi()
    document.setdefault("components", {}).setdefault("schemas", {})[Problem.__name__] = Problem.model_json_schema()
    app.openapi_schema = document
