"""Orders of long computations: one is worked on at a time, few wait, and the results of the last ones are kept.

They have a process of their own, far behind the live map's in the queue for the processors, and it is ended with each job: what a job
costs the live map is its share of what the others leave.
"""

import asyncio
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import msgspec
import msgspec.structs
import numpy as np

from mapper.changes import Changes, Topic
from mapper.config import RecipeConfig, make_recipe
from mapper.errors import JobError, StoreError, TooManyError, WorkerDiedError
from mapper.log import EventLog
from mapper.map_job import TooFew
from mapper.period_job import PeriodMap, make_period_map
from mapper.pin_board import PinBoard
from mapper.record_columns import EncounterRows
from mapper.replica import StoreDelta
from mapper.request_errors import NoResultError, TaskNotFoundError
from mapper.served_bytes import ServedBytes
from mapper.store import Store
from mapper.store_thread import StoreThread
from mapper.types import Method
from mapper.worker import Worker

_log = EventLog(__name__)

MAX_WAITING: Final = 8
MAX_ENDED: Final = 16
MAX_RESULT_BYTES: Final = 64 * 2**20
"""Of all results together; the oldest go first."""
_NICENESS: Final = 15


class JobState(StrEnum):
    """How a job stands."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


_ENDED: Final = (JobState.DONE, JobState.FAILED, JobState.CANCELLED)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapOrder:
    """A map of the encounters not over at ``since_ns`` and begun before ``until_ns`` [wall clock], None: all; by the recipe given."""

    since_ns: int | None
    until_ns: int | None
    recipe: RecipeConfig


@dataclass(slots=True, kw_only=True)
class Job:
    """An order and how it stands. ``progress`` is from 0 to 1; ``problem``: why there is no result."""

    id: str
    order: MapOrder
    person: str
    ordered_wall_ns: int
    state: JobState = JobState.WAITING
    progress: float = 0.0
    stage: str | None = None
    problem: str | None = None
    begun_wall_ns: int | None = None
    ended_wall_ns: int | None = None
    result: ServedBytes | None = None
    ended_rank: int = 0
    """How many had ended before it."""
    is_done: asyncio.Event = field(default_factory=asyncio.Event)
    """It has ended, whatever became of it."""

    @property
    def has_ended(self) -> bool:
        """Say whether nothing more will become of it."""
        return self.state in _ENDED


class JobDesk:
    """Takes orders and has them worked on.

    Parameters
    ----------
    recipe
        What an order does not say is as for the live map.
    new_id
        Returns a name that was never given before.
    clock
        Tells the wall clock [ns since 1970].
    """

    def __init__(
        self,
        *,
        records: StoreThread,
        changes: Changes,
        pins: PinBoard,
        recipe: RecipeConfig,
        new_id: Callable[[], str],
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._records = records
        self._changes = changes
        self._pins = pins
        self._recipe = recipe
        self._new_id = new_id
        self._clock = clock
        self._jobs: dict[str, Job] = {}
        self._waiting: deque[Job] = deque()
        self._has_come = asyncio.Event()
        self._n_ended = 0
        self._running: tuple[Job, asyncio.Task[None]] | None = None
        self.worker = Worker(name="job worker", niceness=_NICENESS)

    def recipe_of(self, given: dict[str, object]) -> RecipeConfig:
        """Return the live map's recipe with what is given; another method begins with its own, but for the walking speed."""
        method = given.get("method")
        is_other = method is not None and Method(str(method)) is not self._recipe.method
        base = RecipeConfig(method=Method(str(method)), speed_mps=self._recipe.speed_mps) if is_other else self._recipe
        return msgspec.convert({**msgspec.to_builtins(base), **given}, RecipeConfig)

    def submit(self, order: MapOrder, *, person: str) -> Job:
        """Take an order.

        Raises
        ------
        TooManyError
            As many wait as may.
        """
        if len(self._waiting) >= MAX_WAITING:
            raise TooManyError(what="jobs waiting", limit=MAX_WAITING)
        job = Job(id=self._new_id(), order=order, person=person, ordered_wall_ns=self._clock())
        self._jobs[job.id] = job
        self._waiting.append(job)
        self._has_come.set()
        self._changes.bump(Topic.JOBS)
        _log.info("job.ordered", job=job.id, person=person)
        return job

    def get(self, job_id: str) -> Job:
        """Return a job.

        Raises
        ------
        TaskNotFoundError
            There is none of that id, or it ended long ago.
        """
        if job_id not in self._jobs:
            raise TaskNotFoundError(task=job_id, kept=MAX_ENDED)
        return self._jobs[job_id]

    def all(self) -> list[Job]:
        """List all jobs in the order in which they came."""
        return list(self._jobs.values())

    def result(self, job_id: str) -> ServedBytes:
        """Return what came of a job.

        Raises
        ------
        TaskNotFoundError
            As `get`.
        NoResultError
            It has not ended, or without a result.
        """
        job = self.get(job_id)
        if job.result is None:
            raise NoResultError(task=job_id, state=str(job.state), problem=job.problem)
        return job.result

    async def cancel(self, job_id: str) -> Job | None:
        """End a job that waits or runs, and return it; forget one that has ended; raises what `get` raises."""
        job = self.get(job_id)
        if job.has_ended:
            del self._jobs[job_id]
            self._changes.bump(Topic.JOBS)
            return None
        if self._running is not None and self._running[0] is job:
            self._running[1].cancel()
            await job.is_done.wait()
        else:
            self._waiting.remove(job)
            self._end(job, JobState.CANCELLED, problem="it was cancelled before it began")
        return job

    async def run(self) -> None:
        """Work on orders, one after the other, until cancelled."""
        try:
            async with asyncio.TaskGroup() as group:
                while True:
                    await self._has_come.wait()
                    if not self._waiting:
                        self._has_come.clear()
                        continue
                    job = self._waiting.popleft()
                    task = group.create_task(self._work(job), name=f"job {job.id}")
                    self._running = (job, task)
                    await asyncio.wait([task])
                    self._running = None
                    if not job.has_ended:  # it was cancelled before its first step
                        self._end(job, JobState.CANCELLED, problem="it was cancelled")
        finally:
            await self.worker.aclose()

    async def _work(self, job: Job) -> None:
        job.state, job.begun_wall_ns = JobState.RUNNING, self._clock()
        self._changes.bump(Topic.JOBS)
        begun = time.monotonic()
        try:
            outcome = await self._map(job)
        except asyncio.CancelledError:
            self._end(job, JobState.CANCELLED, problem="it was cancelled")
            raise
        except (WorkerDiedError, JobError, StoreError) as error:
            self._end(job, JobState.FAILED, problem=str(error))
        else:
            if isinstance(outcome, TooFew):
                counted = f"{outcome.n_encounters} encounters {outcome.where}, but a map needs at least {outcome.minimum}"
                self._end(job, JobState.FAILED, problem=f"{counted}; give another time")
            else:
                job.result = ServedBytes.of(_finish(job, outcome, computed_wall_ns=self._clock(), computing_s=time.monotonic() - begun))
                job.progress, job.stage = 1.0, "done"
                self._end(job, JobState.DONE, problem=None)
        finally:
            # The memory of a large map is given back.
            await self.worker.aclose()

    async def _map(self, job: Job) -> PeriodMap | TooFew:
        order = job.order
        delta = await self._records.call(Store.delta, after=0)
        chosen, n_before = await asyncio.to_thread(_choose, delta, since_ns=order.since_ns, until_ns=order.until_ns)

        def watch(stage: str, share: float) -> None:
            job.stage, job.progress = stage, max(job.progress, share)
            self._changes.bump(Topic.JOBS)

        return await self.worker.run_watched(
            make_period_map,
            watch,
            chosen,
            make_recipe(order.recipe),
            since_ns=order.since_ns,
            until_ns=order.until_ns,
            n_before=n_before,
            pins=self._pins.pins,
        )

    def _end(self, job: Job, state: JobState, *, problem: str | None) -> None:
        job.state, job.problem, job.ended_wall_ns, job.ended_rank = state, problem, self._clock(), self._n_ended
        self._n_ended += 1
        job.is_done.set()
        self._forget_old()
        self._changes.bump(Topic.JOBS)
        _log.info("job.ended", job=job.id, state=str(state), problem=problem)

    def _forget_old(self) -> None:
        """Forget those of the ended jobs that ended first, but never the last."""
        ended = sorted((job for job in self._jobs.values() if job.has_ended), key=lambda job: job.ended_rank)
        while len(ended) > MAX_ENDED or (len(ended) > 1 and _count_bytes(ended) > MAX_RESULT_BYTES):
            del self._jobs[ended.pop(0).id]


