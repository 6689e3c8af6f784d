"""The endpoints of what is beside the map: the sites on the bus, and gateways' recordings of their lines."""

from fastapi import APIRouter, Response
from pydantic import Field

from mapper.api.descriptions import describe_answers
from mapper.api.schemas import AnswerModel
from mapper.api.services import Services
from mapper.api.views import json_response


class SiteItem(AnswerModel):
    """A site whose gateways are seen on the bus."""

    name: str
    gateways: list[str] = Field(description="Those that are there now")
    is_mapped: bool = Field(description="This mapper maps it; each maps one")


class SiteList(AnswerModel):
    """Sites by name; on a secured bus a mapper sees its own alone."""

    sites: list[SiteItem]


class RecordingItem(AnswerModel):
    """A file of what passed on a line between a gateway and a dongle; begin and end on the gateway's clock."""

    gateway: str
    name: str = Field(description="Of the file, in the gateway's directory of recordings")
    radio: str
    begin_wall_ns: int
    end_wall_ns: int | None = Field(description="Of its last record; null: there is none yet")
    n_bytes: int


class RecordingsView(AnswerModel):
    """All recordings, by gateway and time; `recording` names the gateways that record now."""

    recordings: list[RecordingItem]
    recording: list[str]
    n_left_out: int = Field(description="Older ones that gateways did not list")


def add_site_routes(router: APIRouter, services: Services) -> None:
    """Add sites and recordings."""

    @router.get("/api/v1/sites", tags=["watch"], responses=describe_answers(SiteList))
    async def get_sites() -> Response:
        """List the sites whose gateways are seen on the bus, and the one that is mapped."""
        seen = {services.bus.site: list[str](), **services.bus.sites()}
        sites = [{"name": name, "gateways": gateways, "is_mapped": name == services.bus.site} for name, gateways in sorted(seen.items())]
        return json_response({"sites": sites})

    @router.get("/api/v1/recordings", tags=["records"], responses=describe_answers(RecordingsView))
    async def get_recordings() -> Response:
        """Ask all gateways which recordings of their lines they have; those that do not answer within seconds are left out."""
        lists = await services.bus.list_recordings()
        recordings = [
            {name: getattr(entry, name) for name in entry.__struct_fields__} | {"gateway": one.gateway}
            for one in lists
            for entry in one.recordings
        ]
        return json_response(
            {
                "recordings": recordings,
                "recording": [one.gateway for one in lists if one.is_recording],
                "n_left_out": sum(one.n_left_out for one in lists),
            }
        )
