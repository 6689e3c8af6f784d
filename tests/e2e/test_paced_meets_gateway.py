"""The simulator's process against the real gateway: replayed recordings, two radios, a backpack that dies; nothing is lost or made up."""

import asyncio
import csv
import json
from pathlib import Path

import pytest

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.contract.records import EncounterRecord, JournalRecord, ModeRecord
from studies.ledger import check_ledger
from tests.e2e.simulation import RECORDED, as_rows, current, end_of, ready, simulating
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config, a_request, command, listening, running

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(200)]

# As recorded with toy robots in a dish: short meetings, beacons with numbers that do not fit the wire, an instant of no length.


def test_a_replayed_recording_arrives_at_the_gateway_as_exactly_its_encounters_and_a_stop_changes_nothing(tmp_path: Path) -> None:
    """At speed 5 a clock error of 10 ms is 50 ms of the recording; what is said of each error holds."""
    speed, source, out, ready_file = 5.0, tmp_path / "dish.csv", tmp_path / "out", tmp_path / "ready"
    source.write_text(RECORDED)

    async def story() -> list[JournalRecord]:
        with simulating(
            "replay", str(source), "--link", f"pty:{tmp_path / 'dongle'}", "--speed", str(speed), "--renumber", "--report-period-s", "0.2",
            "--drain-s", "100", "--out", str(out), "--ready-file", str(ready_file),
        ) as process:  # fmt: skip
            (address,) = await ready(process, ready_file)
            config = a_config(tmp_path, address)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    await until(lambda: len({one.node for one in peer.node_statuses}) == 7, what="all biobots are known")
                    stages = await command(peer, a_request(4, StimulationAction.STOP))
                    assert [one.stage for one in stages][-1] is Stage.BIOBOT_CONFIRMED
                    told = await end_of(process)
                    assert "replay.fixed_past" in told
                    assert "replay.command_without_effect" in told
                    await until(lambda: len(current(peer.records)) >= 11, what="all encounters published")
                return peer.records

    records = asyncio.run(story())
    run = json.loads((out / "run.json").read_text())
    assert (run["speed_factor"], run["recorded_zero_s"]) == (speed, 100.28)
    recorded_id = {int(one): was for one, was in run["recorded_ids"].items()}
    expected = sorted(
        (*sorted((int(row["id1"]), int(row["id2"]))), float(row["t_start_s"]), float(row["t_end_s"]))
        for row in csv.DictReader(RECORDED.splitlines())
    )
    got = sorted(
        (
            recorded_id[one.node_a],
            recorded_id[one.node_b],
            run["recorded_zero_s"] + (one.t_start_ns + one.wall_anchor_ns - run["t0_wall_ns"]) / 1e9 * speed,
            run["recorded_zero_s"] + (one.t_end_ns + one.wall_anchor_ns - run["t0_wall_ns"]) / 1e9 * speed,
            one.error_ns / 1e9 * speed,
        )
        for one in current(records)
    )
    assert [one[:2] for one in got] == [one[:2] for one in expected]
    for (_, _, start_s, end_s, error_s), (_, _, expected_start_s, expected_end_s) in zip(got, expected, strict=True):
        assert error_s < 10.0, "less than any gap between two meetings of a pair; a busy machine may widen it"
        assert abs(start_s - expected_start_s) < error_s + 0.02
        assert abs(end_s - expected_end_s) < error_s + 0.02
    assert all(one.is_reciprocal for one in current(records))
    assert {one.mode.value for one in records if isinstance(one, ModeRecord)} == {"CRW"}


