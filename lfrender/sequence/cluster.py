"""A sequence rendered by the workers of a Dask cluster, with the same pictures as on one machine."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

from lfcal import Calibration, LightFieldError, OutputError

from .frames import Frame, are_encoded, dark_of
from .job import FrameResult, Job, KeyFrame
from .settings import DEFAULT, SequenceSettings
from .view_grid import ViewGrid

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["connect", "limit_threads", "render_frames_on", "task_result"]


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
    views: ViewGrid | None = None,
    eight_bits: bool = False,
    threads: int | None = None,
    tuning: SequenceSettings = DEFAULT,
) -> Generator[FrameResult, None, None]:
    """Render the frames of a sequence on a cluster; as `render_frames`, and the pictures are the same bit for bit.

    Workers read image files themselves and write the pictures: inputs and `folder` must lie on storage that all of
    them see under the same path. Frames of videos are decoded here and sent. Work of a lost worker is done again.

    Parameters
    ----------
    client : distributed.Client
    frames, folder, calibration, preset, scale, suffix, overwrite, views, eight_bits, tuning
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

    Examples
    --------
    >>> import lfrender
    >>> from distributed import Client  # doctest: +SKIP
    >>> client = Client("tcp://host:8786")  # doctest: +SKIP
    >>> frames = lfrender.open_frames(["/data/frames"])  # doctest: +SKIP
    >>> for done in render_frames_on(client, frames, "/data/pictures"):  # doctest: +SKIP
    ...     print(done.name, done.outcome)
    """
    dark = dark_of(frames)
    encoded = are_encoded(frames)
    job = Job.open(
        Path(folder).absolute(), calibration, preset, scale, suffix, overwrite, views, eight_bits, dark, encoded
    )
    run = _Run(client, job, (str(job.folder), preset, suffix, threads, views, eight_bits, dark, encoded), tuning)
    names: list[str] = []
    most = max(tuning.least_ahead, tuning.groups_ahead * sum(client.nthreads().values()))
    waiting: deque[tuple[list[FrameResult | None], Future | None]] = deque()
    for group in run.groups(frames, overwrite):
        waiting.append((group.outcomes, run.submit(group)))
        while len(waiting) > most:
            yield from _note_names(_results(*waiting.popleft()), names)
    while waiting:
        yield from _note_names(_results(*waiting.popleft()), names)
    job.finish(names)


@dataclass
class _Group:
    """Frames that one worker renders one after the other."""

    outcomes: list[FrameResult | None] = field(default_factory=list)  # None for frames to be rendered ...
    missing: list[tuple[int, Frame]] = field(default_factory=list)  # ... which are these, with their numbers
    first: KeyFrame | None = None  # the frame that they are compared with, if its picture is there already
    key: KeyFrame | None = None  # of their segment
    ready: Future | None = None  # done when there is a depth map of the key frame


@dataclass(frozen=True)
class _Run:
    """Submits the work on a sequence; `settings` are the arguments from which a worker opens the job."""

    client: Client
    job: Job
    settings: tuple[Any, ...]
    tuning: SequenceSettings

    def submit(self, group: _Group) -> Future | None:
        """The future of the missing frames of a group, None if there are none."""
        if not group.missing or group.key is None:
            return None
        key = replace(group.key, flat=None)
        return self._submit(_render_group, group.missing, group.first, key, group.ready)

    def _submit(self, task: Any, *arguments: Any) -> Future:
        return self.client.submit(task, self.settings, *arguments, pure=False, retries=self.tuning.retries)

    def groups(self, frames: Iterable[Frame], overwrite: bool) -> Iterator[_Group]:
        """The groups of a sequence. Workers analyse the key frames, but for the first if camera or scale follow
        from it."""
        job, tuning = self.job, self.tuning
        earlier: tuple[KeyFrame, Future | None] | None = None
        key: KeyFrame | None = None
        ready: Future | None = None
        analyzed = False
        group = _Group()
        for number, frame in enumerate(frames):
            if number % tuning.segment == 0:
                earlier, key, ready, analyzed = (key, ready) if key else earlier, None, None, False
            if number % tuning.segment % tuning.group == 0 and group.outcomes:
                yield group
                group = _Group()
            if not overwrite and not job.is_missing(frame):
                key, group.first = key or KeyFrame(number, frame), group.first or KeyFrame(number, frame)
                group.outcomes.append(job.kept(frame))
                continue
            try:
                if key is None:
                    key = _read_key(job, number, frame)
                if job.scale is None or job.calibration is None:
                    job.analyze_key(key, None)
                    analyzed = True
            except OutputError:
                raise
            except LightFieldError as error:
                key = None
                group.outcomes.append(job.failed(frame, error))
                continue
            if not analyzed:
                before = (replace(earlier[0], flat=None), earlier[1]) if earlier else (None, None)
                ready = self._submit(_analyze_key, replace(key, flat=None), *before)
                analyzed = True
            group.outcomes.append(None)
            group.missing.append((number, frame))
            group.key, group.ready = key, ready
        yield group


@contextmanager
def connect(workers: int | None, scheduler: str | None, timeout: float = 15.0) -> Iterator[Client]:
    """A client of a scheduler such as `"tcp://host:8786"`, or of so many worker processes on this machine.

    OutputError if Dask is not installed or the scheduler cannot be reached within `timeout` seconds.
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
        client = Client(scheduler, timeout=timeout)
    except (OSError, ValueError) as error:
        raise OutputError(f"{scheduler}: there is no Dask scheduler ({error})") from error
    with client:
        yield client


