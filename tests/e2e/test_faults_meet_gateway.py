"""The simulator with faults against the real gateway: whatever fails, every encounter is in the journal once."""

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from firmware_protocol.contract.records import JournalRecord
from simulator.dongles.choice import DEFAULT_DIALECT, DIALECTS
from studies.ledger import check_ledger
from tests.e2e.simulation import as_rows, current, end_of, ready, simulating
from tests.gateway.fake_radio import until
from tests.gateway.harness import a_config, listening, running

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(240), pytest.mark.xdist_group("faults meet gateway")]

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """A run of the simulator with faults: what it left behind, and all that was heard of the gateway in front of it."""

    out: Path
    told: str
    records: list[JournalRecord]


async def live_through(dialect: str, faults: tuple[str, ...], place: Path) -> Life:
    out, ready_file = place / "out", place / "ready"
    with simulating(
        "serve", "--scenario", "no-obstacle", "--seed", "77", "--biobots", "30", "--speed", "40", "--duration", "3",
        "--link", f"pty:{place / 'dongle'}?dialect={dialect}", *(flag for fault in faults for flag in ("--fault", fault)),
        "--drain-s", "120", "--report-period-s", "0.2", "--out", str(out), "--ready-file", str(ready_file),
    ) as process:  # fmt: skip
        (address,) = await ready(process, ready_file)
        config = a_config(place, address)
        with listening(config) as peer:
            async with running(config):
                await peer.hear()
                told = await end_of(process)
                await until(lambda: check_ledger(out, as_rows(current(peer.records))).is_complete, what="every report is a record")
            return Life(out=out, told=told, records=peer.records)


@pytest.fixture(scope="module")
def lives(tmp_path_factory: pytest.TempPathFactory) -> list[Life | BaseException]:
    """All cases at the same time, for each of them mostly waits; of one that fails, why."""
    places = [tmp_path_factory.mktemp("life") for _ in CASES]

    async def live_all() -> list[Life | BaseException]:
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(32))  # a thread waits for each simulator
        stories = (live_through(dialect, faults, place) for place, (dialect, faults, _) in zip(places, CASES, strict=True))
        return await asyncio.gather(*stories, return_exceptions=True)

    return asyncio.run(live_all())


@pytest.mark.parametrize("number", range(len(CASES)), ids=[f"{dialect}-{len(faults)}-faults" for dialect, faults, _ in CASES])
def test_nothing_is_lost_and_nothing_is_there_twice(number: int, lives: list[Life | BaseException]) -> None:
    life, kinds = lives[number], CASES[number][2]
    if isinstance(life, BaseException):
        raise life
    run = json.loads((life.out / "run.json").read_text())
    ledger = check_ledger(life.out, as_rows(current(life.records)))
    assert life.told.count('"fault.begins"') >= life.told.count('"fault.ended"')
    assert ledger.is_complete, ledger
    assert ledger.n_encounters > 30
    assert run["reports_unacknowledged"] == run["encounters_dropped_by_backpacks"] == 0
    (injected,) = run["injected_faults"]
    assert kinds <= {name.rpartition(".")[2] for name, count in injected.items() if count}, injected
