"""All-in-focus pictures of the frames of a sequence: one camera, and depth that is kept where nothing moves."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError, OutputError

from .frames import Frame
from .job import GROUP_LENGTH, SEGMENT_LENGTH, FrameResult, Job, KeyFrame

__all__ = ["render_frames"]

# Frames that are worked on at once, if a flat has no more bytes than this: larger ones keep all cores busy by
# themselves, and take memory.
_AT_ONCE, _MOST_SHARED = 2, 1 << 26
# What Numba runs kernels on that may be called from several threads.
_SAFE_LAYERS = ("omp", "tbb")


def render_frames(
    frames: Iterable[Frame],
    folder: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: str = "balanced",
    scale: float | None = None,
    suffix: str = ".tif",
    overwrite: bool = False,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence into a folder, one picture a frame.

    The folder also gets a hidden folder with the camera, the settings, and a depth map every 5 frames. Run again with
    the same settings, only pictures that are not there are rendered, and they are the same as in one run.
    A frame that cannot be read or analysed is reported, and the others are rendered.

    Parameters
    ----------
    frames : iterable of Frame
        From `open_frames`.
    folder : path-like
        Made where it does not exist; its parent must exist.
    calibration : Calibration or None
        With None that of an earlier run into this folder, or else calibrated from the first frame that can be.
    preset : {"fast", "balanced", "accurate"}
    scale : float or None
        Output pixels per pitch; with None the full resolution of the first frame, for all frames.
    suffix : str
        Kind of the pictures: `".tif"`, `".png"`, ...
    overwrite : bool
        Render all frames anew, whatever is in the folder.

    Yields
    ------
    FrameResult
        In the order of the frames.

    Raises
    ------
    OutputError
        If the folder or a picture cannot be written, or it holds pictures made with other settings.
    """
    job = Job.opened(Path(folder), calibration, preset, scale, suffix, overwrite)
    waiting: deque[FrameResult | Future[FrameResult]] = deque()
    with ThreadPoolExecutor(
        _AT_ONCE, initializer=numba.set_num_threads, initargs=(numba.get_num_threads(),)
    ) as workers:
        for given in _given(job, frames, workers, overwrite):
            waiting.append(given)
            while waiting and (len(waiting) > _AT_ONCE or isinstance(waiting[0], FrameResult)):
                yield _outcome(waiting.popleft())
        while waiting:
            yield _outcome(waiting.popleft())


def _given(
    job: Job, frames: Iterable[Frame], workers: ThreadPoolExecutor, overwrite: bool
) -> Iterator[FrameResult | Future[FrameResult]]:
    """What becomes of each frame, or will: those to be rendered are given to the workers."""
    earlier: KeyFrame | None = None
    key: KeyFrame | None = None
    first: KeyFrame | None = None
    wanted = None if overwrite else job.is_missing
    for number, (frame, reading) in enumerate(_read_ahead(frames, wanted)):
        if number % SEGMENT_LENGTH == 0:
            earlier, key = key or earlier, None
        if number % SEGMENT_LENGTH % GROUP_LENGTH == 0:
            first = None
        if reading is None:
            key, first = key or KeyFrame(number, frame), first or KeyFrame(number, frame)
            yield FrameResult(frame.name, job.path_of(frame), "kept")
            continue
        try:
            flat = job.in_colour(reading.result())
            if key is None or key.depth is None:
                key = job.with_depth(key or KeyFrame(number, frame, flat), earlier)
                # Its flat is as large as this one's.
                earlier = None
            if first is None or first.depth is None:
                first = job.first_of_group(first or KeyFrame(number, frame, flat), key)
        except OutputError:
            raise
        except LightFieldError as error:
            yield job.failure(frame, error)
            continue
        if _can_share(flat):
            yield workers.submit(job.result, number, frame, partial(np.asarray, flat), first)
        else:
            yield job.result(number, frame, partial(np.asarray, flat), first)


def _can_share(flat: NDArray[Any]) -> bool:
    """Whether frames may be worked on at once: one core need not wait while the other does what has no parts."""
    return flat.nbytes <= _MOST_SHARED and numba.threading_layer() in _SAFE_LAYERS


def _outcome(given: FrameResult | Future[FrameResult]) -> FrameResult:
    return given if isinstance(given, FrameResult) else given.result()


def _read_ahead(
    frames: Iterable[Frame], wanted: Callable[[Frame], bool] | None
) -> Iterator[tuple[Frame, Future[NDArray[Any]] | None]]:
    """Each frame with its pixels, None where not wanted; the next one is decoded while one is being worked on."""
    source = iter(frames)

    def following() -> tuple[Frame, Future[NDArray[Any]] | None] | None:
        frame = next(source, None)
        if frame is None:
            return None
        return frame, _done(frame.read) if wanted is None or wanted(frame) else None

    with ThreadPoolExecutor(1) as reader:
        waiting = reader.submit(following)
        while (found := waiting.result()) is not None:
            waiting = reader.submit(following)
            yield found


def _done(read: Callable[[], NDArray[Any]]) -> Future[NDArray[Any]]:
    """What `read` gives or raises, when it is asked for."""
    outcome: Future[NDArray[Any]] = Future()
    try:
        outcome.set_result(read())
    except Exception as error:
        outcome.set_exception(error)
    return outcome
