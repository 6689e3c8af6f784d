"""The mapper's way into its store, alone, and a watch on it: ``python -m studies.store_watch ENDPOINT STORE``.

Bus, store and intake are the mapper's own; map and web server are left out, for they are no part of what is measured. A thread notes how
far the store has come: change ``k`` was there, at the latest, at the first moment at which ``k`` changes were. It speaks in JSON lines.
"""

import argparse
import asyncio
import json
import resource
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mapper.bus import Bus
from mapper.changes import Changes
from mapper.command_log import CommandLog
from mapper.fleet import Fleet
from mapper.intake import Intake
from mapper.stimulation_accounts import StimulationAccounts
from mapper.store_thread import StoreThread


class ProgressWatch:
    """Notes the moments at which a store was seen to have come further; a thread of its own."""

    def __init__(self, records: StoreThread, *, pause_s: float) -> None:
        self._records = records
        self._pause_s = pause_s
        self._ending = threading.Event()
        self.seen: list[tuple[int, int]] = []
        """Instant on the monotonic clock, changes by then."""
        self.cpu_s = 0.0
        """Processor time of the watch itself, which is no part of the mapper [s]."""
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        before = -1
        while not self._ending.wait(self._pause_s):
            change = self._records.progress.change
            if change != before:
                self.seen.append((time.monotonic_ns(), change))
                before = change
            self.cpu_s = time.thread_time()


def main(arguments: Sequence[str] | None = None) -> int:
    """Fill the store until told to stop."""
    parser = argparse.ArgumentParser(prog="python -m studies.store_watch", description=__doc__)
    parser.add_argument("endpoint", help="of the gateway")
    parser.add_argument("store", type=Path, help="the store's file")
    parser.add_argument("--pause-ms", type=float, default=20.0, help="between two looks at the store (default: %(default)g)")
    options = parser.parse_args(arguments)
    asyncio.run(_serve(options))
    return 0


async def _serve(options: argparse.Namespace) -> None:
    records = await StoreThread.open(options.store)
    bus = await Bus.open(site="local", connect=(options.endpoint,), listen=())
    fleet = Fleet()
    changes = Changes()
    commands, accounts = CommandLog(changes=changes), StimulationAccounts()
    intake = Intake(bus=bus, records=records, fleet=fleet, changes=changes, commands=commands, accounts=accounts)
    watch = ProgressWatch(records, pause_s=options.pause_ms / 1000)
    running = asyncio.ensure_future(intake.run())
    _say({"ready": True})
    while question := (await asyncio.to_thread(sys.stdin.readline)).strip():
        if question == "facts":
            usage = resource.getrusage(resource.RUSAGE_SELF)
            change = records.progress.change
            reached_ns = next((t_ns for t_ns, at in reversed(watch.seen) if at >= change), time.monotonic_ns())
            views = fleet.gateways(now_ns=time.monotonic_ns())
            _say(
                {
                    "change": change,
                    "encounters": records.progress.n_encounters,
                    "watch_cpu_s": watch.cpu_s,
                    "cpu_s": usage.ru_utime + usage.ru_stime,
                    "reached_ns": reached_ns,
                    "counters": {**intake.counters, **bus.counters},
                    "gateways": {view.name: view.status.counters for view in views if view.status is not None},
                }
            )
        elif question == "save":
            np.save(options.store.with_suffix(".seen.npy"), np.array(watch.seen, dtype=np.int64))
            _say({"saved": True})
    watch.stop()
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    await bus.aclose()
    await records.aclose()


def _say(facts: dict[str, object]) -> None:
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