def test_one_gateway_with_two_radios_has_every_encounter_of_insects_that_walk_from_one_to_the_other(tmp_path: Path) -> None:
    out, ready_file = tmp_path / "out", tmp_path / "ready"

    async def story() -> list[JournalRecord]:
        with simulating(
            "serve", "--scenario", "no-obstacle", "--seed", "5", "--biobots", "40", "--speed", "20", "--duration", "8", "--loss", "0.05",
            "--link", f"pty:{tmp_path / 'a'}", "--link", "tcp:127.0.0.1:0", "--coverage-radius", "29", "--drain-s", "100",
            "--report-period-s", "0.2", "--out", str(out), "--ready-file", str(ready_file),
        ) as process:  # fmt: skip
            addresses = await ready(process, ready_file)
            assert [one.split(":")[0] for one in addresses] == ["serial", "tcp"]
            config = a_config(tmp_path, *addresses)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    await end_of(process)
                    await until(lambda: check_ledger(out, as_rows(current(peer.records))).is_complete, what="every report is a record")
                    assert len({one.radio for one in peer.node_statuses}) == 2
                return peer.records

    records = asyncio.run(story())
    run = json.loads((out / "run.json").read_text())
    ledger = check_ledger(out, as_rows(current(records)))
    assert ledger.n_encounters > 100
    assert ledger.is_complete
    assert run["rejoined"] > 10
    assert run["reports_unacknowledged"] == run["encounters_dropped_by_backpacks"] == 0
    assert run["coordinator_places"] == [[12.5, 25.0], [37.5, 25.0]]


def test_two_gateways_with_a_radio_each_have_every_encounter_between_them(tmp_path: Path) -> None:
    out, ready_file = tmp_path / "out", tmp_path / "ready"

    async def story() -> list[EncounterRecord]:
        with simulating(
            "serve", "--scenario", "no-obstacle", "--seed", "6", "--biobots", "30", "--speed", "20", "--duration", "5",
            "--link", f"pty:{tmp_path / 'a'}", "--link", f"pty:{tmp_path / 'b'}", "--drain-s", "100", "--report-period-s", "0.2",
            "--out", str(out), "--ready-file", str(ready_file),
        ) as process:  # fmt: skip
            addresses = await ready(process, ready_file)
            homes = [tmp_path / "first", tmp_path / "second"]
            for home in homes:
                home.mkdir()
            first, second = (a_config(home, address) for home, address in zip(homes, addresses, strict=True))
            with listening(first) as one, listening(second) as other:
                async with running(first), running(second):
                    await end_of(process)
                    await until(lambda: _covers(out, current(one.records) + current(other.records)), what="every report is a record")
                assert current(one.records)
                assert current(other.records)
                return current(one.records) + current(other.records)

    records = asyncio.run(story())
    run = json.loads((out / "run.json").read_text())
    assert _covers(out, records)
    assert run["rejoined"] > 3
    assert run["reports_unacknowledged"] == 0


def _covers(out: Path, records: list[EncounterRecord]) -> bool:
    return (out / "run.json").exists() and not check_ledger(out, as_rows(records)).missing


def test_a_turn_and_a_start_from_the_gateway_are_confirmed_and_said_in_the_truth(tmp_path: Path) -> None:
    out, ready_file = tmp_path / "out", tmp_path / "ready"

    async def story() -> None:
        with simulating(
            "serve", "--scenario", "no-obstacle", "--seed", "5", "--biobots", "6", "--link", f"pty:{tmp_path / 'a'}",
            "--out", str(out), "--ready-file", str(ready_file),
        ) as process:  # fmt: skip
            (address,) = await ready(process, ready_file)
            config = a_config(tmp_path, address)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    await until(lambda: len({one.node for one in peer.node_statuses}) == 6, what="all biobots are known")
                    actions = (StimulationAction.TURN_LEFT, StimulationAction.TURN_RIGHT, StimulationAction.START)
                    for node, action in enumerate(actions, start=1):
                        stages = await command(peer, a_request(node, action))
                        assert [one.stage for one in stages][-1] is Stage.BIOBOT_CONFIRMED, stages
                    process.terminate()
                    await end_of(process)

    asyncio.run(story())
    noted = {one["action"]: one for one in json.loads((out / "run.json").read_text())["commands"]}
    assert set(noted) >= {"turn_left", "turn_right", "start"}
    for one in noted.values():
        if one["action"] is not None:
            assert one["responded"] in {True, False}
            assert bool(one["turn_deg"] or one["run"]) == one["responded"]
