"""All-in-focus pictures of the frames of a sequence: one camera, and depth that is kept where nothing moves."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError, OutputError

from .frames import Frame, are_encoded, dark_of
from .job import FrameResult, Job, KeyFrame
from .settings import DEFAULT, SequenceSettings
from .view_grid import ViewGrid

__all__ = ["render_frames"]


def render_frames(
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
    tuning: SequenceSettings = DEFAULT,
) -> Generator[FrameResult, None, None]:
    """Render the frames of a sequence into a folder, one picture a frame.

    The folder also gets a hidden folder with the camera, the settings, and a depth map every 5 frames. Run again with
    the same settings, only missing pictures are rendered, and they are the same as in one run.
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
        Format of the pictures: `".tif"`, `".png"`, ...
    overwrite : bool
        Render all frames again, whatever is in the folder.
    views : ViewGrid, optional
        Views of a grid instead of one picture: raw video of each view, `v000-1920x1080.yuv` and so on, if `suffix` is
        `".yuv"` or a pixel format such as `".yuv444p12"`, else a folder for each frame, `FRAME/image_001.png` and so
        on. Raw video appears once the last result has been taken; a frame that fails shows the one before it.
    eight_bits : bool
        Write pictures with 8 bits a channel, 0 to white in proportion; JPEG and WebP have no more anyway.
    tuning : SequenceSettings

    Yields
    ------
    FrameResult
        In the order of the frames.

    Raises
    ------
    OutputError
        If the folder or a picture cannot be written, or it holds pictures made with other settings.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> with TemporaryDirectory() as folder:
    ...     for number in range(2):
    ...         lfrender.write_picture(f"{folder}/{number}.png", flat)
    ...     frames = lfrender.open_frames([folder])
    ...     [done.outcome for done in lfrender.render_frames(frames, f"{folder}/out", camera, preset="fast")]
    ['rendered', 'rendered']
    """
    job = Job.open(
        Path(folder), calibration, preset, scale, suffix, overwrite, views, eight_bits, dark_of(frames),
        are_encoded(frames),
    )  # fmt: skip
    names: list[str] = []
    waiting: deque[FrameResult | Future[FrameResult]] = deque()
    with ThreadPoolExecutor(
        tuning.at_once, initializer=numba.set_num_threads, initargs=(numba.get_num_threads(),)
    ) as workers:
        for outcome in _submit_frames(job, frames, workers, overwrite, tuning):
            waiting.append(outcome)
            while waiting and (len(waiting) > tuning.at_once or isinstance(waiting[0], FrameResult)):
                result = _result(waiting.popleft())
                names.append(result.name)
                yield result
        while waiting:
            result = _result(waiting.popleft())
            names.append(result.name)
            yield result
    job.finish(names)


def _submit_frames(
    job: Job, frames: Iterable[Frame], workers: ThreadPoolExecutor, overwrite: bool, tuning: SequenceSettings
) -> Iterator[FrameResult | Future[FrameResult]]:
    """The outcome of each frame, or its future if it was handed to the workers."""
    earlier: KeyFrame | None = None
    key: KeyFrame | None = None
    first: KeyFrame | None = None
    rendered = False
    wanted = None if overwrite else job.is_missing
    for number, (frame, reading) in enumerate(_read_ahead(frames, wanted)):
        if number % tuning.segment == 0:
            earlier, key = key or earlier, None
        if number % tuning.segment % tuning.group == 0:
            first = None
        if reading is None:
            key, first = key or KeyFrame(number, frame), first or KeyFrame(number, frame)
            yield job.kept(frame)
            continue
        try:
            flat = job.demosaic(reading.result())
            if key is None or key.depth is None:
                key = job.analyze_key(key or KeyFrame(number, frame, flat), earlier)
                # Not needed in this segment any more; its flat is as large as this one.
                earlier = None
            if first is None or first.depth is None:
                first = job.analyze_first(first or KeyFrame(number, frame, flat), key)
        except OutputError:
            raise
        except LightFieldError as error:
            yield job.failed(frame, error)
            continue
        # Several frames at once keep all cores busy in steps of one thread. The first one, in this thread, imports what
        # all need.
        if rendered and flat.nbytes <= tuning.shared_bytes:
            yield workers.submit(job.render_frame, number, frame, flat, first)
        else:
            yield job.render_frame(number, frame, flat, first)
            rendered = True


def _result(outcome: FrameResult | Future[FrameResult]) -> FrameResult:
    return outcome if isinstance(outcome, FrameResult) else outcome.result()


def _read_ahead(
    frames: Iterable[Frame], wanted: Callable[[Frame], bool] | None
) -> Iterator[tuple[Frame, Future[NDArray[Any]] | None]]:
    """Each frame with its pixels, None where not wanted; the next one is decoded while one is being worked on."""
    source = iter(frames)

    def read_next() -> tuple[Frame, Future[NDArray[Any]] | None] | None:
        frame = next(source, None)
        if frame is None:
            return None
        return frame, _call(frame.read) if wanted is None or wanted(frame) else None

    # The first one is read in this thread, which imports what reading needs before others do so beside it.
    found = read_next()
    with ThreadPoolExecutor(1) as reader:
        while found is not None:
            waiting = reader.submit(read_next)
            yield found
            found = waiting.result()


def _call(read: Callable[[], NDArray[Any]]) -> Future[NDArray[Any]]:
    """The result of `read`, or the error that it raised, which is raised again by `Future.result`."""
    outcome: Future[NDArray[Any]] = Future()
    try:
        outcome.set_result(read())
    except Exception as error:
        outcome.set_exception(error)
    return outcome
