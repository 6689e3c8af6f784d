"""The whole system as real processes: simulator, pty or TCP, gateway, Zenoh, mapper, HTTP."""

import csv
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from studies.ledger import Ledger, check_ledger
from studies.system import RunningSystem, SystemSettings

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(280)]


def all_encounters(system: RunningSystem) -> list[dict[str, Any]]:
    records: list[dict[str, Any]] = []
    after: int | None = 0
    while after is not None:
        page = system.get(f"/api/v1/encounters?after={after}&limit=1000")
        records += page["encounters"]
        after = page["next"]
    return records


def phases_of(system: RunningSystem) -> list[str]:
    return [phase["phase"] for phase in system.get("/api/v1/mission")["phases"]]


def is_reachable(system: RunningSystem, biobot: int) -> bool:
    return any(one["id"] == biobot and one["is_reachable"] for one in system.get("/api/v1/biobots")["biobots"])


def n_known(system: RunningSystem) -> int:
    return int(system.get("/healthz")["n_encounters"])


def wait_for_end(system: RunningSystem, *, at_once: bool = False) -> None:
    """Wait until the insects have stopped, of themselves or at once, and all that their backpacks reported is acknowledged."""
    simulator = system.process("simulator")
    if at_once:
        simulator.terminate()
    deadline = time.monotonic() + 180
    while simulator.poll() is None:
        system.check_alive()
        assert time.monotonic() < deadline, "the simulator did not end"
        time.sleep(0.2)
    system.check_alive()


def settled_ledger(system: RunningSystem) -> Ledger:
    """Return the ledger once it is complete, or as it is after two minutes."""
    deadline = time.monotonic() + 120
    while True:
        ledger = check_ledger(system.truth_directory, all_encounters(system))
        if ledger.is_complete or time.monotonic() > deadline:
            return ledger
        time.sleep(0.5)


def modes(system: RunningSystem) -> Iterator[dict[str, str]]:
    with (system.truth_directory / "modes.csv").open(newline="") as lines:
        yield from csv.DictReader(lines)


def test_a_mission_over_a_pty_gives_a_map_with_every_encounter_once_and_a_stop_that_halts_the_insect(tmp_path: Path) -> None:
    settings = SystemSettings(out=tmp_path, scenario="one-obstacle", seed=11, speed=16, dispersion_s=2, exploration_s=200, drain_s=120)
    with RunningSystem(settings=settings) as system:
        mission = system.wait_for(
            lambda: (found := system.get("/api/v1/mission")).get("phase") and found["phase"]["phase"] == "exploration" and found,
            what="exploration",
            timeout_s=120,
        )
        n_before = n_known(system)
        landmarks = set(mission["phase"]["landmarks"])
        walker = next(one for one in range(1, 151) if one not in landmarks)
        system.wait_for(lambda: is_reachable(system, walker), what="that a command finds the walker", timeout_s=120)

        answer = system.post("/api/v1/commands", {"biobot": walker, "action": "stop"})

        assert answer["outcome"] == "biobot_confirmed"
        assert [stage["stage"] for stage in answer["stages"]] == ["accepted", "radio_confirmed", "biobot_confirmed"]
        assert answer["stages"][-1]["mode"] == "S"
        system.wait_for(lambda: n_known(system) > n_before + 1500, what="many encounters while they explore", timeout_s=120)
        wait_for_end(system, at_once=True)
        ledger = settled_ledger(system)
        assert ledger.is_complete, ledger
        assert ledger.n_encounters > 1500
        document = system.wait_for(
            lambda: (found := system.get("/api/v1/map"))["n_encounters"] + found["n_before"] == ledger.n_records and found,
            what="last map",
            timeout_s=120,
        )
        assert document["betti_numbers"][0] == 1
        standing = {int(row["id"]) for row in modes(system) if row["mode"] == "S" and row["cause"] == "command"}
        assert standing == landmarks | {walker}
        assert len(landmarks) == settings.n_landmarks
        run = json.loads((system.truth_directory / "run.json").read_text())
        assert (run["speed_factor"], run["seed"], run["betti_numbers"]) == (16, 11, [1, 1])


def test_nothing_is_lost_or_doubled_when_gateway_and_mapper_are_killed_and_the_radio_loses_a_tenth(tmp_path: Path) -> None:
    settings = SystemSettings(
        out=tmp_path, seed=12, speed=8, n_biobots=60, n_landmarks=8, dispersion_s=3, exploration_s=200, drain_s=120, link="tcp",
        simulator_args=("--loss", "0.1"),
    )  # fmt: skip
    with RunningSystem(settings=settings) as system:
        system.wait_for(lambda: len(all_encounters(system)) > 60, what="first encounters", timeout_s=120)

        system.process("gateway").kill()
        system.process("gateway").wait()
        time.sleep(1.0)  # let the backpacks report into the void for a while
        system.start_process("gateway", system.gateway_arguments())
        before = len(all_encounters(system))
        system.wait_for(lambda: len(all_encounters(system)) > before + 20, what="encounters after the gateway's death", timeout_s=120)
        system.process("mapper").kill()
        system.process("mapper").wait()
        system.start_mapper()
        system.wait_for(lambda: len(all_encounters(system)) > before + 60, what="encounters after the mapper's death", timeout_s=120)
        system.wait_for(lambda: "exploration" in phases_of(system), what="exploration", timeout_s=120)

        wait_for_end(system, at_once=True)
        ledger = settled_ledger(system)
        unacknowledged = [row for row in reported(system) if row["is_acknowledged"] != "1"]

        phases = phases_of(system)
        assert phases.count("dispersion") == phases.count("exploration") == 1, "the mission goes on where it was"
        assert not unacknowledged
        assert ledger.is_complete, ledger
        assert ledger.n_encounters > 100


def reported(system: RunningSystem) -> Iterator[dict[str, str]]:
    with (system.truth_directory / "reported.csv").open(newline="") as lines:
        yield from csv.DictReader(lines)
