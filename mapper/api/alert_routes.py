"""The endpoints of alerts: what is wrong or new, and who has seen it."""

import time
from http import HTTPStatus
from typing import Annotated, Final, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import Field

from mapper.access import person_of
from mapper.alert_book import MAX_ALERTS, Alert
from mapper.api.descriptions import describe_answers
from mapper.api.schemas import AnswerModel
from mapper.api.services import Services
from mapper.api.views import json_response

_MAX_ID: Final = 2**53


class AlertItem(AnswerModel):
    """An alert."""

    id: int
    kind: str = Field(description="What it is about: biobot_lost, battery_low, new_hole, ...; docs/past.md lists them")
    severity: Literal["info", "warning", "critical"] = Field(description="Act not at all, when there is time, or now")
    subject: str = Field(description="Of what: biobot 17")
    text: str = Field(description="What it means and what to do, for people")
    since_wall_ns: int
    ended_wall_ns: int | None = Field(description="null: it is on")
    is_on: bool
    acknowledged_by: str | None = Field(description="Who has seen it first; null: nobody")
    acknowledged_wall_ns: int | None


class AlertList(AnswerModel):
    """Alerts, the newest first."""

    now_wall_ns: int
    n_on: int
    alerts: list[AlertItem]


def add_alert_routes(router: APIRouter, services: Services) -> None:
    """Add alerts."""

    @router.get("/api/v1/alerts", tags=["watch"], responses=describe_answers(AlertList, (HTTPStatus.UNPROCESSABLE_ENTITY,)))
    async def get_alerts(
        state: Annotated[Literal["on", "all"], Query(description="on: those that hold now; all: those that are over, too")] = "all",
        limit: Annotated[int, Query(ge=1, le=MAX_ALERTS, description="Alerts, at most")] = 200,
    ) -> Response:
        """List alerts, the newest first; they outlive a restart."""
        alerts = services.alerts.alerts
        n_on = sum(alert.is_on for alert in alerts)
        chosen = [alert for alert in alerts if alert.is_on or state == "all"][:limit]
        return json_response({"now_wall_ns": time.time_ns(), "n_on": n_on, "alerts": [view_alert(alert) for alert in chosen]})

    @router.post(
        "/api/v1/alerts/{alert_id}/acknowledgement",
        tags=["watch"],
        responses=describe_answers(AlertItem, (HTTPStatus.FORBIDDEN, HTTPStatus.NOT_FOUND, HTTPStatus.UNPROCESSABLE_ENTITY)),
    )
    async def post_acknowledgement(
        request: Request, alert_id: Annotated[int, Path(ge=1, le=_MAX_ID, description="The id that the list has")]
    ) -> Response:
        """Say that you have seen an alert; who was first stays. It goes off when it does not hold any more, not by this."""
        return json_response(view_alert(await services.alerts.acknowledge(alert_id, person=person_of(request).name)))


def view_alert(alert: Alert) -> dict[str, object]:
    """Describe an alert."""
    return {name: getattr(alert, name) for name in alert.__struct_fields__} | {"is_on": alert.is_on}
