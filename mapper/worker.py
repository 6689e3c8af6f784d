"""One process for long computations, so that they never hold up the event loop. It is started anew when it dies."""

import asyncio
import contextlib
import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, Concatenate, ParamSpec, TypeVar

from mapper.errors import JobError, WorkerDiedError
from mapper.log import EventLog

_log = EventLog(__name__)

_P = ParamSpec("_P")
_T = TypeVar("_T")

Progress = Callable[[str, float], None]
"""Told the stage that begins and the share of the work done so far, in [0, 1]."""

# Behind requests and radio traffic in the queue for the processors.
_NICENESS = 5
_TELLING_S = 0.1
"""Progress is told no more often than this, but for another stage."""
_JOIN_S = 5.0


class Worker:
    """A process that runs one job at a time; it starts with the first job.

    Parameters
    ----------
    niceness
        How far it stands behind others in the queue for the processors, from 0 to 19.
    """

    def __init__(self, *, name: str, niceness: int = _NICENESS) -> None:
        self._name = name
        self._niceness = niceness
        self._lock = asyncio.Lock()
        self._process: SpawnProcess | None = None
        self._connection: Connection | None = None
        self.n_starts = 0

    @property
    def pid(self) -> int | None:
        """The process's number; None while there is none."""
        return self._process.pid if self._process is not None else None

    async def run(self, job: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs) -> _T:
        """Run a function of a module in the process and return what it returns; jobs wait for each other.

        Raises
        ------
        WorkerDiedError
            The process ended before its answer.
        JobError
            The function raised.
        """
        result: _T = await self._ask((job, args, kwargs, False), watch=lambda _stage, _share: None)
        return result

    async def run_watched(self, job: Callable[Concatenate[Progress, _P], _T], watch: Progress, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        """Run a function that tells how far it is, as `run` does; its first argument is what it tells it to.

        Parameters
        ----------
        watch
            Called on the event loop with what it tells.
        """
        result: _T = await self._ask((job, args, kwargs, True), watch=watch)
        return result

    async def _ask(self, request: "_Request", *, watch: Progress) -> Any:
        loop = asyncio.get_running_loop()

        def tell(told: _Told) -> None:
            loop.call_soon_threadsafe(watch, told.stage, told.share)

        async with self._lock:
            try:
                if self._connection is None:
                    await self._start_whole()
                answer = await asyncio.to_thread(self._exchange, request, tell)
            except (EOFError, OSError) as error:
                raise WorkerDiedError(exit_code=await asyncio.to_thread(self._stop)) from error
            except asyncio.CancelledError:
                # The answer would be taken for that of the next job.
                await self.aclose()
                raise
        if isinstance(answer, _Raised):
            _log.error("job.raised", worker=self._name, reason=answer.reason, traceback=answer.details)
            raise JobError(reason=answer.reason, details=answer.details)
        return answer

    async def aclose(self) -> None:
        """End the process, whatever it does."""
        if self._process is not None:
            self._process.kill()
        await asyncio.to_thread(self._stop)

    async def _start_whole(self) -> None:
        """Start the process; a cancellation waits until there is one, because half a process cannot be killed."""
        starting = asyncio.ensure_future(asyncio.to_thread(self._start))
        try:
            await asyncio.shield(starting)
        except asyncio.CancelledError:
            await asyncio.wait([starting])
            raise

    def _exchange(self, request: "_Request", tell: "Callable[[_Told], None]") -> Any:
        assert self._connection is not None
        self._connection.send(request)
        while isinstance(answer := self._connection.recv(), _Told):
            tell(answer)
        return answer

    def _start(self) -> None:
        # "spawn": a fork would copy Zenoh's threads' locks in whatever state they are.
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._niceness), name=self._name, daemon=True)
        process.start()
        theirs.close()
        self._process, self._connection = process, ours
        self.n_starts += 1

    def _stop(self) -> int | None:
        process, self._process = self._process, None
        connection, self._connection = self._connection, None
        exit_code = None
        if process is not None:
            process.join(_JOIN_S)
            exit_code = process.exitcode
            process.kill()
            process.join()
            process.close()
        # Only now: a thread may still be reading, until the process's end is closed.
        if connection is not None:
            connection.close()
        return exit_code


@dataclass(frozen=True, slots=True, kw_only=True)
class _Raised:
    """The answer of a job that raised."""

    reason: str
    details: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _Told:
    """How far a job is."""

    stage: str
    share: float


_Request = tuple[Callable[..., object], tuple[object, ...], Mapping[str, object], bool]
"""A function, its arguments, and whether it wants to tell how far it is."""


def _serve(connection: Connection, niceness: int) -> None:
    # Ctrl-C, and a service manager's SIGTERM, reach the whole process group; the parent decides when this process ends.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(niceness)
    while True:
        try:
            job, args, kwargs, is_watched = connection.recv()
        except EOFError:
            return
        try:
            answer = job(_teller(connection), *args, **kwargs) if is_watched else job(*args, **kwargs)
        except Exception as error:  # noqa: BLE001  # whatever a job raises is its answer
            answer = _Raised(reason=f"{type(error).__name__}: {error}", details=traceback.format_exc())
        try:
            connection.send(answer)
        except BrokenPipeError:
            return


def _teller(connection: Connection) -> Progress:
    """Return what a job tells its progress to: it is sent on, but not every little step."""
    stage_before, told_at = "", 0.0

    def tell(stage: str, share: float) -> None:
        nonlocal stage_before, told_at
        now = time.monotonic()
        if stage != stage_before or now - told_at >= _TELLING_S:
            stage_before, told_at = stage, now
            connection.send(_Told(stage=stage, share=share))

    return tell
