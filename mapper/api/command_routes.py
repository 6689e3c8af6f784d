"""The endpoints that tell biobots and missions what to do, and those that say what became of it.

A command is answered when it has ended, or when the client does not want to wait longer: 200 with the gateway's stages and the outcome, 202
while it is under way, 409 when it was refused, 503 when there is no gateway to give it to.
"""

from collections.abc import Callable, Coroutine
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.routing import APIRoute

from firmware_protocol.contract.commands import PulseRequest, Refusal, StimulationAction, WaveformName
from firmware_protocol.units import EVERYBODY, NodeId
from mapper.access import person_of
from mapper.api.command_schemas import (
    COMMANDS_PATH,
    MAX_WAIT_S,
    STOP_PATH,
    AccountList,
    CommandBody,
    CommandId,
    CommandList,
    CommandView,
    MissionView,
    OrderBody,
    OrderView,
    PulseBody,
    StopBody,
    StopView,
)
from mapper.api.command_views import view_account, view_command, view_mission, view_order, view_stop
from mapper.api.descriptions import BODY_PROBLEMS, describe_answers
from mapper.api.refusals import check_parameters
from mapper.api.schemas import NodeText
from mapper.api.services import Services
from mapper.api.views import json_response
from mapper.command_log import Command, Outcome, has_ended
from mapper.commands import STOPS, Wish
from mapper.errors import BiobotNotFoundError, CommandRefusedError, GatewayAwayError, StopUnansweredError
from mapper.store import Store

_UNDER_WAY: Final = "Under way: wait_s was over before its end"
_REFUSED_EXAMPLE: Final = {
    "type": "about:blank",
    "title": "Conflict",
    "status": 409,
    "detail": "the command was refused: the train before ended 1.2 s ago, but 2 s must lie between; wait 0.8 s",
    "command_id": "left-1",
    "outcome": "refused",
    "reason": "the train before ended 1.2 s ago, but 2 s must lie between; wait 0.8 s",
    "refusal": "gap",
}
_UNANSWERED_EXAMPLE: Final = {
    "type": "about:blank",
    "title": "Service Unavailable",
    "status": 503,
    "detail": "no answer yet from gateway 'base2': biobots there may walk on; "
    "repeat the stop under the id 'one', and look at the gateways and the animals",
    "id": "one",
    "unanswered": ["base2"],
    "answers": [
        {
            "biobot": None,
            "command_id": "one",
            "gateway": "base1",
            "stage": "radio_confirmed",
            "outcome": None,
            "reason": "",
            "refusal": None,
        },
        {"biobot": None, "command_id": "one", "gateway": "base2", "stage": None, "outcome": None, "reason": "", "refusal": None},
    ],
}


