"""A sequence rendered by the workers of a Dask cluster, to the same pictures as on one machine."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal import Calibration, LightFieldError, OutputError

from .frames import Frame
from .job import GROUP_LENGTH, SEGMENT_LENGTH, FrameResult, Job, KeyFrame

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["connect", "limit_threads", "render_frames_on", "task_result"]

# Groups in flight for each thread of the cluster: enough to keep all busy, few enough to hold videos in memory.
_AHEAD = 2
# Fewer groups than this in flight leave workers idle at the end of a stretch.
_LEAST_AHEAD = 4
_RETRIES = 3
# Seconds to wait for a scheduler.
_PATIENCE = 15


def render_frames_on(
    client: Client,
    frames: Iterable[Frame],
    folder: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: str = "balanced",
    scale: float | None = None,
    suffix: str = ".tif",
    overwrite: bool = False,
    threads: int | None = None,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence on a cluster; as `render_frames`, and the pictures are the same bit for bit.

    Workers read image files themselves and write the pictures: inputs and `folder` must lie on storage that all of
    them see under the same path. Frames of videos are decoded here and sent. Work of a lost worker is done again.

    Parameters
    ----------
    client : distributed.Client
    frames, folder, calibration, preset, scale, suffix, overwrite
        As in `render_frames`.
    threads : int or None
        Threads of the kernels in each worker; None leaves it to the machine.

    Yields
    ------
    FrameResult
        In the order of the frames.

    Raises
    ------
    OutputError
        As `render_frames`.
    """
    job = Job.opened(Path(folder).absolute(), calibration, preset, scale, suffix, overwrite)
    settings = (str(job.folder), preset, suffix, threads)
    most = max(_LEAST_AHEAD, _AHEAD * sum(client.nthreads().values()))
    waiting: deque[tuple[list[FrameResult | None], Future | None]] = deque()
    for group in _groups(client, job, settings, frames, overwrite):
        waiting.append(group.submitted(client, settings))
        while len(waiting) > most:
            yield from _results(*waiting.popleft())
    while waiting:
        yield from _results(*waiting.popleft())


@dataclass
class _Group:
    """Frames that one worker renders one after the other.

    Parameters
    ----------
    known : list
        What has become of each frame, None for those to be rendered.
    asked : list
        Those, with their numbers.
    first : Key, optional
        What they are analysed against, where its picture is there already.
    key : Key, optional
        Of their stretch.
    ready : Future, optional
        Done when there is a depth map of that.
    """

    known: list[FrameResult | None] = field(default_factory=list)
    asked: list[tuple[int, Frame]] = field(default_factory=list)
    first: KeyFrame | None = None
    key: KeyFrame | None = None
    ready: Future | None = None

    def submitted(self, client: Client, settings: tuple[Any, ...]) -> tuple[list[FrameResult | None], Future | None]:
        """What is known, and what tells the others."""
        if not self.asked or self.key is None:
            return self.known, None
        task = (settings, self.asked, self.first, replace(self.key, flat=None), self.ready)
        return self.known, client.submit(_draw, *task, pure=False, retries=_RETRIES)


def _groups(
    client: Client, job: Job, settings: tuple[Any, ...], frames: Iterable[Frame], overwrite: bool
) -> Iterator[_Group]:
    """The groups of a sequence; the depth of keys is asked of the workers, or made here where it tells the settings."""
    earlier: tuple[KeyFrame, Future | None] | None = None
    key: KeyFrame | None = None
    ready: Future | None = None
    known = False
    group = _Group()
    for number, frame in enumerate(frames):
        if number % SEGMENT_LENGTH == 0:
            earlier, key, ready, known = (key, ready) if key else earlier, None, None, False
        if number % SEGMENT_LENGTH % GROUP_LENGTH == 0 and group.known:
            yield group
            group = _Group()
        if not overwrite and not job.is_missing(frame):
            key, group.first = key or KeyFrame(number, frame), group.first or KeyFrame(number, frame)
            group.known.append(FrameResult(frame.name, job.path_of(frame), "kept"))
            continue
        try:
            if key is None:
                key = _readable(job, number, frame)
            if job.scale is None or job.calibration is None:
                # Camera and scale are those of the first key, for all workers.
                job.with_depth(key, None)
                known = True
        except OutputError:
            raise
        except LightFieldError as error:
            key = None
            group.known.append(job.failure(frame, error))
            continue
        if not known:
            before = (replace(earlier[0], flat=None), earlier[1]) if earlier else (None, None)
            ready = client.submit(_prepare, settings, replace(key, flat=None), *before, pure=False, retries=_RETRIES)
            known = True
        group.known.append(None)
        group.asked.append((number, frame))
        group.key, group.ready = key, ready
    yield group


