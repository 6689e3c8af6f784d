"""A mapper that is killed while it moves a biobot: the gateway stops the biobot, and another mapper sees who did.

And the audit log names the persons whose tokens the commands were given with.
"""

import json
import subprocess
import sys
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx
import pytest

from studies.system import OPERATOR, RunningSystem, SystemSettings
from tests.mapper.serving import serving, shown

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(280)]

TURN = {"action": "turn_left", "hold_ms": 60_000}


def audited(journal: Path, *, operator: str) -> list[dict[str, Any]]:
    """What the gateway's audit log has of a person, as its command line shows it."""
    command = [sys.executable, "-m", "gateway", "audit", "show", str(journal), "--operator", operator, "--json"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    return [json.loads(line) for line in lines]


def test_whom_a_killed_mapper_moves_is_stopped_by_the_dead_man(tmp_path: Path) -> None:
    settings = SystemSettings(out=tmp_path, scenario="one-obstacle", speed=1, n_biobots=6, n_landmarks=3, dispersion_s=200, exploration_s=1)
    with RunningSystem(settings=settings) as system:
        port = int(system.bus_endpoint.rpartition(":")[2])
        directory = tmp_path / "mover"
        directory.mkdir()
        with serving(directory, connect=port, arguments=["--name", "mover"]) as (url, mover):

            def moved() -> int | None:
                for biobot in range(1, 7):
                    answer = httpx.post(url + "api/v1/commands", json={**TURN, "biobot": biobot}, headers=shown(directory), timeout=60)
                    if answer.status_code == HTTPStatus.OK and answer.json()["outcome"] == "biobot_confirmed":
                        return biobot
                return None

            biobot = system.wait_for(moved, what="a biobot is moved", timeout_s=100)
            assert "mover" in system.get("/api/v1/biobots")["commanders"]
            mover.kill()

            def stopped() -> bool:
                commands = system.get("/api/v1/commands")["commands"]
                stops = [one for one in commands if (one["biobot"], one["action"], one["operator"]) == (biobot, "stop", "dead-man")]
                return any((one["origin"], one["outcome"]) == ("elsewhere", "biobot_confirmed") for one in stops)

            assert system.wait_for(stopped, what="the dead-man's stop", timeout_s=100)
            assert "mover" not in system.get("/api/v1/biobots")["commanders"]
            standing = system.wait_for(
                lambda: next((one for one in system.get("/api/v1/biobots")["biobots"] if one["id"] == biobot and one["mode"] == "S"), None),
                what="the biobot's own word that it stands",
                timeout_s=100,
            )
            assert standing["cause"] == "command"
            system.post("/api/v1/stop", {"wait_s": 30})
            system.post("/api/v1/mission/orders", {"action": "finish"})
        journal = tmp_path / "gateway.sqlite"
        assert "turn_left" in {one.get("action") for one in audited(journal, operator="anna")}
        by_other = audited(journal, operator=OPERATOR)
        assert "stop_all" in {one.get("action") for one in by_other}
        assert "mission.order" in {one["kind"] for one in by_other}
