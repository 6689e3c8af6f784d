"""The endpoints of files: all encounters as CSV or Parquet, written as they are sent."""

from http import HTTPStatus
from typing import Annotated, Final

from fastapi import APIRouter, Query, Response
from starlette.responses import StreamingResponse

from mapper.api.descriptions import describe_answers
from mapper.api.services import Services
from mapper.encounter_export import Period
from mapper.request_errors import PeriodError

CSV_TYPE: Final = "text/csv"
PARQUET_TYPE: Final = "application/vnd.apache.parquet"
CSV_PATH: Final = "/api/v1/encounters.csv"
PARQUET_PATH: Final = "/api/v1/encounters.parquet"
_MAX_S: Final = 4e9
_NS_PER_S: Final = 1e9
_PROBLEMS: Final = (HTTPStatus.UNPROCESSABLE_ENTITY, HTTPStatus.TOO_MANY_REQUESTS)

From = Annotated[
    float | None,
    Query(alias="from", ge=0, le=_MAX_S, allow_inf_nan=False, description="Encounters over by then are left out [s since 1970]"),
]
Until = Annotated[
    float | None, Query(ge=0, le=_MAX_S, allow_inf_nan=False, description="So are those that had not begun by then [s since 1970]")
]


def add_export_routes(router: APIRouter, services: Services) -> None:
    """Add encounters as files."""

    @router.get(CSV_PATH, tags=["records"], responses=describe_answers(CSV_TYPE, _PROBLEMS))
    async def get_encounters_csv(begin: From = None, until: Until = None) -> Response:
        """Write the encounters that count, each once, as CSV: t_start_s, t_end_s, id1, id2; `biobot-mapper run` reads it."""
        pieces = services.exports.csv(_period(begin, until))
        return StreamingResponse(pieces, media_type=CSV_TYPE, headers=_file("encounters.csv"))

    @router.get(PARQUET_PATH, tags=["records"], responses=describe_answers(PARQUET_TYPE, (*_PROBLEMS, HTTPStatus.NOT_IMPLEMENTED)))
    async def get_encounters_parquet(begin: From = None, until: Until = None) -> Response:
        """Write the same as Parquet, with instants as timestamps [ns, UTC] and unsigned ids. 501: pyarrow is not installed here."""
        pieces = services.exports.parquet(_period(begin, until))
        return StreamingResponse(pieces, media_type=PARQUET_TYPE, headers=_file("encounters.parquet"))


def _period(begin: float | None, until: float | None) -> Period:
    if begin is not None and until is not None and until <= begin:
        raise PeriodError(begin=begin, until=until)
    return Period(
        since_ns=None if begin is None else round(begin * _NS_PER_S), until_ns=None if until is None else round(until * _NS_PER_S)
    )


def _file(name: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}
