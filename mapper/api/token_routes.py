"""The endpoints of access: who one is here, and (for admins) who has tokens."""

from http import HTTPStatus
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Path, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from mapper.access import MAX_NAME, TOKENS_PATH, Role, TokenRecord, person_of
from mapper.api.descriptions import BODY_PROBLEMS, describe_answers
from mapper.api.schemas import AnswerModel
from mapper.api.services import Services
from mapper.api.views import json_response
from mapper.log import EventLog

_log = EventLog(__name__)

_FILE_PROBLEMS: Final = (HTTPStatus.SERVICE_UNAVAILABLE,)
RoleName = Literal["viewer", "operator", "admin"]


class MeView(AnswerModel):
    """Who asks."""

    name: str
    role: RoleName
    is_anonymous: bool = Field(description="No token was shown: whoever is on this machine may look")


class TokenBody(BaseModel):
    """Who gets a token."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, json_schema_extra={"examples": [{"name": "anna", "role": "operator"}]}
    )

    name: str = Field(min_length=1, max_length=MAX_NAME, description="Of the person, as audit logs will have it")
    role: RoleName


class TokenView(AnswerModel):
    """What is kept of a token."""

    id: str
    name: str
    role: RoleName
    created_wall_ns: int
    last_used_wall_ns: int | None = Field(description="To the hour; null: never")
    revoked_wall_ns: int | None = Field(description="null: it is valid")
    is_own: bool = Field(description="It is the one that this request shows")


class TokenList(AnswerModel):
    """All tokens, those that were revoked too; the oldest first."""

    tokens: list[TokenView]


class NewTokenView(TokenView):
    """A token that was made."""

    token: str = Field(description="For its holder; it is told this once")


def add_access_routes(router: APIRouter, services: Services) -> None:
    """Add who one is, and tokens."""
    register = services.access.register

    @router.get("/api/v1/me", tags=["access"], responses=describe_answers(MeView))
    async def get_me(request: Request) -> Response:
        """Say who asks, and what they may do: viewer looks, operator commands, admin makes tokens."""
        person = person_of(request)
        return json_response({"name": person.name, "role": person.role, "is_anonymous": person.is_anonymous})

    @router.get(TOKENS_PATH, tags=["access"], responses=describe_answers(TokenList))
    async def get_tokens(request: Request) -> Response:
        """List all tokens; of their secrets nothing is kept that could be told."""
        own = person_of(request).token_id
        return json_response({"tokens": [_view(record, own=own) for record in register.records]})

    @router.post(
        TOKENS_PATH,
        tags=["access"],
        status_code=HTTPStatus.CREATED,
        responses=_only_made(describe_answers(NewTokenView, (*BODY_PROBLEMS, HTTPStatus.TOO_MANY_REQUESTS, *_FILE_PROBLEMS), made="Made")),
    )
    async def post_token(request: Request, body: TokenBody) -> Response:
        """Make a token."""
        made = await register.add(name=body.name, role=Role(body.role))
        by = person_of(request)
        _log.info("access.token_made", id=made.record.id, name=made.record.name, role=made.record.role, by=by.name)
        answer = {**_view(made.record, own=by.token_id), "token": made.text}
        return json_response(answer, status=HTTPStatus.CREATED, headers={"Location": f"{TOKENS_PATH}/{made.record.id}"})

    @router.delete(
        f"{TOKENS_PATH}/{{token_id}}",
        tags=["access"],
        responses=describe_answers(
            TokenView, (HTTPStatus.NOT_FOUND, HTTPStatus.CONFLICT, HTTPStatus.UNPROCESSABLE_ENTITY, *_FILE_PROBLEMS)
        ),
    )
    async def delete_token(request: Request, token_id: Annotated[str, Path(pattern=r"^[0-9a-f]{8}$", description="Its id")]) -> Response:
        """Revoke a token, at once and for ever; it stays in the list. The last one of an admin cannot be."""
        record = await register.revoke(token_id)
        by = person_of(request)
        _log.info("access.token_revoked", id=record.id, name=record.name, by=by.name)
        return json_response(_view(record, own=by.token_id))


def _only_made(answers: dict[int | str, dict[str, Any]]) -> dict[int | str, dict[str, Any]]:
    return {status: answer for status, answer in answers.items() if status != HTTPStatus.OK}


def _view(record: TokenRecord, *, own: str | None) -> dict[str, object]:
    return {
        "id": record.id,
        "name": record.name,
        "role": record.role,
        "created_wall_ns": record.created_wall_ns,
        "last_used_wall_ns": record.last_used_wall_ns,
        "revoked_wall_ns": record.revoked_wall_ns,
        "is_own": record.id == own,
    }
