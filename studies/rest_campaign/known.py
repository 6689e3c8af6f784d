"""Values that mean something to the mapper under test: without them most requests would be about what is not there."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import requests

from mapper.access import Role
from studies.rest_campaign.askers import Target

_MOST: Final = 8
_TIMEOUT_S: Final = 60
_N_LANDMARKS: Final = 5
_NAMES: Final = ("door", "shaft", "stairs")


@dataclass(frozen=True, slots=True)
class Known:
    """Values that the mapper knows, by the name of a parameter or of a key in a body, or by ``operation.name``, which goes first."""

    values: Mapping[str, Sequence[object]] = field(default_factory=dict)
    etags: Sequence[str] = ()

    def replace(self, given: dict[str, Any], choose: Callable[[Sequence[object]], object], *, operation: str) -> None:
        """Put known values in the place of those that were made up."""
        for name in given:
            values = self.values.get(f"{operation}.{name}", self.values.get(name))
            if values:
                given[name] = choose(values)


def learn(target: Target, session: requests.Session) -> Known:
    """Ask the mapper what it knows now."""

    def ask(path: str) -> Any:
        answer = session.get(target.url + path, headers={"Authorization": f"Bearer {target.tokens[Role.ADMIN]}"}, timeout=_TIMEOUT_S)
        return answer.json() if answer.ok else {}

    answer = session.get(target.url + "/api/v1/map", timeout=_TIMEOUT_S)
    drawn = answer.json() if answer.ok else {}
    etags = [answer.headers["ETag"]] if "ETag" in answer.headers else []
    biobots = [one["id"] for one in ask("/api/v1/biobots").get("biobots", [])]
    maps = ask("/api/v1/maps?limit=10000").get("maps", [])
    versions = _newest(one["version"] for one in maps)
    moments = _newest(one["wall_ns"] for one in maps)
    seconds = [moment / 1e9 for moment in moments]
    places, own_tokens = _newest(_places(drawn)), list(target.tokens.values())
    values: dict[str, Sequence[object]] = {
        "place": places,
        "to": places,
        "biobot": [str(one) for one in _newest(biobots)],
        "biobots": [[one] for one in _newest(biobots)],
        "gateway": _newest(one["name"] for one in ask("/api/v1/gateways").get("gateways", []) if "name" in one),
        "version": versions,
        "since": versions,
        "number": list(range(1, 4)),
        "put_pin.name": _NAMES,
        "delete_pin.name": _NAMES,
        "job_id": _newest(one["id"] for one in ask("/api/v1/jobs").get("jobs", [])),
        "command_id": _newest(one["id"] for one in ask("/api/v1/commands").get("commands", []) if "id" in one),
        "alert_id": _newest(one["id"] for one in ask("/api/v1/alerts").get("alerts", [])),
        "from_wall_ns": [None, *moments],
        "until_wall_ns": [None, *moments],
        "token_id": _newest(
            one["id"] for one in ask("/api/v1/tokens").get("tokens", []) if not any(one["id"] in own for own in own_tokens)
        ),
        "from": places,
        "get_encounters_csv.from": seconds,
        "get_encounters_parquet.from": seconds,
        "until": seconds,
    }
    return Known(values=values, etags=etags)


def _places(drawn: Mapping[str, Any]) -> Iterator[str]:
    for landmark in drawn.get("landmarks", [])[:_N_LANDMARKS]:
        yield f"landmark:{landmark['id']}"
    yield "xy:0,0"
    yield "point:0"
    yield "point:7"


def _newest(values: Iterator[Any] | Sequence[Any]) -> list[Any]:
    return list(values)[-_MOST:]
