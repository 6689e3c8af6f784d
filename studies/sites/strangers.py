"""Those who have no business on a bus try what they can, on a machine of their own: ``python -m studies.sites.strangers FILE``.

Each shows what it has, forges an encounter under a gateway's name, asks for its history, commands one of its biobots, answers for it and
listens to everything. What came of it is printed as one JSON line each. FILE is JSON: ``endpoint``, ``site``, ``gateway``, ``seconds``, and
``tables``, the TLS table of each by its name.
"""

import contextlib
import json
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_protocol.contract.commands import StimulationAction, StimulationRequest
from firmware_protocol.contract.keys import ANY, ROOT, Stream, build_key
from firmware_protocol.contract.records import EncounterRecord, HistoryRequest, RecordBatch, encode_record
from firmware_protocol.contract.sessions import TlsTable
from firmware_protocol.units import BootId, Nanoseconds, NodeId
from gateway.bus_session import open_client
from gateway.errors import BusError
from studies.errors import SitesError

FORGED_PAIR: Final = (60_001, 60_002)
"""Nobody has these numbers but the encounters that strangers forge."""

_FORGED_JOURNAL: Final = "forged"
_PAUSE_S: Final = 0.1


class StrangersPlan(msgspec.Struct, frozen=True, kw_only=True):
    """See the module."""

    endpoint: str
    site: str
    gateway: str
    seconds: float
    tables: dict[str, TlsTable]
    attempts: int = 1
    """How often each tries to connect."""


def try_all(plan: StrangersPlan, name: str, tls: TlsTable) -> dict[str, Any]:
    """Try everything with one table; say what came of it."""
    try:
        session, ears = (_open(plan, tls) for _ in range(2))
    except BusError as error:
        return {"name": name, "is_connected": False, "reason": str(error)}
    heard: set[str] = set()
    held: list[Any] = []
    asked: list[str] = []

    def answer(query: Any) -> None:
        with query:
            asked.append(str(query.key_expr))

    keys = {stream: build_key(site=plan.site, stream=stream, gateway=plan.gateway) for stream in Stream if stream is not Stream.WATERMARK}
    with session, ears:  # two, for a session hears itself
        wanted = [f"{ROOT}/**", f"{ROOT}/{plan.site}/**", *(build_key(site=plan.site, stream=one, gateway=ANY) for one in keys)]
        held += [ears.declare_subscriber(key, lambda sample: heard.add(str(sample.key_expr))) for key in wanted]
        held += [ears.declare_queryable(keys[stream], answer) for stream in (Stream.COMMAND, Stream.HISTORY)]
        held.append(ears.liveliness().declare_token(keys[Stream.ALIVE]))
        n_answers = 0
        deadline = time.monotonic() + plan.seconds
        while True:
            session.put(keys[Stream.ENCOUNTERS], encode_record(_forged(plan.gateway)))
            n_answers += len(list(session.get(keys[Stream.HISTORY], payload=encode_record(HistoryRequest(from_offset=1)), timeout=1.0)))
            n_answers += len(list(session.get(keys[Stream.COMMAND], payload=encode_record(_stop()), timeout=1.0)))
            if time.monotonic() >= deadline:
                break
            time.sleep(_PAUSE_S)
        for one in held:
            one.undeclare()
    return {"name": name, "is_connected": True, "heard": sorted(heard), "n_answers": n_answers, "asked": asked}


def _open(plan: StrangersPlan, tls: TlsTable) -> Any:
    """Return a session; on a busy machine the first attempts may take too long."""
    for _ in range(plan.attempts - 1):
        with contextlib.suppress(BusError):
            return open_client(connect=[plan.endpoint], tls=tls)
    return open_client(connect=[plan.endpoint], tls=tls)


def try_strangers(plan: StrangersPlan, *, prefix: Sequence[str], file: Path) -> list[dict[str, Any]]:
    """Let all strangers of a plan try, in a process behind ``prefix``; return what each was told.

    Raises
    ------
    SitesError
        One of them could not even try.
    """
    file.write_bytes(msgspec.json.encode(plan))
    command = [*prefix, sys.executable, "-m", "studies.sites.strangers", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    told = [json.loads(line) for line in done.stdout.splitlines()]
    if done.returncode or len(told) != len(plan.tables):
        raise SitesError(f"the strangers ended with status {done.returncode}: {done.stderr.strip()}")
    return told


def problems_with_stranger(told: dict[str, Any], *, may_hear: bool) -> list[str]:
    """Say what a stranger got, one line each."""
    if not told["is_connected"]:
        return []
    problems = []
    if told["n_answers"]:
        problems.append(f"stranger ({told['name']}) got {told['n_answers']} answers")
    if told["asked"]:
        problems.append(f"stranger ({told['name']}) was asked {told['asked']}")
    if told["heard"] and not may_hear:
        problems.append(f"stranger ({told['name']}) heard {told['heard']}")
    return problems


def _forged(gateway: str) -> RecordBatch:
    start_ns = time.time_ns()
    record = EncounterRecord(
        gateway=gateway,
        journal=_FORGED_JOURNAL,
        offset=1,
        boot=BootId(1),
        sequence=1,
        revision=0,
        wall_anchor_ns=Nanoseconds(0),
        node_a=NodeId(FORGED_PAIR[0]),
        node_b=NodeId(FORGED_PAIR[1]),
        t_start_ns=Nanoseconds(start_ns),
        t_end_ns=Nanoseconds(start_ns + 1),
        error_ns=Nanoseconds(0),
        is_reciprocal=True,
    )
    return RecordBatch(gateway=gateway, journal=_FORGED_JOURNAL, head_offset=1, records=(record,))


def _stop() -> StimulationRequest:
    return StimulationRequest(
        command_id=f"stranger-{time.monotonic_ns()}",
        node=NodeId(1),
        action=StimulationAction.TURN_RIGHT,
        operator="stranger",
        issued_wall_ns=Nanoseconds(time.time_ns()),
        ttl_ms=5_000,
        hold_ms=0,
        commander="",
        pulse=None,
    )


def main() -> int:
    """Try all, at once."""
    plan = msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=StrangersPlan)
    lock = threading.Lock()

    def run(name: str, tls: TlsTable) -> None:
        told = json.dumps(try_all(plan, name, tls))
        with lock:
            sys.stdout.write(told + "\n")
            sys.stdout.flush()

    threads = [threading.Thread(target=run, args=item, name=item[0]) for item in plan.tables.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return 0


if __name__ == "__main__":
    sys.exit(main())
