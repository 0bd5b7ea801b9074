"""All-in-focus pictures of the frames of a sequence: one camera, and depth that is kept where nothing moves."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable
from pathlib import Path
from typing import Any

from lfcal import Calibration

from .frames import Frame, are_encoded, dark_of
from .job import FrameResult, Job, render_group
from .view_grid import ViewGrid
from .workers import Workers

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
    segment: int = 30,
    group: int = 5,
    client: Any = None,
    threads: int | None = None,
) -> Generator[FrameResult, None, None]:
    """Render the frames of a sequence into a folder, one picture a frame.

    The folder also gets a hidden folder with the camera, the settings, and a depth map every 5 frames. Run again with
    the same settings, only missing pictures are rendered, and they are the same as in one run.
    A frame that cannot be read or analysed is reported, and the others are rendered. OutputError if the folder or a
    picture cannot be written, or if it holds pictures made with other settings.

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
    segment, group : int
        Frames from one key frame to the next, and frames that are compared with the same one, the first of them.
    client : distributed.Client, optional
        As in `render_frames_on`.
    threads : int, optional
        Threads of the kernels in each worker of a cluster; None leaves it to the machine.

    Yields
    ------
    FrameResult
        In the order of the frames, some at a time.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", flat)
    ...     frames = lfrender.open_frames([folder])
    ...     [done.outcome for done in lfrender.render_frames(frames, f"{folder}/out", camera, preset="fast")]
    ['rendered']
    """
    place = Path(folder) if client is None else Path(folder).absolute()
    job = Job(place, calibration, preset, scale, suffix, views, eight_bits, dark_of(frames), are_encoded(frames))
    job.start(overwrite)
    # Two groups at once keep all cores busy in steps of one thread.
    workers = Workers(client, threads, at_once=2)
    names: list[str] = []
    for results in workers.map(render_group, job, job.groups(frames, overwrite, segment, group)):
        for result in results:
            names.append(result.name)
            yield result
    job.finish(names)
