"""All-in-focus pictures of the frames of a sequence: one camera, and depth that is kept where nothing moves."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Generator, Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from lfcal import Calibration, OutputError
from lfcal.runtime.errors import check_type

from ..output.formats import check_format
from ..runtime.choices import Preset
from .film_file import film_results
from .frames import Frame, Frames, is_video
from .job import FrameResult, Job, render_group
from .view_grid import ViewGrid
from .workers import Workers

__all__ = ["Plan", "render_frames"]


class Plan(NamedTuple):
    """What a run will do."""

    frames: int  # in all, kept ones included; 0 if it is not known
    kept: int  # whose pictures are there already
    size: tuple[int, int] | None  # columns and rows of the pictures; None if no frame could be analysed
    colours: tuple[float, float] | None  # magnification at the blue and at the red end of depth pictures


def render_frames(
    frames: Iterable[Frame],
    folder: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: Preset = "balanced",
    scale: float | None = None,
    suffix: str = ".tif",
    overwrite: bool = False,
    views: ViewGrid | None = None,
    eight_bits: bool = False,
    depth_maps: str | os.PathLike[str] | None = None,
    rate: float | Fraction | None = None,
    announce: Callable[[Plan], None] | None = None,
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
    frames : Frames
        From `open_frames`, or any frames.
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
        Remove what is in the folder for these frames, and render them again.
    views : ViewGrid, optional
        Views of a grid instead of one picture: raw video of each view, `v000-1920x1080.yuv` and so on, if `suffix` is
        `".yuv"` or a pixel format such as `".yuv444p12"`, else a folder for each frame, `FRAME/image_001.png` and so
        on. Raw video appears once the last result has been taken; a frame that fails shows the one before it.
    eight_bits : bool
        Write pictures with 8 bits a channel, 0 to white in proportion; JPEG and WebP have no more anyway.
    depth_maps : path-like, optional
        Folder for the depth map of each frame, `FRAME.npz`, or a film of depth pictures: magnification in the colours
        of `lfrender analyze --picture`, blue and red at the ends of the first frame for all.
    rate : float, optional
        Pictures a second of that film; with None those of the first video, else 25.
    announce : callable, optional
        Called once with a `Plan`, before the first picture is written.
    segment, group : int
        Frames from one key frame to the next, and frames that are compared with the same one, the first of them.
    client, threads
        As in `analyze_large`.

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
    check_type(frames, Iterable, "frames", "lfrender.open_frames finds them")
    known = frames if isinstance(frames, Frames) else Frames(())
    # Workers may have another working directory.
    place = Path(folder) if client is None else Path(folder).absolute()
    maps = None if depth_maps is None else Path(depth_maps).absolute()
    film = maps if maps is not None and is_video(maps) else None
    if film is not None:
        check_format(film, "film", inputs=known.files)
        if film.exists() and not overwrite:
            raise OutputError(f"{film}: is there already; give another output, or render it again (--overwrite)")
    dark = None if known.dark is None else str(known.dark)
    job = Job(place, calibration, preset, scale, suffix, views, eight_bits, dark, known.encoded, maps)
    job.start(overwrite, known.names)
    results = _render(job, frames, known.names, overwrite, segment, group, announce, Workers(client, threads, 2))
    if film is None:
        yield from results
        return
    speed, depth_of = Fraction(rate or known.rate or 25), job.depth_path_of
    yield from film_results(results, film, job.hidden, speed, lambda result: depth_of(result.name), rendering="depth")
    shutil.rmtree(depth_of("").parent)


def _render(
    job: Job, frames: Iterable[Frame], names: list[str], overwrite: bool, segment: int, group: int,
    announce: Callable[[Plan], None] | None, workers: Workers,
) -> Generator[FrameResult, None, None]:  # fmt: skip
    kept = 0 if overwrite else sum(not job.is_missing(name) for name in names)
    groups = job.groups(frames, overwrite, segment, group)
    first = next(groups)
    if overwrite:
        job.remove(names)
    if announce is not None:
        announce(Plan(len(names), kept, job.size, job.colours))
    done: list[str] = []
    # Two groups at once keep all cores busy in steps of one thread.
    for results in workers.map(render_group, job, chain([first], groups)):
        for result in results:
            done.append(result.name)
            yield result
    if job.output is not None:
        job.output.finish(done)
