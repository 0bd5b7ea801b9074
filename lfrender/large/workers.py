"""Runs a function on parts of a large flat: in this process, or on the workers of a Dask cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from lfcal import Calibration, FlatError, FlatSource, LightFieldError, open_flat

from ..output.resume import file_identity
from .settings import DEFAULT, LargeSettings
from .tiles import Rectangle, TileReader

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["ClusterWorkers", "LocalWorkers", "Workers", "choose_workers"]

_Task = Callable[[Any, Any, NDArray[Any]], Any]


def choose_workers(
    reader: TileReader, client: Client | None, threads: int | None, settings: LargeSettings = DEFAULT
) -> Workers:
    """The workers of a cluster, or this process if `client` is None."""
    return LocalWorkers(reader) if client is None else ClusterWorkers(client, reader.source, threads, settings)


class LocalWorkers:
    """This process; the file is read for the next part while one is worked on."""

    #: How many parts are worked on at a time.
    count = 1

    def __init__(self, reader: TileReader) -> None:
        self._reader = reader

    def map(self, task: _Task, shared: Any, items: Iterable[Any], rectangles: Iterable[Rectangle]) -> Iterator[Any]:
        """The results of `task(shared, item, pixels)` in the order of the items.

        `rectangles` are the parts of the flat that belong to the items; `pixels` (h, w, C) are as `TileReader.read`
        returns them. `shared` is sent once to each worker of a cluster; it has the `calibration`.
        """
        for item, pixels in zip(items, self._reader.read_ahead(rectangles), strict=True):
            yield task(shared, item, pixels)


class ClusterWorkers:
    """The workers of a cluster, each with so many `threads`; they read the flat themselves, under the same path."""

    def __init__(
        self, client: Client, source: FlatSource, threads: int | None = None, settings: LargeSettings = DEFAULT
    ) -> None:
        self._client, self._settings = client, settings
        # The size alone: copies on the disks of several machines differ in their times.
        size = file_identity(source.path)[1]
        dark = None if source.dark is None else str(source.dark.absolute())
        self._flat = _FlatFile(str(source.path.absolute()), size, source.page, dark, threads)

    @property
    def count(self) -> int:
        """How many parts are worked on at a time."""
        return max(1, sum(self._client.nthreads().values()))

    def map(self, task: _Task, shared: Any, items: Iterable[Any], rectangles: Iterable[Rectangle]) -> Iterator[Any]:
        from ..sequence.cluster import task_result

        submit = {"pure": False, "retries": self._settings.retries}
        # As the result of a task the scheduler makes it again if all workers that hold it are lost.
        shared_task = self._client.submit(_identity, shared, **submit)
        waiting: deque[Any] = deque()
        try:
            for item, rectangle in zip(items, rectangles, strict=True):
                waiting.append(self._client.submit(_work, self._flat, task, shared_task, item, rectangle, **submit))
                while len(waiting) > self._settings.tiles_ahead * self.count:
                    yield _raise_errors(task_result(waiting.popleft()))
            while waiting:
                yield _raise_errors(task_result(waiting.popleft()))
        finally:
            self._client.cancel([*waiting, shared_task])


def _raise_errors(result: Any) -> Any:
    if isinstance(result, LightFieldError):
        raise result
    return result


Workers = LocalWorkers | ClusterWorkers


@dataclass(frozen=True)
class _FlatFile:
    """Where workers find a flat, its size [bytes], and with how many threads they work on it."""

    path: str
    size: int
    page: int | None
    dark: str | None
    threads: int | None


class _Worker:
    """What a worker process keeps from task to task. Kernels run one at a time: each uses several threads itself."""

    lock = Lock()
    flat: _FlatFile | None = None
    reader: TileReader | None = None
    received: Any = None
    shared: Any = None

    @classmethod
    def copy(cls, shared: Any) -> Any:
        """This worker's own copy: values are cached in it while Dask may be sending the original to others."""
        if cls.shared is None or cls.received is not shared:
            cls.received, cls.shared = shared, deepcopy(shared)
        return cls.shared

    @classmethod
    def open(cls, flat: _FlatFile, calibration: Calibration) -> TileReader:
        if flat.threads is not None:
            from ..sequence.cluster import limit_threads

            limit_threads(flat.threads)
        if cls.reader is None or cls.flat != flat:
            cls.flat = cls.reader = None
            source = open_flat(flat.path, flat.page, flat.dark)
            if file_identity(source.path)[1] != flat.size:
                source.close()
                raise FlatError(f"{flat.path}: is another file where the workers are, or has been changed")
            cls.reader, cls.flat = TileReader(source, calibration), flat
        elif cls.reader.calibration is not calibration:
            cls.reader = TileReader(cls.reader.source, calibration)
        return cls.reader


def _identity(shared: Any) -> Any:
    return shared


def _work(flat: _FlatFile, task: _Task, shared: Any, item: Any, rectangle: Rectangle) -> Any:
    """The result of one part. An error of this toolkit is returned, not raised: Dask would only try it again."""
    with _Worker.lock:
        try:
            own = _Worker.copy(shared)
            return task(own, item, _Worker.open(flat, own.calibration).read(rectangle))
        except LightFieldError as error:
            return error