class _AnyTypeRoute(APIRoute):
    """Reads a body as JSON whatever type it is said to be of: no stop is refused for a header that a tool sent by itself."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def handle_as_json(request: Request) -> Response:
            others = [(name, value) for name, value in request.scope["headers"] if name != b"content-type"]
            return await handle(Request({**request.scope, "headers": [*others, (b"content-type", b"application/json")]}, request.receive))

        return handle_as_json


def add_command_routes(router: APIRouter, services: Services) -> None:
    """Add stops, commands, and accounts of stimulation."""
    stops = APIRouter(route_class=_AnyTypeRoute)
    _add_stop(stops, services)
    router.include_router(stops)
    _add_commands(router, services)
    _add_accounts(router, services)


def _add_stop(router: APIRouter, services: Services) -> None:
    @router.post(
        STOP_PATH,
        tags=["commands"],
        responses=describe_answers(
            StopView,
            (*BODY_PROBLEMS, HTTPStatus.CONFLICT, HTTPStatus.SERVICE_UNAVAILABLE),
            under_way="Every gateway has it; it has not ended everywhere",
            examples={HTTPStatus.SERVICE_UNAVAILABLE: _UNANSWERED_EXAMPLE},
        ),
    )
    async def post_stop(request: Request, body: StopBody | None = None) -> Response:
        """Stop all biobots at every gateway of the site, or some, at once. Nothing need be sent along; repeat it as often as you like.

        It is on its way before the request is answered, whatever else waits or fails. 503 names gateways that told nothing of it, or says
        that there is none; it was sent to the others all the same, and for 10 s is sent again to those.
        """
        wanted = body or StopBody()
        biobots = None if wanted.biobots is None else tuple(dict.fromkeys(NodeId(int(biobot)) for biobot in wanted.biobots))
        stop = services.emergency_stop.stop(operator=person_of(request).name, biobots=biobots, stop_id=wanted.id)
        await services.emergency_stop.wait(stop, wait_s=wanted.wait_s)
        is_unheard = any(command.is_unheard for command in stop.commands)
        if is_unheard or (stop.silent and wanted.wait_s != 0):
            raise StopUnansweredError(stop_id=stop.stop_id, gateways=stop.silent, facts=view_stop(stop))
        return json_response(view_stop(stop), status=HTTPStatus.OK if stop.has_ended else HTTPStatus.ACCEPTED)


def _add_commands(router: APIRouter, services: Services) -> None:
    @router.post(
        COMMANDS_PATH,
        tags=["commands"],
        responses=describe_answers(
            CommandView,
            (
                *BODY_PROBLEMS,
                HTTPStatus.NOT_FOUND,
                HTTPStatus.CONFLICT,
                HTTPStatus.TOO_MANY_REQUESTS,
                HTTPStatus.SERVICE_UNAVAILABLE,
            ),
            under_way=_UNDER_WAY,
            examples={HTTPStatus.CONFLICT: _REFUSED_EXAMPLE},
        ),
    )
    async def post_command(request: Request, body: CommandBody) -> Response:
        """Give a command and wait for its end; the same ``id`` again gives it once and answers the same.

        Outcome ``biobot_confirmed``: done. ``failed``: it did not reach the biobot, or was not carried out. ``unknown``: nobody can tell.
        """
        person, action = person_of(request), StimulationAction(body.action)
        if action not in STOPS:
            check_parameters(request)
            services.access.limits.take_write(person)
        command = await services.commands.submit(
            Wish(
                node=EVERYBODY if body.biobot is None else NodeId(int(body.biobot)),
                action=action,
                operator=person.name,
                ttl_ms=body.ttl_ms,
                hold_ms=body.hold_ms,
                pulse=_pulse(body.pulse),
                command_id=body.id,
            )
        )
        await services.commands.log.wait(lambda: has_ended(command), of=[command], timeout_s=body.wait_s)
        _check_outcome(command)
        return json_response(view_command(command), status=HTTPStatus.OK if has_ended(command) else HTTPStatus.ACCEPTED)

    @router.get(COMMANDS_PATH, tags=["commands"], responses=describe_answers(CommandList, (HTTPStatus.UNPROCESSABLE_ENTITY,)))
    async def get_commands(
        limit: Annotated[int, Query(ge=1, le=1000, description="Commands, at most")] = 50,
        part_of: Annotated[CommandId | None, Query(description="The parts of this stop of all, in place of all else")] = None,
    ) -> Response:
        """List the newest commands of the site since the start: those given here, and those that gateways tell of."""
        commands = services.commands.log.recent(limit=limit, part_of=part_of)
        return json_response({"commands": [view_command(command) for command in commands]})

    @router.get(
        "/api/v1/commands/{command_id}",
        tags=["commands"],
        responses=describe_answers(CommandView, (HTTPStatus.NOT_FOUND, HTTPStatus.UNPROCESSABLE_ENTITY)),
    )
    async def get_command(
        command_id: Annotated[CommandId, Path(description="The id that the command was given under", examples=["left-1"])],
        wait_s: Annotated[float, Query(ge=0, le=MAX_WAIT_S, description="Wait so long for its end, or for a stage that is new")] = 0.0,
        seen: Annotated[int | None, Query(ge=0, description="Stages that the client has: one more is new; none: wait for the end")] = None,
    ) -> Response:
        """Return one command as it stands, or as soon as there is news of it."""
        command = services.commands.log.get(command_id)
        if wait_s:
            await services.commands.log.wait(
                lambda: has_ended(command) or (seen is not None and len(command.stages) > seen), of=[command], timeout_s=wait_s
            )
        return json_response(view_command(command))


def _add_accounts(router: APIRouter, services: Services) -> None:
    @router.get("/api/v1/stimulation", tags=["biobots"], responses=describe_answers(AccountList))
    async def get_accounts() -> Response:
        """List how all biobots were stimulated, as their gateways last told."""
        return json_response({"accounts": [view_account(account) for account in services.accounts.all()]})

    @router.get(
        "/api/v1/biobots/{biobot}/stimulation",
        tags=["biobots"],
        responses=describe_answers(AccountList, (HTTPStatus.NOT_FOUND, HTTPStatus.UNPROCESSABLE_ENTITY)),
    )
    async def get_accounts_of(biobot: Annotated[NodeText, Path(description="Id of the biobot", examples=["17"])]) -> Response:
        """Say how one biobot was stimulated, by gateway; no account: not since any gateway told of it."""
        node = NodeId(int(biobot))
        accounts = services.accounts.of(node)
        if not accounts and services.fleet.gateway_of(node) is None:
            raise BiobotNotFoundError(biobot=node)
        return json_response({"accounts": [view_account(account) for account in accounts]})


def add_mission_routes(router: APIRouter, services: Services) -> None:
    """Add what missions do, and orders to them."""

    @router.get("/api/v1/mission", tags=["mission"], responses=describe_answers(MissionView))
    async def get_mission() -> Response:
        """Return the phases of the mission, with what was chosen and why."""
        return json_response(view_mission(await services.records.call(Store.missions)))

    @router.post(
        "/api/v1/mission/orders",
        tags=["mission"],
        responses=describe_answers(OrderView, (*BODY_PROBLEMS, HTTPStatus.CONFLICT, HTTPStatus.SERVICE_UNAVAILABLE)),
    )
    async def post_order(request: Request, body: OrderBody) -> Response:
        """Order the mission of a gateway, or of each, to begin, pause, go on, choose landmarks, or end; the same ``id`` again is one."""
        order, answers = await services.mission.order(
            action=body.action, operator=person_of(request).name, gateway=body.gateway, ttl_ms=body.ttl_ms, order_id=body.id
        )
        return json_response(view_order(order, answers))


def _pulse(body: PulseBody | None) -> PulseRequest | None:
    if body is None:
        return None
    return PulseRequest(
        frequency_hz=body.frequency_hz,
        pulse_width_us=body.pulse_width_us,
        amplitude_mv=body.amplitude_mv,
        duration_ms=body.duration_ms,
        channel=body.channel,
        waveform=None if body.waveform is None else WaveformName(body.waveform),
    )


def _check_outcome(command: Command) -> None:
    """Raise where a command reached nobody, or was refused by all."""
    is_for_one = command.node != EVERYBODY
    is_unknown = command.gateway is None and (command.is_unheard or command.refusal is Refusal.UNKNOWN_BIOBOT)
    if is_for_one and is_unknown and has_ended(command):
        raise BiobotNotFoundError(biobot=command.node)
    if command.outcome is Outcome.REFUSED:
        raise CommandRefusedError(command_id=command.command_id, reason=command.reason, refusal=command.refusal)
    if command.outcome is Outcome.UNDELIVERED:
        away = [name for name, answer in command.answers.items() if answer.outcome is Outcome.UNDELIVERED]
        raise GatewayAwayError(command_id=command.command_id, gateway=command.gateway or ", ".join(away) or None)