def _read_key(job: Job, number: int, frame: Frame) -> KeyFrame:
    """The frame as a key frame; LightFieldError if it cannot be read or has another size."""
    flat = job.demosaic(frame.read())
    size = job.camera(flat).image_size
    if (flat.shape[1], flat.shape[0]) != size:
        raise LightFieldError(f"is {flat.shape[1]} x {flat.shape[0]} px, the camera is for {size[0]} x {size[1]} px")
    return KeyFrame(number, frame, flat)


def _results(outcomes: list[FrameResult | None], missing: Future | None) -> Iterator[FrameResult]:
    """The outcomes of the frames of a group, in their order."""
    rendered = iter([] if missing is None else task_result(missing))
    for outcome in outcomes:
        yield next(rendered) if outcome is None else outcome


def _note_names(results: Iterator[FrameResult], names: list[str]) -> Iterator[FrameResult]:
    """The results, whose names are noted."""
    for result in results:
        names.append(result.name)
        yield result


def task_result(future: Future) -> Any:
    """The result of a task; an OutputError if all workers that tried it were lost."""
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except (KilledWorker, FutureCancelledError) as error:
        raise OutputError(
            f"the cluster has given up a part of the work ({error}); workers die if memory runs out: start fewer of "
            "them, or on larger machines"
        ) from error


def limit_threads(count: int) -> None:
    """Limit the threads of everything that computes in this process."""
    import cv2
    import numba

    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(min(count, most))
    cv2.setNumThreads(count)


class _Worker:
    """What a worker process keeps from task to task. Kernels run one at a time: each uses several threads itself."""

    lock = Lock()
    settings: tuple[Any, ...] | None = None
    job: Job | None = None
    key: KeyFrame | None = None

    @classmethod
    def open_job(cls, settings: tuple[Any, ...]) -> Job:
        folder, preset, suffix, threads, views, eight_bits, dark, encoded = settings
        if threads is not None:
            limit_threads(threads)
        if cls.settings != settings or cls.job is None:
            cls.job = Job.open(Path(folder), None, preset, None, suffix, False, views, eight_bits, dark, encoded)
            cls.key = None
            cls.settings = settings
        return cls.job

    @classmethod
    def analyze_key(cls, job: Job, key: KeyFrame, earlier: KeyFrame | None) -> KeyFrame:
        if cls.key is None or cls.key.number != key.number:
            cls.key = job.analyze_key(key, earlier)
        return cls.key


def _analyze_key(settings: tuple[Any, ...], key: KeyFrame, earlier: KeyFrame | None, _after: object) -> None:
    """Make the depth map of a key frame, once that of the earlier key frame is there."""
    with _Worker.lock:
        _Worker.analyze_key(_Worker.open_job(settings), key, earlier)


def _render_group(
    settings: tuple[Any, ...], missing: list[tuple[int, Frame]], first: KeyFrame | None, key: KeyFrame, _after: object
) -> list[FrameResult]:
    """Render some frames of a group, once the depth map of the key frame of their segment is there."""
    with _Worker.lock:
        job = _Worker.open_job(settings)
        if not job.depth_file(key).exists():
            raise OutputError(f"{job.folder}: a file of one worker is not seen by another; give a shared folder")
        results = []
        for number, frame in missing:
            try:
                flat = job.demosaic(frame.read())
                if first is None or first.depth is None:
                    first = job.analyze_first(
                        first or KeyFrame(number, frame, flat), _Worker.analyze_key(job, key, None)
                    )
            except OutputError:
                raise
            except LightFieldError as error:
                results.append(job.failed(frame, error))
                continue
            results.append(job.render_frame(number, frame, flat, first))
        return results