def _count_bytes(jobs: list[Job]) -> int:
    return sum(len(job.result.plain) for job in jobs if job.result is not None)


def _choose(delta: StoreDelta, *, since_ns: int | None, until_ns: int | None) -> tuple[StoreDelta, int]:
    """Leave out the encounters of other times: they need not be sent; and count those that were over before."""
    rows = delta.encounters
    chosen = rows.counts.copy()
    if until_ns is not None:
        chosen &= rows.t_start_ns < until_ns
    is_over = np.zeros(len(rows), dtype=np.bool_) if since_ns is None else rows.counts & (rows.t_end_ns <= since_ns)
    chosen &= ~is_over
    only = StoreDelta(
        base=delta.base,
        change=delta.change,
        encounters=EncounterRows(
            row=rows.row[chosen],
            t_start_ns=rows.t_start_ns[chosen],
            t_end_ns=rows.t_end_ns[chosen],
            id1=rows.id1[chosen],
            id2=rows.id2[chosen],
            counts=np.ones(int(np.count_nonzero(chosen)), dtype=np.bool_),
        ),
        modes=delta.modes,
        since_ns=delta.since_ns,
    )
    return only, int(np.count_nonzero(is_over))


def _finish(job: Job, made: PeriodMap, *, computed_wall_ns: int, computing_s: float) -> bytes:
    """Put what made it into the JSON of a map."""
    head = {
        "job": job.id,
        "begun_wall_ns": job.begun_wall_ns,
        "computed_wall_ns": computed_wall_ns,
        "computing_s": round(computing_s, 4),
        "frame": msgspec.Raw(made.frame_json),
    }
    return msgspec.json.encode(head)[:-1] + b"," + made.map_json[1:]
