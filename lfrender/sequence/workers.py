"""Runs the parts of a result (tiles, groups of frames) in this process or on a Dask cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from copy import deepcopy
from threading import Lock
from typing import Any

from lfcal import LightFieldError, OutputError
from lfcal.runtime.packages import check_package

__all__ = ["Workers", "ahead", "connect"]


class Workers:
    """Computes parts of a result: `at_once` in this process, or on the cluster of a `client`.

    `threads` is the number of threads of a worker of the cluster.
    """

    def __init__(self, client: Any = None, threads: int | None = None, at_once: int = 1) -> None:
        self._client, self._threads, self._at_once = client, threads, at_once

    @property
    def count(self) -> int:
        """How many parts are worked on at a time."""
        if self._client is None:
            return self._at_once
        return max(1, sum(self._client.nthreads().values()))

    def map(
        self,
        task: Callable[[Any, Any, Any], Any],
        shared: Any,
        items: Iterable[Any],
        load: Callable[[Any, Any], Any] = lambda *_: None,
    ) -> Iterator[Any]:
        """Results of `task(shared, item, load(shared, item))` in the order of the items.

        They are computed as they are taken.

        `shared`, as it is when the first item has been taken, is sent once to each worker of a
        cluster.
        """
        if self._client is not None:
            yield from self._map_there(task, shared, items, load)
        elif self._at_once == 1:
            for item, loaded in ahead(lambda item: (item, load(shared, item)), items, 1):
                yield task(shared, item, loaded)
        else:
            try:
                yield from ahead(
                    lambda item: task(shared, item, load(shared, item)), items, self._at_once
                )
            finally:
                # Where not all results are taken, tasks end as soon as they look at this.
                shared.stopped = True

    def _map_there(self, task: Any, shared: Any, items: Iterable[Any], load: Any) -> Iterator[Any]:
        options: dict[str, Any] = {"pure": False, "retries": 3}
        sent: Any = None
        waiting: deque[Any] = deque()
        try:
            for item in items:
                # As the result of a task, the scheduler makes it again if all workers that hold it
                # are lost.
                sent = sent or self._client.submit(_identity, shared, **options)
                waiting.append(
                    self._client.submit(_work, task, load, sent, item, self._threads, **options)
                )
                # One that is worked on, and one that waits, for each thread.
                while len(waiting) > 2 * self.count:
                    yield _result(waiting.popleft())
            while waiting:
                yield _result(waiting.popleft())
        finally:
            self._client.cancel([*waiting, sent] if sent else [])


def ahead(function: Callable[[Any], Any], items: Iterable[Any], count: int) -> Iterator[Any]:
    """Results of a function for all items, computed by `count` threads ahead of being taken.

    The first item is computed in the calling thread.
    """
    import numba

    waiting: deque[Future[Any]] = deque()
    with ThreadPoolExecutor(
        count, initializer=numba.set_num_threads, initargs=(numba.get_num_threads(),)
    ) as pool:
        try:
            for number, item in enumerate(items):
                if number == 0:
                    # The first one imports what all need.
                    waiting.append(pool.submit(_identity, function(item)))
                else:
                    waiting.append(pool.submit(function, item))
                if len(waiting) > count:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


class _Worker:
    """What a worker process keeps from task to task.

    Tasks run one at a time, because each uses several threads.
    """

    lock = Lock()
    received: Any = None
    shared: Any = None


def _identity(shared: Any) -> Any:
    return shared


def _work(task: Any, load: Any, shared: Any, item: Any, threads: int | None) -> Any:
    """The result of one part.

    An error of this toolkit is returned, because Dask would try a raised one again.
    """
    with _Worker.lock:
        if threads is not None:
            import cv2
            import numba

            most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
            numba.set_num_threads(min(threads, most))
            cv2.setNumThreads(threads)
        if _Worker.received is not shared:
            # A copy: values are cached in it while Dask may be sending the original to others.
            _Worker.received, _Worker.shared = shared, deepcopy(shared)
        try:
            return task(_Worker.shared, item, load(_Worker.shared, item))
        except LightFieldError as error:
            return error


def _result(future: Any) -> Any:
    """The result of a task; an OutputError if all workers that tried it were lost."""
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    try:
        result = future.result()
    except (KilledWorker, FutureCancelledError) as error:
        problem = f"the cluster has given up a part of the work ({error})"
        cause = "workers die if memory runs out: start fewer of them, or on larger machines"
        raise OutputError(f"{problem}; {cause}") from error
    if isinstance(result, LightFieldError):
        raise result
    return result


def check_cluster() -> None:
    """Raise OutputError if the package for work in several processes is not installed."""
    check_package("distributed", "several processes need", OutputError)


@contextmanager
def connect(workers: int | None, scheduler: str | None, timeout: float = 15.0) -> Iterator[Any]:
    """A client of a scheduler such as `"tcp://host:8786"`, or of new processes on this machine."""
    check_cluster()
    from distributed import Client, LocalCluster

    if scheduler is None:
        options: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": None}
        with LocalCluster(n_workers=workers, **options) as cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=timeout)
    except (OSError, ValueError) as error:
        raise OutputError(f"{scheduler}: there is no Dask scheduler ({error})") from error
    with client:
        yield client
