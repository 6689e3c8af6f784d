"""Who computes: processes of this machine through joblib, or a Dask cluster."""

import contextlib
import functools
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
        with self._backend() as parallel:
            # Dask looks after its own processes.
            parent = os.getpid() if self.dask is None else None
            results = parallel(joblib.delayed(_compute_under)(parent, compute, item) for item in items)
            with contextlib.closing(results):
                try:
                    yield from results
                except BrokenProcessPool as error:
                    raise WorkerLostError(problem=str(error).splitlines()[0]) from error

    @contextlib.contextmanager
    def _backend(self) -> Iterator[Any]:
        # One case at a time: what is handed over is on disk at once, and cases take long compared with handing over.
        how = {"return_as": "generator_unordered", "batch_size": 1}
        jobs = self.jobs or joblib.cpu_count()
        if self.dask is not None:
            with _dask_client(self.dask, jobs=jobs) as client, joblib.parallel_config(backend="dask", client=client):
                yield joblib.Parallel(n_jobs=-1, **how)
        elif jobs == 1:
            yield joblib.Parallel(n_jobs=1, **how)
        else:
            # One thread each, so that the cores are shared out once and not twice.
            with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
                yield joblib.Parallel(n_jobs=jobs, **how)


def _compute_under(parent: int | None, compute: Callable[[ItemT], ResultT], item: ItemT) -> ResultT:
    if parent is not None and parent != os.getpid():
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


@contextlib.contextmanager
def _dask_client(address: str, *, jobs: int) -> Iterator[Any]:
    try:
        import distributed  # noqa: PLC0415  # an extra, and a second to import
    except ImportError as error:
        raise DaskError(address=address, problem="Dask is not installed; install the extra: pip install 'biobot-gateway[dask]'") from error
    with contextlib.ExitStack() as stack:
        if address == LOCAL_CLUSTER:
            # Dask itself gives its processes one thread for each library (distributed.nanny.pre-spawn-environ).
            cluster = distributed.LocalCluster(n_workers=jobs, threads_per_worker=1, processes=True, dashboard_address=None)
            stack.enter_context(cluster)
            yield stack.enter_context(distributed.Client(cluster))
            return
        try:
            client = stack.enter_context(distributed.Client(address, timeout=_CONNECT_S))
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except (OSError, ValueError, TimeoutError) as error:
            problem = f"no scheduler with workers answers within {_CONNECT_S} s ({error}); start one, or leave --dask out"
            raise DaskError(address=address, problem=problem) from error
        yield client
