"""The unmodified gateway through a virtual Z-Stack dongle: it forms the network, loses nothing, and its commands are confirmed."""

import asyncio
import json
from pathlib import Path

import pytest

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.contract.records import JournalRecord
from studies.ledger import check_ledger
from tests.e2e.simulation import as_rows, current, end_of, ready, simulating
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config, a_request, command, listening, running

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(200)]


def test_a_gateway_behind_a_zstack_dongle_has_every_encounter_and_its_command_is_confirmed(tmp_path: Path) -> None:
    out, ready_file = tmp_path / "out", tmp_path / "ready"

    async def story() -> list[JournalRecord]:
        with simulating(
            "serve", "--scenario", "no-obstacle", "--seed", "5", "--biobots", "30", "--speed", "12", "--duration", "10", "--loss", "0.05",
            "--link", f"pty:{tmp_path / 'dongle'}?dialect=znp", "--drain-s", "100", "--report-period-s", "0.2",
            "--out", str(out), "--ready-file", str(ready_file),
        ) as process:  # fmt: skip
            (address,) = await ready(process, ready_file)
            config = a_config(tmp_path, address)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    await until(lambda: any(one.node == 4 for one in peer.node_statuses), what="the biobot is known")
                    stages = await command(peer, a_request(4, StimulationAction.STOP))
                    assert [one.stage for one in stages][-1] is Stage.BIOBOT_CONFIRMED, stages
                    await end_of(process)
                    await until(lambda: check_ledger(out, as_rows(current(peer.records))).is_complete, what="every report is a record")
                return peer.records

    records = asyncio.run(story())
    run = json.loads((out / "run.json").read_text())
    ledger = check_ledger(out, as_rows(current(records)))
    assert ledger.n_encounters > 30
    assert ledger.is_complete
    assert run["reports_unacknowledged"] == run["encounters_dropped_by_backpacks"] == 0
