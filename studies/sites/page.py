"""What is asked of a mapper over https: its gateways, its biobots, its encounters, and orders to biobots."""

import json
import ssl
import urllib.error
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

_PAGE: Final = 1000
_TIMEOUT_S: Final = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A mapper's REST, as an operator."""

    url: str
    token: str
    ca: Path

    def get(self, path: str) -> Any:
        """Return the JSON behind a path."""
        return self._ask(path, None)[1]

    def post(self, path: str, body: Mapping[str, object]) -> tuple[int, Any]:
        """Return status and JSON of the answer, whatever the status is."""
        return self._ask(path, body)

    def encounters(self) -> list[dict[str, Any]]:
        """Return all records of encounters."""
        records: list[dict[str, Any]] = []
        after: int | None = 0
        while after is not None:
            page = self.get(f"/api/v1/encounters?after={after}&limit={_PAGE}")
            records += page["encounters"]
            after = page["next"]
        return records

    def gateways_alive(self) -> list[str]:
        """Name the gateways that are on the bus, as the mapper sees it."""
        return [one["name"] for one in self.get("/api/v1/gateways")["gateways"] if one["is_alive"]]

    def _ask(self, path: str, body: Mapping[str, object] | None) -> tuple[int, Any]:
        headers = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.url + path, data=data, headers=headers, method="GET" if body is None else "POST")
        try:
            with urllib.request.urlopen(request, timeout=_TIMEOUT_S, context=ssl.create_default_context(cafile=self.ca)) as answer:
                return answer.status, json.loads(answer.read())
        except urllib.error.HTTPError as error:
            if body is None:
                raise
            return error.code, json.loads(error.read())