@contextmanager
def connect(workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """A client of a running scheduler, or of so many worker processes on this machine.

    Raises
    ------
    OutputError
        If Dask is not installed or the scheduler does not answer.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise OutputError("clusters need the package 'distributed'; pip install 'lfrender[cluster]'") from error
    if scheduler is None:
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise OutputError(f"{scheduler}: no Dask scheduler answers there ({error})") from error
    with client:
        yield client


def _readable(job: Job, number: int, frame: Frame) -> KeyFrame:
    """The frame as a key; LightFieldError where it can be none."""
    flat = job.in_colour(frame.read())
    size = job.camera(flat).image_size
    if (flat.shape[1], flat.shape[0]) != size:
        raise LightFieldError(f"is {flat.shape[1]} x {flat.shape[0]} px, the camera is for {size[0]} x {size[1]} px")
    return KeyFrame(number, frame, flat)


def _results(known: list[FrameResult | None], others: Future | None) -> Iterator[FrameResult]:
    """What has become of the frames of a group, in their order."""
    rendered = iter([] if others is None else task_result(others))
    for result in known:
        yield next(rendered) if result is None else result


def task_result(future: Future) -> Any:
    """The result of a task; an OutputError where no worker could be found that lived long enough to finish it."""
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except (KilledWorker, FutureCancelledError) as error:
        raise OutputError(
            f"the cluster has given up a part of the work ({error}); workers die for want of memory: start fewer of "
            "them, or on larger machines"
        ) from error


def limit_threads(count: int) -> None:
    """Have everything that computes in this process take so many threads."""
    import cv2
    import numba

    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(min(count, most))
    cv2.setNumThreads(count)


class _Worker:
    """What a worker process keeps from task to task. Kernels run one at a time: they use several threads themselves."""

    lock = Lock()
    settings: tuple[Any, ...] | None = None
    job: Job | None = None
    key: KeyFrame | None = None

    @classmethod
    def job_of(cls, settings: tuple[Any, ...]) -> Job:
        folder, preset, suffix, threads = settings
        if threads is not None:
            limit_threads(threads)
        if cls.settings != settings or cls.job is None:
            cls.job, cls.key, cls.settings = Job.opened(Path(folder), None, preset, None, suffix, False), None, settings
        return cls.job

    @classmethod
    def key_of(cls, job: Job, key: KeyFrame, earlier: KeyFrame | None) -> KeyFrame:
        if cls.key is None or cls.key.number != key.number:
            cls.key = job.with_depth(key, earlier)
        return cls.key


def _prepare(settings: tuple[Any, ...], key: KeyFrame, earlier: KeyFrame | None, _after: object) -> None:
    """Make the depth map of a key frame, once that of the earlier key is there."""
    with _Worker.lock:
        job = _Worker.job_of(settings)
        _Worker.key_of(job, key, earlier)


def _draw(
    settings: tuple[Any, ...], asked: list[tuple[int, Frame]], first: KeyFrame | None, key: KeyFrame, _after: object
) -> list[FrameResult]:
    """Render some frames of a group, once the depth map of the key of their stretch is there."""
    with _Worker.lock:
        job = _Worker.job_of(settings)
        if not job.depth_file(key).exists():
            raise OutputError(f"{job.folder}: a worker does not see what another has written; give a shared folder")
        results = []
        for number, frame in asked:
            try:
                flat = job.in_colour(frame.read())
                if first is None or first.depth is None:
                    first = job.first_of_group(first or KeyFrame(number, frame, flat), _Worker.key_of(job, key, None))
            except OutputError:
                raise
            except LightFieldError as error:
                results.append(job.failure(frame, error))
                continue
            results.append(job.result(number, frame, partial(np.asarray, flat), first))
        return results
