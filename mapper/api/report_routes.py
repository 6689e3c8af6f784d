"""The endpoint of the mission report."""

import asyncio
import time
from datetime import UTC, datetime
from http import HTTPStatus
from importlib import resources
from importlib.metadata import version
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from mapper.api.descriptions import describe_answers
from mapper.api.place_routes import pin_places
from mapper.api.services import Services
from mapper.command_log import KEPT
from mapper.mission_report import ReportFacts, write_report
from mapper.named_pins import PinOnMap
from mapper.store import Store

HTML_TYPE = "text/html"
_PROBLEMS = (HTTPStatus.UNPROCESSABLE_ENTITY, HTTPStatus.SERVICE_UNAVAILABLE)


def add_report_routes(router: APIRouter, services: Services) -> None:
    """Add the mission report."""

    @router.get("/api/v1/report.html", tags=["past"], responses=describe_answers(HTML_TYPE, _PROBLEMS))
    async def get_report(
        request: Request,
        download: Annotated[bool, Query(description="As a file that needs nothing else: its style sheet is in it")] = False,  # noqa: FBT002
    ) -> Response:
        """Write the mission report: one printable page of what the map says, how sure it is, what happened, and who did what."""
        facts = await _gather(services)
        headers = {"Cache-Control": "no-store"}
        if download:
            style = (resources.files("mapper") / "web" / "report.css").read_text(encoding="utf-8")
            page = await asyncio.to_thread(write_report, facts, style=style)
            stamp = datetime.fromtimestamp(facts.now_wall_ns / 1e9, UTC).strftime("%Y%m%dT%H%M%SZ")
            headers["Content-Disposition"] = f'attachment; filename="report-{facts.site}-{stamp}.html"'
        else:
            # In full: a page that was fetched with a token is shown from a blob, which has no address of its own.
            page = await asyncio.to_thread(write_report, facts, style_url=f"{request.base_url}static/report.css")
        return Response(page, media_type=HTML_TYPE, headers=headers)


async def _gather(services: Services) -> ReportFacts:
    latest, now_ns = services.current_map.latest, time.monotonic_ns()
    missions = await services.records.call(Store.missions)
    history = services.history.page()[0]
    places = pin_places(services)
    return ReportFacts(
        site=services.bus.site,
        now_wall_ns=time.time_ns(),
        software=f"biobot-gateway {version('biobot-gateway')}",
        kernels=str(services.engines.kernels),
        persistence=services.engines.persistence,
        made_by=next((facts.made_by for facts in reversed(history) if latest is not None and facts.version == latest.version), None),
        map_json=None if latest is None else latest.map_json,
        waiting=services.current_map.status.waiting,
        history=history,
        alerts=services.alerts.alerts,
        gateways=services.fleet.gateways(now_ns=now_ns),
        biobots=services.fleet.biobots(now_ns=now_ns),
        accounts=services.accounts.all(),
        commands=services.commands.log.recent(limit=KEPT),
        missions=missions,
        faults=services.faults(),
        pins=[(pin, places.get(pin, PinOnMap())) for pin in services.pins.pins],
    )
