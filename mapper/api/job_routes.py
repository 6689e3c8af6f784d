"""The endpoints of jobs: long computations that are ordered, watched, and whose results are fetched later."""

from http import HTTPStatus
from typing import Annotated, Any, Final

import msgspec
from fastapi import APIRouter, Path, Request, Response
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from mapper.access import person_of
from mapper.api.descriptions import BODY_PROBLEMS, describe_answers
from mapper.api.quick_answers import served
from mapper.api.schemas import AnswerModel, MapBody
from mapper.api.services import Services
from mapper.api.views import JSON_TYPE, json_response
from mapper.jobs import Job, MapOrder

JOBS_PATH: Final = "/api/v1/jobs"
_MAX_WALL_NS: Final = 2**62 - 1
_MIN_POINTS: Final = 4
_MAX_POINTS: Final = 1000
_MAX_REPLICATES: Final = 10
_UNKNOWN: Final = (HTTPStatus.NOT_FOUND, HTTPStatus.UNPROCESSABLE_ENTITY)

Instant = Annotated[int, Field(ge=0, le=_MAX_WALL_NS)]


class JobBody(BaseModel):
    """What is to be computed: the map of a time. What is not given is as for the live map; another method has its own parameters."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={"examples": [{"kind": "map", "from_wall_ns": 1795726800_000000000, "until_wall_ns": 1795730400_000000000}]},
    )

    kind: Annotated[str, Field(pattern="^map$", json_schema_extra={"enum": ["map"]})]
    from_wall_ns: Instant | None = Field(default=None, strict=True, description="Encounters over by then are left out; null: none for that")
    until_wall_ns: Instant | None = Field(default=None, strict=True, description="So are those not begun by then; null: none for that")
    method: Annotated[str, Field(pattern="^(default|paper)$", json_schema_extra={"enum": ["default", "paper"]})] | None = None
    n_points: Annotated[int, Field(ge=_MIN_POINTS, le=_MAX_POINTS, strict=True)] | None = Field(default=None, description="Of the map")
    replicates: Annotated[int, Field(ge=0, le=_MAX_REPLICATES, strict=True)] | None = Field(
        default=None, description="Parts of the time mapped too, to say how sure the map is; 0 says nothing of that"
    )
    speed_mps: Annotated[FiniteFloat, Field(gt=0, le=1e6)] | None = Field(
        default=None, description="Walking speed [m/s]: lengths in metres"
    )

    @model_validator(mode="after")
    def _check_time(self) -> "JobBody":
        if self.from_wall_ns is not None and self.until_wall_ns is not None and self.until_wall_ns <= self.from_wall_ns:
            raise ValueError(f"until_wall_ns {self.until_wall_ns} is not after from_wall_ns {self.from_wall_ns}; give a time with a length")
        return self


class JobView(AnswerModel):
    """An order and how it stands."""

    id: str
    kind: str
    state: str = Field(json_schema_extra={"enum": ["waiting", "running", "done", "failed", "cancelled"]})
    progress: float = Field(ge=0, le=1)
    stage: str | None = Field(description="What is being done, in one word; null: it has not begun")
    problem: str | None = Field(description="Why there is no result; null: there is one, or may be")
    result_url: str | None = Field(description="Where the result is; null: there is none, or none yet")
    person: str = Field(description="Who ordered it")
    from_wall_ns: int | None
    until_wall_ns: int | None
    recipe: dict[str, object] = Field(description="What differs from the method's own parameters")
    ordered_wall_ns: int
    begun_wall_ns: int | None
    ended_wall_ns: int | None


class JobList(AnswerModel):
    """Jobs in the order in which they came: all that wait or run, and the last ones that ended."""

    jobs: list[JobView]


class JobMapView(MapBody):
    """The map that a job made."""

    job: str
    begun_wall_ns: int
    computed_wall_ns: int
    computing_s: float


JobId = Annotated[str, Path(max_length=64, description="The id that POST /api/v1/jobs told", examples=["3f2a9c4d1e07"])]


def add_job_routes(router: APIRouter, services: Services) -> None:
    """Add jobs."""

    @router.post(
        JOBS_PATH,
        tags=["jobs"],
        status_code=HTTPStatus.ACCEPTED,
        responses=describe_answers(
            None, (*BODY_PROBLEMS, HTTPStatus.TOO_MANY_REQUESTS), accepted=(JobView, "Taken: `Location` says where it is")
        ),
    )
    async def post_job(request: Request, body: JobBody) -> Response:
        """Order the map of a time, or by another method. One job runs at a time; eight may wait; the last sixteen are kept, in memory."""
        given = body.model_dump(include={"method", "n_points", "replicates", "speed_mps"}, exclude_none=True)
        order = MapOrder(since_ns=body.from_wall_ns, until_ns=body.until_wall_ns, recipe=services.jobs.recipe_of(given))
        job = services.jobs.submit(order, person=person_of(request).name)
        return json_response(view_job(job), status=HTTPStatus.ACCEPTED, headers={"Location": f"{JOBS_PATH}/{job.id}"})

    @router.get(JOBS_PATH, tags=["jobs"], responses=describe_answers(JobList))
    async def get_jobs() -> Response:
        """List jobs."""
        return json_response({"jobs": [view_job(job) for job in services.jobs.all()]})

    @router.get(JOBS_PATH + "/{job_id}", tags=["jobs"], responses=describe_answers(JobView, _UNKNOWN))
    async def get_job(job_id: JobId) -> Response:
        """Say how a job stands; the topic `jobs` of `/api/v1/events` tells when to ask again."""
        return json_response(view_job(services.jobs.get(job_id)))

    @router.delete(
        JOBS_PATH + "/{job_id}",
        tags=["jobs"],
        responses=describe_answers(JobView, (HTTPStatus.FORBIDDEN, *_UNKNOWN)) | {204: {"description": "It had ended, and is forgotten"}},
    )
    async def delete_job(job_id: JobId) -> Response:
        """Cancel a job that waits or runs; forget one that has ended, and its result."""
        job = await services.jobs.cancel(job_id)
        return Response(status_code=HTTPStatus.NO_CONTENT) if job is None else json_response(view_job(job))

    @router.get(
        JOBS_PATH + "/{job_id}/result",
        tags=["jobs"],
        responses=describe_answers(JobMapView, (*_UNKNOWN, HTTPStatus.CONFLICT), is_versioned=True, has_freshness=False),
    )
    async def get_job_result(request: Request, job_id: JobId) -> Response:
        """Return the map that a job made; 409 says why there is none, or none yet."""
        return await served(request.headers, services.jobs.result(job_id), media_type=JSON_TYPE, headers={})


def view_job(job: Job) -> dict[str, Any]:
    """Describe a job."""
    return {
        "id": job.id,
        "kind": "map",
        "state": job.state,
        "progress": job.progress,
        "stage": job.stage,
        "problem": job.problem,
        "result_url": None if job.result is None else f"{JOBS_PATH}/{job.id}/result",
        "person": job.person,
        "from_wall_ns": job.order.since_ns,
        "until_wall_ns": job.order.until_ns,
        "recipe": {name: value for name, value in msgspec.to_builtins(job.order.recipe).items() if value is not None},
        "ordered_wall_ns": job.ordered_wall_ns,
        "begun_wall_ns": job.begun_wall_ns,
        "ended_wall_ns": job.ended_wall_ns,
    }
