"""The simulator with faults against the real gateway: whatever fails, every encounter is in the journal once."""

import asyncio
import json
from pathlib import Path

import pytest

from firmware_protocol.contract.records import JournalRecord
from simulator.dongles.choice import DEFAULT_DIALECT, DIALECTS
from studies.ledger import check_ledger
from tests.e2e.simulation import as_rows, current, end_of, ready, simulating
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config, listening, running

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120)]

# About one frame in thirty is damaged.
BYTES = ("bit-flip=1e-4", "drop=1e-4", "insert=3e-4", "truncate=5e-5")
LINE = ("stall=0.7,stall-s=0.4", "unplug=0.7,unplug-s=0.3")
DONGLE = ("reset=0.5,reset-s=0.2", "full=0.7,full-s=0.4", "wrong-status=0.3")
BYTE_KINDS, LINE_KINDS, DONGLE_KINDS = {"bit_flip", "drop", "insert", "truncate"}, {"stall", "unplug"}, {"reset", "full", "wrong_status"}

# Those that take seconds to open are given time for it.
EACH = ("stall=0.3,stall-s=0.3", "unplug=0.2,unplug-s=0.3", "reset=0.2,reset-s=0.2", "full=0.3,full-s=0.3", "wrong-status=0.2")
# CAN opens at once and is soon done, so more has to happen in the time.
QUICK = ("stall=0.3,stall-s=0.3", "unplug=0.2,unplug-s=0.3", "reset=0.5,reset-s=0.2", "full=0.7,full-s=0.3", "wrong-status=0.3")

CASES = [
    ("native", BYTES, BYTE_KINDS),
    ("native", LINE, LINE_KINDS),
    ("native", DONGLE, DONGLE_KINDS),
    ("can", (*BYTES, *QUICK), LINE_KINDS | DONGLE_KINDS),
    *((dialect, (*BYTES, *EACH), LINE_KINDS | DONGLE_KINDS) for dialect in DIALECTS if dialect not in {DEFAULT_DIALECT, "can", "canfd"}),
]


@pytest.mark.parametrize(("dialect", "faults", "kinds"), CASES)
def test_nothing_is_lost_and_nothing_is_there_twice(dialect: str, faults: tuple[str, ...], kinds: set[str], tmp_path: Path) -> None:
    out, ready_file = tmp_path / "out", tmp_path / "ready"

    async def story() -> list[JournalRecord]:
        with simulating(
            "serve", "--scenario", "no-obstacle", "--seed", "77", "--biobots", "30", "--speed", "40", "--duration", "3",
            "--link", f"pty:{tmp_path / 'dongle'}?dialect={dialect}", *(flag for fault in faults for flag in ("--fault", fault)),
            "--drain-s", "60", "--report-period-s", "0.2", "--out", str(out), "--ready-file", str(ready_file),
        ) as process:  # fmt: skip
            (address,) = await ready(process, ready_file)
            config = a_config(tmp_path, address)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    told = await end_of(process)
                    await until(lambda: check_ledger(out, as_rows(current(peer.records))).is_complete, what="every report is a record")
                    assert told.count('"fault.begins"') >= told.count('"fault.ended"')
                return peer.records

    records = asyncio.run(story())
    run = json.loads((out / "run.json").read_text())
    ledger = check_ledger(out, as_rows(current(records)))
    assert ledger.is_complete, ledger
    assert ledger.n_encounters > 30
    assert run["reports_unacknowledged"] == run["encounters_dropped_by_backpacks"] == 0
    (injected,) = run["injected_faults"]
    assert kinds <= {name.rpartition(".")[2] for name, count in injected.items() if count}, injected
