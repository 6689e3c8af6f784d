"""The endpoints of pictures of the newest finished map, and of its GeoJSON. They are drawn at the first request for a map."""

from http import HTTPStatus
from typing import Final

from fastapi import APIRouter, Request, Response

from mapper.api.descriptions import describe_answers
from mapper.api.map_routes import freshness
from mapper.api.quick_answers import served
from mapper.api.services import Services
from mapper.artist_jobs import PictureKind
from mapper.render import ImageFormat

SVG_TYPE: Final = "image/svg+xml"
PNG_TYPE: Final = "image/png"
GEOJSON_TYPE: Final = "application/geo+json"
_TYPES: Final[dict[ImageFormat, str]] = {"svg": SVG_TYPE, "png": PNG_TYPE}
_PROBLEMS: Final = (HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.INTERNAL_SERVER_ERROR)


def add_picture_routes(router: APIRouter, services: Services) -> None:
    """Add map, diagram and barcode as SVG and PNG, and GeoJSON."""
    svg = describe_answers(SVG_TYPE, _PROBLEMS, is_versioned=True)
    png = describe_answers(PNG_TYPE, _PROBLEMS, is_versioned=True)

    async def draw(request: Request, kind: PictureKind, image_format: ImageFormat) -> Response:
        snapshot, picture = await services.current_map.artist.picture(kind, image_format)
        return await served(
            request.headers,
            picture,
            media_type=_TYPES[image_format],
            headers=freshness(services, snapshot),
            can_pack=image_format == "svg",
        )

    @router.get("/api/v1/map.svg", tags=["pictures"], responses=svg)
    async def get_map_svg(request: Request) -> Response:
        """Draw the newest finished map as SVG, in the operator's frame where pins fix one."""
        return await draw(request, "map", "svg")

    @router.get("/api/v1/map.png", tags=["pictures"], responses=png)
    async def get_map_png(request: Request) -> Response:
        """Draw the newest finished map as PNG, in the operator's frame where pins fix one."""
        return await draw(request, "map", "png")

    @router.get("/api/v1/diagram.svg", tags=["pictures"], responses=svg)
    async def get_diagram_svg(request: Request) -> Response:
        """Draw the persistence diagram as SVG, with the line above which loops count or are sure."""
        return await draw(request, "diagram", "svg")

    @router.get("/api/v1/diagram.png", tags=["pictures"], responses=png)
    async def get_diagram_png(request: Request) -> Response:
        """Draw the persistence diagram as PNG, with the line above which loops count or are sure."""
        return await draw(request, "diagram", "png")

    @router.get("/api/v1/barcode.svg", tags=["pictures"], responses=svg)
    async def get_barcode_svg(request: Request) -> Response:
        """Draw the barcode as SVG, with a line between what counts and the rest."""
        return await draw(request, "barcode", "svg")

    @router.get("/api/v1/barcode.png", tags=["pictures"], responses=png)
    async def get_barcode_png(request: Request) -> Response:
        """Draw the barcode as PNG, with a line between what counts and the rest."""
        return await draw(request, "barcode", "png")

    @router.get("/api/v1/map.geojson", tags=["pictures"], responses=describe_answers(GEOJSON_TYPE, _PROBLEMS, is_versioned=True))
    async def get_map_geojson(request: Request) -> Response:
        """Return the newest map as GeoJSON: points, holes, landmarks, pins, hulls. Not WGS 84: `coordinate_frame` says what it is."""
        snapshot, document = await services.current_map.artist.geojson()
        return await served(request.headers, document, media_type=GEOJSON_TYPE, headers=freshness(services, snapshot))
