"""Who computes: processes of this machine through joblib, or a Dask cluster."""

import contextlib
import functools
import itertools
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from studies.errors import DaskError, WorkerLostError

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")

LOCAL_CLUSTER = "local"

_CONNECT_S = 30
_AHEAD = 2  # cases handed to a cluster for each of its threads
_LOOK_EVERY_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """How many processes compute, and where.

    Parameters
    ----------
    jobs
        Processes; None for one a core. One job computes in this process. A cluster that is there already has as many as it has.
    dask
        Address of a Dask scheduler such as ``tcp://host:8786``, ``"local"`` for a Dask cluster of this machine, None for joblib's own
        processes.
    """

    jobs: int | None = None
    dask: str | None = None

    @property
    def are_remote(self) -> bool:
        """Whether they may run another program than this one."""
        return self.dask is not None and self.dask != LOCAL_CLUSTER

    def map(self, compute: Callable[[ItemT], ResultT], items: Iterable[ItemT]) -> Iterator[ResultT]:
        """Compute a result for every item and yield them as they come, in no order.

        Raises
        ------
        DaskError
            Dask is not installed, or does not answer.
        WorkerLostError
            A process was killed, or crashed.
        """
        jobs = self.jobs or joblib.cpu_count()
        if self.dask is not None:
            yield from _map_by_dask(compute, items, address=self.dask, jobs=jobs)
            return
        # One thread each, so that the cores are shared out once and not twice. One case at a time: it is on disk at once, and takes long
        # compared with being handed over.
        with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
            parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
            results = parallel(joblib.delayed(_compute_under)(os.getpid(), compute, item) for item in items)
            with contextlib.closing(results):
                try:
                    yield from results
                except BrokenProcessPool as error:
                    raise WorkerLostError(problem=str(error).splitlines()[0]) from error


def _compute_under(parent: int, compute: Callable[[ItemT], ResultT], item: ItemT) -> ResultT:
    if parent != os.getpid():
        _follow(parent)
    return compute(item)


@functools.cache
def _follow(parent: int) -> None:
    """End this process when its parent is gone: what it computed would reach nobody, and it would wait for more for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="watch-parent").start()


def _map_by_dask(compute: Callable[[ItemT], ResultT], items: Iterable[ItemT], *, address: str, jobs: int) -> Iterator[ResultT]:
    """Keep a cluster busy, however it grows and shrinks, without handing it all cases at once.

    Notes
    -----
    Not through joblib, which computes in its own process where a cluster has one thread.
    """
    waiting = iter(items)
    with _dask_client(address, jobs=jobs) as (distributed, client):
        running = distributed.as_completed(with_results=False)

        def hand_over() -> None:
            wanted = _AHEAD * sum(client.nthreads().values()) - running.count()
            for item in itertools.islice(waiting, max(1, wanted)):
                running.add(client.submit(compute, item, pure=False))

        hand_over()
        for future in running:
            try:
                result = future.result()
                hand_over()
            except distributed.KilledWorker as error:
                raise WorkerLostError(problem="a case took four of them with it") from error
            except Exception as error:  # what a case raises is a result: all else is the cluster's, which has many ways to fail
                told = " ".join(f"{type(error).__name__}: {error}".split())
                problem = (
                    f"it failed ({told}); are scheduler and workers up, and is this version of biobot on all of them? What is done is kept"
                )
                raise DaskError(address=address, problem=problem) from error
            yield result


@contextlib.contextmanager
def _dask_client(address: str, *, jobs: int) -> Iterator[tuple[Any, Any]]:
    """Connect to a cluster, or start one; give Dask's module and the client."""
    try:
        import distributed  # noqa: PLC0415  # an extra, and a second to import
    except ImportError as error:
        raise DaskError(address=address, problem="Dask is not installed; install the extra: pip install 'biobot-gateway[dask]'") from error
    with contextlib.ExitStack() as stack:
        if address == LOCAL_CLUSTER:
            # Dask itself gives its processes one thread for each library (distributed.nanny.pre-spawn-environ).
            cluster = distributed.LocalCluster(n_workers=jobs, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0")
            stack.enter_context(cluster)
            yield distributed, stack.enter_context(distributed.Client(cluster))
            return
        try:
            client = stack.enter_context(distributed.Client(address, timeout=_CONNECT_S))
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except (OSError, ValueError, TimeoutError) as error:
            problem = f"no scheduler with workers answers within {_CONNECT_S} s ({error}); start one, or leave --dask out"
            raise DaskError(address=address, problem=problem) from error
        yield distributed, client
