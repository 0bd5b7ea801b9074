"""Where parts of a large flat are worked on: here, or by the workers of a Dask cluster, with the same functions."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from threading import Lock
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from lfcal import Calibration, FlatError, FlatSource, LightFieldError, open_flat

from ..output.resume import file_identity
from .flat_parts import PartReader

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["ClusterWorkers", "LocalWorkers", "Shared", "Workers"]

_Rectangle = tuple[int, int, int, int]

# Parts in flight for each thread of the cluster: one that is worked on, and one that waits.
_AHEAD = 2
_RETRIES = 3


class Shared(Protocol):
    """What all parts need beside their pixels; cluster workers get it once."""

    @property
    def calibration(self) -> Calibration: ...


class Workers(Protocol):
    """Those who work on parts of one flat."""

    def each(
        self,
        task: Callable[[Any, Any, NDArray[Any]], Any],
        shared: Shared,
        items: Iterable[Any],
        rectangles: Iterable[_Rectangle],
    ) -> Iterator[Any]:
        """The results of `task(shared, item, pixels)` in the order of the items.

        Parameters
        ----------
        task : function of a module
        shared : Shared
        items : iterable
        rectangles : iterable of (left, top, right, bottom) [px]
            Of the part of the flat that belongs to each item; `pixels` (h, w, C) are as `PartReader.read` gives them.
        """


class LocalWorkers:
    """This process; the file is read for the next part meanwhile."""

    def __init__(self, parts: PartReader) -> None:
        self._parts = parts

    def each(
        self,
        task: Callable[[Any, Any, NDArray[Any]], Any],
        shared: Shared,
        items: Iterable[Any],
        rectangles: Iterable[_Rectangle],
    ) -> Iterator[Any]:
        for item, (_, pixels) in zip(items, self._parts.ahead(rectangles), strict=True):
            yield task(shared, item, pixels)


class ClusterWorkers:
    """The workers of a cluster, which read the flat themselves.

    Parameters
    ----------
    client : distributed.Client
    source : FlatSource
        A file that all workers see under the same path.
    threads : int or None
        Threads of the kernels in each worker; None leaves it to the machine.
    """

    def __init__(self, client: Client, source: FlatSource, threads: int | None = None) -> None:
        self._client, self._threads = client, threads
        self._path = str(source.path.absolute())
        # Copies on the disks of several machines differ in their times.
        self._size = file_identity(source.path)[1]

    @property
    def count(self) -> int:
        """How many parts are worked on at a time."""
        return max(1, sum(self._client.nthreads().values()))

    def each(
        self,
        task: Callable[[Any, Any, NDArray[Any]], Any],
        shared: Shared,
        items: Iterable[Any],
        rectangles: Iterable[_Rectangle],
    ) -> Iterator[Any]:
        from ..sequence.cluster import task_result

        # Kept by the scheduler as a task, it is there again when all workers that had it are lost.
        known = self._client.submit(_same, shared, pure=False, retries=_RETRIES)
        waiting: deque[Any] = deque()
        try:
            for item, rectangle in zip(items, rectangles, strict=True):
                flat = self._path, self._size, self._threads
                waiting.append(
                    self._client.submit(_work, flat, task, known, item, rectangle, pure=False, retries=_RETRIES)
                )
                while len(waiting) > _AHEAD * self.count:
                    yield _result(task_result(waiting.popleft()))
            while waiting:
                yield _result(task_result(waiting.popleft()))
        finally:
            self._client.cancel([*waiting, known])


def _result(found: Any) -> Any:
    if isinstance(found, LightFieldError):
        raise found
    return found


class _Worker:
    """What a worker process keeps from task to task. Kernels run one at a time: they use several threads themselves."""

    lock = Lock()
    flat: Any = None
    parts: PartReader | None = None
    given: Shared | None = None
    shared: Shared | None = None

    @classmethod
    def own(cls, shared: Shared) -> Shared:
        """What is shared as this worker's own, for values come to be kept in it while others may be sent it."""
        if cls.shared is None or cls.given is not shared:
            cls.given, cls.shared = shared, deepcopy(shared)
        return cls.shared

    @classmethod
    def parts_of(cls, flat: tuple[str, int, int | None], calibration: Calibration) -> PartReader:
        path, size, threads = flat
        if threads is not None:
            from ..sequence.cluster import limit_threads

            limit_threads(threads)
        if cls.parts is None or cls.flat != flat:
            cls.flat = cls.parts = None
            source = open_flat(path)
            if file_identity(source.path)[1] != size:
                source.close()
                raise FlatError(f"{path}: is another file where the workers are, or was changed meanwhile")
            cls.parts, cls.flat = PartReader(source, calibration), flat
        elif cls.parts.calibration is not calibration:
            cls.parts = PartReader(cls.parts.source, calibration)
        return cls.parts


def _same(shared: Shared) -> Shared:
    return shared


def _work(
    flat: tuple[str, int, int | None],
    task: Callable[[Any, Any, NDArray[Any]], Any],
    shared: Shared,
    item: Any,
    rectangle: _Rectangle,
) -> Any:
    """One part; an error of ours is a result, for it would come again wherever it is tried."""
    with _Worker.lock:
        try:
            own = _Worker.own(shared)
            return task(own, item, _Worker.parts_of(flat, own.calibration).read(rectangle))
        except LightFieldError as error:
            return error
